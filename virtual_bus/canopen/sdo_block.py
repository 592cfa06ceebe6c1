"""SDO block transfers (CiA 301, 7.2.4.3.9 to 7.2.4.3.17), with CRC."""

from __future__ import annotations

import binascii
import struct

from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.objects import Objects

_MAX_BLOCK = 127
_HEAD = struct.Struct("<BHBI")


def crc16(data: bytes) -> int:
    """Return the CRC-16-CCITT with start value 0, as block transfers use it (check value of "123456789": 31C3h)."""
    return binascii.crc_hqx(data, 0)


class BlockUpload:
    """A block upload: the device's value leaves in blocks of up to 127 segments.

    The client acknowledges each block and may ask for a part again. The checksum is always sent; a client that did not offer to check it
    may ignore it.
    """

    def __init__(self, index: int, subindex: int, frame: bytes, data: bytes) -> None:
        self.index, self.subindex = index, subindex
        self._data, self._position = data, 0
        self._block_size = self._checked_size(frame[4])
        self._in_flight: list[int] = []  # start of each segment of the present block
        self._ending = False
        self.opening = _HEAD.pack(0xC6, index, subindex, len(data))

    @staticmethod
    def _checked_size(size: int) -> int:
        if not 1 <= size <= _MAX_BLOCK:
            raise SdoAbortError(abort.INVALID_BLOCK_SIZE)
        return size

    def answer(self, frame: bytes) -> tuple[list[bytes], bool]:
        """Return the frames that answer a frame of the client, and whether the transfer is over."""
        step = frame[0] & 3
        if self._ending:
            if step != 1:
                raise SdoAbortError(abort.UNKNOWN_COMMAND)
            return [], True
        if step == 3 and not self._in_flight:
            return self._block(), False
        if step == 2 and self._in_flight:
            return self._acknowledged(frame)
        raise SdoAbortError(abort.UNKNOWN_COMMAND)

    def _acknowledged(self, frame: bytes) -> tuple[list[bytes], bool]:
        received = frame[1]
        if received > len(self._in_flight):
            raise SdoAbortError(abort.INVALID_SEQUENCE_NUMBER)
        self._block_size = self._checked_size(frame[2])
        if received < len(self._in_flight):
            self._position = self._in_flight[received]  # repeat what was lost
            return self._block(), False
        if self._position < len(self._data):
            return self._block(), False
        self._ending = True
        unused = -len(self._data) % 7 if self._data else 7
        return [struct.pack("<BH", 0xC1 | unused << 2, crc16(self._data)) + bytes(5)], False

    def _block(self) -> list[bytes]:
        frames: list[bytes] = []
        self._in_flight = []
        while len(frames) < self._block_size:
            piece = self._data[self._position : self._position + 7]
            self._in_flight.append(self._position)
            self._position += len(piece)
            last = self._position >= len(self._data)
            frames.append(bytes((len(frames) + 1 | (0x80 if last else 0),)) + piece.ljust(7, b"\0"))
            if last:
                break
        return frames


class BlockDownload:
    """A block download: the client's value arrives in blocks of 127 segments.

    It is written once length and CRC have been checked.
    """

    def __init__(self, objects: Objects, index: int, subindex: int, frame: bytes) -> None:
        self.index, self.subindex = index, subindex
        self._objects = objects
        self._with_crc = bool(frame[0] & 4)
        self._announced = struct.unpack_from("<I", frame, 4)[0] if frame[0] & 2 else None
        self._data = bytearray()
        self._expected = 1
        self._ending = False
        self._out_of_step = False
        entry = objects.writable_entry(index, subindex)
        size = (entry.bits + 7) // 8
        if self._announced is not None and size and self._announced != size:
            raise SdoAbortError(abort.TOO_LONG if self._announced > size else abort.TOO_SHORT)
        self.opening = _HEAD.pack(0xA4, index, subindex, _MAX_BLOCK)

    def answer(self, frame: bytes) -> tuple[list[bytes], bool]:
        """Return the frames that answer a frame of the client, and whether the transfer is over."""
        if frame[0] == 0x80:  # sequence number 0 is no segment: the client aborts
            return [], True
        if self._ending:
            return self._end(frame)
        sequence, last = frame[0] & 0x7F, bool(frame[0] & 0x80)
        if sequence == self._expected and not self._out_of_step:
            self._data += frame[1:]
            self._expected += 1
        else:
            self._out_of_step = True  # acknowledge up to the hole when the block is over; the client repeats from there
        if not last and sequence < _MAX_BLOCK:
            return [], False
        acknowledged = self._expected - 1
        self._ending = last and not self._out_of_step
        self._expected, self._out_of_step = 1, False
        return [bytes((0xA2, acknowledged, _MAX_BLOCK)) + bytes(5)], False

    def _end(self, frame: bytes) -> tuple[list[bytes], bool]:
        if frame[0] >> 5 != 6 or frame[0] & 1 != 1:
            raise SdoAbortError(abort.UNKNOWN_COMMAND)
        unused = frame[0] >> 2 & 7
        data = bytes(self._data[: len(self._data) - unused])
        if self._with_crc and crc16(data) != struct.unpack_from("<H", frame, 1)[0]:
            raise SdoAbortError(abort.CRC_ERROR)
        if self._announced is not None and len(data) != self._announced:
            raise SdoAbortError(abort.TOO_LONG if len(data) > self._announced else abort.TOO_SHORT)
        self._objects.write(self.index, self.subindex, data)
        return [bytes((0xA1,)) + bytes(7)], True
