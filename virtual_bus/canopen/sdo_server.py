"""SDO server (CiA 301, 7.2.4): expedited, segmented and block transfers, one at a time, on the default channel."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.objects import Objects
from virtual_bus.canopen.port import Port
from virtual_bus.canopen.sdo_block import BlockDownload, BlockUpload

CLIENT_TIMEOUT_S = 1.0
"""Longest pause of a client within a transfer; CiA 301 gives none, and clients wait 0.3 to 1 s for an answer. Then the device aborts."""
_SCS_SEGMENT_DOWNLOAD, _SCS_INITIATE_DOWNLOAD = 0x20, 0x60
_HEAD = struct.Struct("<BHBI")


class _Upload:
    """A segmented upload under way: the device's value leaves in pieces of seven bytes."""

    def __init__(self, index: int, subindex: int, data: bytes) -> None:
        self.index, self.subindex = index, subindex
        self._data, self._sent, self._toggle = data, 0, 0

    def answer(self, frame: bytes) -> tuple[list[bytes], bool]:
        """Return the frames that answer a frame of the client, and whether the transfer is over."""
        if frame[0] >> 5 != 3:
            raise SdoAbortError(abort.UNKNOWN_COMMAND)
        if frame[0] & 0x10 != self._toggle:
            raise SdoAbortError(abort.TOGGLE_BIT)
        piece = self._data[self._sent : self._sent + 7]
        self._sent += len(piece)
        last = self._sent >= len(self._data)
        head = self._toggle | (7 - len(piece)) << 1 | int(last)
        self._toggle ^= 0x10
        return [bytes((head,)) + piece.ljust(7, b"\0")], last


class _Download:
    """A segmented download under way: the value is written when the last segment has come."""

    def __init__(self, objects: Objects, index: int, subindex: int, announced: int | None) -> None:
        self.index, self.subindex = index, subindex
        self._objects, self._announced = objects, announced
        self._data, self._toggle = bytearray(), 0

    def answer(self, frame: bytes) -> tuple[list[bytes], bool]:
        """Return the frames that answer a frame of the client, and whether the transfer is over."""
        if frame[0] >> 5 != 0:
            raise SdoAbortError(abort.UNKNOWN_COMMAND)
        if frame[0] & 0x10 != self._toggle:
            raise SdoAbortError(abort.TOGGLE_BIT)
        self._data += frame[1 : 8 - (frame[0] >> 1 & 7)]
        last = bool(frame[0] & 1)
        if self._announced is not None and len(self._data) > self._announced:
            raise SdoAbortError(abort.TOO_LONG)
        if last:
            if self._announced is not None and len(self._data) < self._announced:
                raise SdoAbortError(abort.TOO_SHORT)
            self._objects.write(self.index, self.subindex, bytes(self._data))
        answer = bytes((_SCS_SEGMENT_DOWNLOAD | self._toggle,)) + bytes(7)
        self._toggle ^= 0x10
        return [answer], last


class SdoServer:
    """The server of a device: answers requests with frames handed to `send`, and keeps the one transfer under way.

    A client that pauses for `CLIENT_TIMEOUT_S` is taken for dead, and its transfer is aborted.
    """

    def __init__(self, node: Port, send: Callable[[bytes], None]) -> None:
        self._node = node
        self._objects = node.objects
        self._send = send
        self.deadline_s = math.inf
        self._transfer: _Upload | _Download | BlockUpload | BlockDownload | None = None

    def reset(self) -> None:
        """Forget a transfer under way, silently."""
        self._transfer = None
        self.deadline_s = math.inf

    def expire(self, now_s: float) -> None:
        """Abort the transfer of a client that has not gone on in time."""
        if now_s >= self.deadline_s:
            transfer, self._transfer, self.deadline_s = self._transfer, None, math.inf
            if transfer is not None:
                self._send(_HEAD.pack(0x80, transfer.index, transfer.subindex, abort.TIMED_OUT))

    def receive(self, frame: bytes) -> None:
        """Answer one request frame (8 bytes)."""
        self._answer(frame)
        self.deadline_s = math.inf if self._transfer is None else self._node.after(CLIENT_TIMEOUT_S)
        self._node.schedule(self.deadline_s)

    def _answer(self, frame: bytes) -> None:
        if frame[0] >> 5 == 4 and not isinstance(self._transfer, BlockDownload):
            self._transfer = None  # the client aborts: no answer
            return
        index, subindex = struct.unpack_from("<HB", frame, 1)
        transfer = self._transfer
        try:
            if transfer is not None and (transfer_takes(transfer, frame)):
                index, subindex = transfer.index, transfer.subindex
                answers, done = transfer.answer(frame)
                if done:
                    self._transfer = None
                for answer in answers:
                    self._send(answer)
            else:
                self._transfer = None
                self._initiate(frame, index, subindex)
        except SdoAbortError as refusal:
            self._transfer = None
            self._send(_HEAD.pack(0x80, index, subindex, refusal.code))

    def _initiate(self, frame: bytes, index: int, subindex: int) -> None:
        command = frame[0] >> 5
        if command == 2:
            self._initiate_upload(index, subindex)
        elif command == 1:
            self._initiate_download(frame, index, subindex)
        elif command == 5 and frame[0] & 3 == 0:
            self._transfer = BlockUpload(index, subindex, frame, self._objects.read(index, subindex))
            self._send(self._transfer.opening)
        elif command == 6 and frame[0] & 1 == 0:
            self._objects.writable_entry(index, subindex)
            self._transfer = BlockDownload(self._objects, index, subindex, frame)
            self._send(self._transfer.opening)
        else:
            raise SdoAbortError(abort.UNKNOWN_COMMAND)

    def _initiate_upload(self, index: int, subindex: int) -> None:
        data = self._objects.read(index, subindex)
        if 1 <= len(data) <= 4:
            self._send(struct.pack("<BHB", 0x43 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0"))
            return
        self._transfer = _Upload(index, subindex, data)
        self._send(_HEAD.pack(0x41, index, subindex, len(data)))

    def _initiate_download(self, frame: bytes, index: int, subindex: int) -> None:
        expedited, sized = frame[0] & 2, frame[0] & 1
        entry = self._objects.writable_entry(index, subindex)
        size = (entry.bits + 7) // 8
        if expedited:
            length = 4 - (frame[0] >> 2 & 3) if sized else (size if 0 < size <= 4 else 4)
            self._objects.write(index, subindex, frame[4 : 4 + length])
        else:
            announced = struct.unpack_from("<I", frame, 4)[0] if sized else None
            if announced is not None and size and announced != size:
                raise SdoAbortError(abort.TOO_LONG if announced > size else abort.TOO_SHORT)
            self._transfer = _Download(self._objects, index, subindex, announced)
        self._send(_HEAD.pack(_SCS_INITIATE_DOWNLOAD, index, subindex, 0))


def transfer_takes(transfer: _Upload | _Download | BlockUpload | BlockDownload, frame: bytes) -> bool:
    """Return whether the frame belongs to the transfer under way.

    A new initiate request ends the old transfer instead.
    """
    if isinstance(transfer, BlockDownload):
        return True  # inside a block every byte pattern is a segment
    command = frame[0] >> 5
    if isinstance(transfer, BlockUpload):
        return command == 5 and frame[0] & 3 != 0
    return command in (0, 3)
