"""Xbus, the protocol by which an Xsens motion tracker frames messages and packs its readings.

A message is `FA BID MID LEN DATA CS`; LEN 0xFF announces two further length bytes. All bytes but the preamble sum to zero modulo 256.
An MTData2 message holds packets `identifier (2 bytes), size (1 byte), value`, big endian throughout.

Source: Xsens, MT Low Level Communication Protocol, MT0101P (messages: ch. 5; MTData2 and its data identifiers: XDI tables). The sync line's
number on the wire: Xsens Device API, `synclinemk4.h`.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple
from zlib import adler32

from drivers.errors import ProtocolError

PREAMBLE = 0xFA
MASTER_BUS_ID = 0xFF  # a tracker that stands alone uses it too
BUS_IDS = (MASTER_BUS_ID, 0x01)  # 0x01: the same tracker as first device on an Xbus
EXTENDED_LENGTH = 0xFF
MAX_DATA_BYTES = 2048
TIME_TICKS_Hz = 10_000  # sample time fine
_MOST_BYTES_OF_ADLER = 65_521 // 0xFF  # its halves are sums modulo 65,521
MAX_RATE = 0xFFFF  # in an output configuration: as fast as the device can, or with every message


class MessageId(IntEnum):
    """Message identifiers this bench uses. An acknowledge bears the command's identifier plus one."""

    REQ_DEVICE_ID = 0x00
    GO_TO_MEASUREMENT = 0x10
    REQ_FIRMWARE_REVISION = 0x12
    REQ_PRODUCT_CODE = 0x1C
    SET_SYNC_SETTINGS = 0x2C  # without data: a request
    GO_TO_CONFIG = 0x30
    MTDATA2 = 0x36
    WAKE_UP = 0x3E  # from the device, after power-on
    WAKE_UP_ACK = 0x3F
    RESET = 0x40
    ERROR = 0x42
    SET_OUTPUT_CONFIGURATION = 0xC0  # without data: a request


class ErrorCode(IntEnum):
    """First data byte of an error message."""

    INVALID_PERIOD = 0x03
    INVALID_MESSAGE = 0x04
    TIMER_OVERFLOW = 0x1E
    INVALID_BAUD_RATE = 0x20
    INVALID_PARAMETER = 0x21
    DEVICE_ERROR = 0x28
    DATA_OVERFLOW = 0x29


class DataId(IntEnum):
    """MTData2 identifiers, format bits zero."""

    PACKET_COUNTER = 0x1020
    SAMPLE_TIME_FINE = 0x1060
    ACCELERATION = 0x4020
    RATE_OF_TURN = 0x8020
    STATUS_WORD = 0xE020


FORMAT_BITS = 0x000F  # bits 0 and 1: precision; bits 2 and 3: coordinate system
PRECISION_BITS = 0x0003


class Precision(IntEnum):
    """How a real number is packed: the two lowest bits of a data identifier."""

    FLOAT32 = 0
    FIXED_12_20 = 1
    FIXED_16_32 = 2
    FLOAT64 = 3


STATUS_SELF_TEST_PASSED = 1 << 0
STATUS_FILTER_VALID = 1 << 1
STATUS_SYNC_IN = 1 << 21

SYNC_FUNCTION_SEND_LATEST = 8  # a pulse on the line makes the device send its latest sample
SYNC_LINE_IN1 = 2
SYNC_RISING_EDGE = 1


class Message(NamedTuple):
    """One Xbus message, checksum verified."""

    message_id: int
    data: bytes


class SyncSetting(NamedTuple):
    """One entry of SetSyncSettings, in the order of the wire."""

    function: int
    line: int
    polarity: int
    trigger_once: int
    skip_first: int
    skip_factor: int
    pulse_width: int
    delay: int


NO_SYNC = SyncSetting(0, 0, 0, 0, 0, 0, 0, 0)  # clears the list: SetSyncSettings without data would be a request


class Reading(NamedTuple):
    """Values of one MTData2 message that the bench uses. None: the message does not hold the value."""

    counter: int | None  # 16 bit, wraps
    time_ticks: int | None  # 32 bit at 10 kHz, wraps
    acceleration: tuple[float, ...] | None  # m/s^2
    rate_of_turn: tuple[float, ...] | None  # rad/s
    status: int | None


Values = tuple[int | None, int | None, tuple[float, ...] | None, tuple[float, ...] | None, int | None]
"""Those of a `Reading`, without their names."""


def encode(message_id: int, data: bytes = b"") -> bytes:
    """Return the bytes of one message to or from a stand-alone tracker.

    Raises
    ------
    ProtocolError
        There are more than 2048 data bytes.
    """
    size = len(data)
    if size > MAX_DATA_BYTES:
        raise ProtocolError(f"xbus: {size} data bytes in message 0x{message_id:02X}: a message carries at most {MAX_DATA_BYTES}")
    length = (size,) if size < EXTENDED_LENGTH else (EXTENDED_LENGTH, size >> 8, size & 0xFF)
    return _closed(bytes((PREAMBLE, MASTER_BUS_ID, message_id, *length)) + data)


def _closed(message: bytes) -> bytes:
    """Return a message behind its preamble with the checksum that makes its other bytes sum to zero modulo 256."""
    return message + (PREAMBLE - _sum(message) & 0xFF).to_bytes(1, "big")


def _sum(data: bytes | memoryview) -> int:
    """Return the sum of bytes: of so few, the lower half of an Adler-32 that begins at zero, which makes no number of each byte."""
    return adler32(data, 0) & 0xFFFF if len(data) <= _MOST_BYTES_OF_ADLER else sum(data)


class StreamParser:
    """Finds messages in a stream of bytes that may start anywhere, contain invalid bytes and arrive in pieces.

    After a wrong checksum only the preamble is skipped, so that a good message inside a damaged one is still found.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.checksum_errors = 0
        self.skipped_bytes = 0

    def feed(self, data: bytes) -> list[Message]:
        """Add received bytes; return the messages that they complete, in order."""
        buffer = self._buffer
        buffer += data
        available = len(buffer)
        messages: list[Message] = []
        start = 0
        while True:
            preamble = buffer.find(PREAMBLE, start)
            if preamble < 0:
                self.skipped_bytes += available - start
                start = available
                break
            self.skipped_bytes += preamble - start
            start = preamble
            end = self._end(start, available)
            if end > available:
                break
            if end < 0 or _sum(memoryview(buffer)[start + 1 : end]) & 0xFF:
                self.checksum_errors += end > 0
                self.skipped_bytes += 1
                start += 1
                continue
            header = 6 if buffer[start + 3] == EXTENDED_LENGTH else 4
            messages.append(Message(buffer[start + 2], bytes(buffer[start + header : end - 1])))
            start = end
        del buffer[:start]
        return messages

    def whole_reading(self, data: bytes) -> Values | None:
        """Take received bytes that are one whole message as this bench configures it; None: `feed` has to take them."""
        is_one = len(data) == _STANDARD.size + 1 and not self._buffer and _sum(data) & 0xFF == PREAMBLE
        return _standard_reading(data) if is_one else None

    def give_up(self) -> list[Message]:
        """Return the messages behind a false start that still waits for its end; call this when nothing more will come."""
        messages: list[Message] = []
        while self._buffer:
            del self._buffer[0]
            self.skipped_bytes += 1
            messages += self.feed(b"")
        return messages

    def _end(self, start: int, available: int) -> int:
        """Return the index after the message that starts here; beyond `available` when it is incomplete; -1 when none can start here."""
        buffer = self._buffer
        if start + 1 < available and buffer[start + 1] not in BUS_IDS:
            return -1
        if start + 4 > available:
            return available + 1
        size = buffer[start + 3]
        if size != EXTENDED_LENGTH:
            return start + 5 + size
        if start + 6 > available:
            return available + 1
        size = buffer[start + 4] << 8 | buffer[start + 5]
        return -1 if size > MAX_DATA_BYTES else start + 7 + size


def pack_reals(values: tuple[float, ...], precision: int) -> bytes:
    """Pack real numbers in one of the four formats; fixed point rounds to nearest and must be in range."""
    if precision == Precision.FLOAT32:
        return struct.pack(f">{len(values)}f", *values)
    if precision == Precision.FLOAT64:
        return struct.pack(f">{len(values)}d", *values)
    try:
        if precision == Precision.FIXED_12_20:
            return struct.pack(f">{len(values)}i", *(round(value * 2**20) for value in values))
        packed = b""
        for value in values:
            integer, fraction = divmod(round(value * 2**32), 2**32)
            packed += struct.pack(">Ih", fraction, integer)  # the fraction travels first
        return packed
    except (struct.error, ValueError, OverflowError) as error:
        raise ProtocolError(f"xbus: {values} does not fit {Precision(precision).name}") from error


REAL_BYTES = {Precision.FLOAT32: 4, Precision.FIXED_12_20: 4, Precision.FIXED_16_32: 6, Precision.FLOAT64: 8}


def unpack_reals(data: bytes, precision: int) -> tuple[float, ...]:
    """Unpack real numbers, the inverse of `pack_reals`.

    Raises
    ------
    ProtocolError
        The size is not a multiple of one number's.
    """
    count, rest = divmod(len(data), REAL_BYTES[Precision(precision)])
    if rest:
        raise ProtocolError(f"xbus: {len(data)} bytes hold no whole number of {Precision(precision).name}")
    if precision == Precision.FLOAT32:
        return struct.unpack(f">{count}f", data)
    if precision == Precision.FLOAT64:
        return struct.unpack(f">{count}d", data)
    if precision == Precision.FIXED_12_20:
        return tuple(value / 2**20 for value in struct.unpack(f">{count}i", data))
    return tuple(integer + fraction / 2**32 for fraction, integer in struct.iter_unpack(">Ih", data))


def encode_mtdata2(packets: list[tuple[int, bytes]]) -> bytes:
    """Return an MTData2 message of (identifier, value) packets, in order."""
    return encode(MessageId.MTDATA2, b"".join(struct.pack(">HB", identifier, len(value)) + value for identifier, value in packets))


def decode_mtdata2(data: bytes) -> list[tuple[int, bytes]]:
    """Return the (identifier, value) packets of an MTData2 message's data.

    Raises
    ------
    ProtocolError
        A packet ends beyond the message.
    """
    packets = []
    start, end = 0, len(data)
    while start < end:
        value = start + 3
        stop = value + data[start + 2] if value <= end else end + 1
        if stop > end:
            raise ProtocolError(f"xbus: an MTData2 packet at byte {start} of {end} ends beyond the message")
        packets.append((data[start] << 8 | data[start + 1], data[value:stop]))
        start = stop
    return packets


# The message that this bench configures, all fields in float32, has its own struct, because one passes in every tick.
_STANDARD = struct.Struct(">7sH3sI3s3f3s3f3sI")  # without its checksum
_START = encode(MessageId.MTDATA2, bytes(_STANDARD.size - 4))[:4]
_ONE, _TWO, _THREE, _FOUR, _FIVE = (
    head + struct.pack(">HB", identifier, size)
    for head, identifier, size in (
        (_START, DataId.PACKET_COUNTER, 2),
        (b"", DataId.SAMPLE_TIME_FINE, 4),
        (b"", DataId.ACCELERATION, 12),
        (b"", DataId.RATE_OF_TURN, 12),
        (b"", DataId.STATUS_WORD, 4),
    )
)


def _standard_reading(message: bytes) -> Values | None:
    """Read a message whose packets lie as this bench configures them; None where they lie otherwise."""
    one, counter, two, time_ticks, three, x, y, z, four, p, q, r, five, status = _STANDARD.unpack_from(message)
    if one != _ONE or two != _TWO or three != _THREE or four != _FOUR or five != _FIVE:
        return None
    return counter, time_ticks, (x, y, z), (p, q, r), status


_FLOAT32 = Precision.FLOAT32  # a module's name is looked up faster than a member of an enumeration


def encode_reading(reading: Values, precision: Precision = _FLOAT32) -> bytes:
    """Return an MTData2 message with the values of a reading, in the order of its fields."""
    counter, time_ticks, acceleration, rate_of_turn, status = reading
    if precision == _FLOAT32 and acceleration is not None and rate_of_turn is not None and None not in reading:
        (x, y, z), (p, q, r) = acceleration, rate_of_turn
        return _closed(_STANDARD.pack(_ONE, counter, _TWO, time_ticks, _THREE, x, y, z, _FOUR, p, q, r, _FIVE, status))
    packets: list[tuple[int, bytes]] = []
    if counter is not None:
        packets.append((DataId.PACKET_COUNTER, struct.pack(">H", counter)))
    if time_ticks is not None:
        packets.append((DataId.SAMPLE_TIME_FINE, struct.pack(">I", time_ticks)))
    if acceleration is not None:
        packets.append((DataId.ACCELERATION | precision, pack_reals(acceleration, precision)))
    if rate_of_turn is not None:
        packets.append((DataId.RATE_OF_TURN | precision, pack_reals(rate_of_turn, precision)))
    if status is not None:
        packets.append((DataId.STATUS_WORD, struct.pack(">I", status)))
    return encode_mtdata2(packets)


def decode_reading(data: bytes) -> Reading:
    """Read the data of an MTData2 message; packets that the bench does not use are skipped, as the protocol requires.

    Raises
    ------
    ProtocolError
        A packet is cut off or has the wrong size.
    """
    if len(data) == _STANDARD.size - len(_START) and (values := _standard_reading(_START + data)) is not None:
        return Reading(*values)
    counter = time_ticks = status = None
    acceleration = rate_of_turn = None
    for identifier, value in decode_mtdata2(data):
        kind = identifier & ~FORMAT_BITS
        if kind == DataId.PACKET_COUNTER:
            counter = _unsigned(value, 2)
        elif kind == DataId.SAMPLE_TIME_FINE:
            time_ticks = _unsigned(value, 4)
        elif kind == DataId.ACCELERATION:
            acceleration = _vector(identifier, value)
        elif kind == DataId.RATE_OF_TURN:
            rate_of_turn = _vector(identifier, value)
        elif kind == DataId.STATUS_WORD:
            status = _unsigned(value, 4)
    return Reading(counter, time_ticks, acceleration, rate_of_turn, status)


def _unsigned(value: bytes, size: int) -> int:
    if len(value) != size:
        raise ProtocolError(f"xbus: a packet of {len(value)} bytes where {size} belong")
    return int.from_bytes(value, "big")


def _vector(identifier: int, value: bytes) -> tuple[float, ...]:
    vector = unpack_reals(value, identifier & PRECISION_BITS)
    if len(vector) != 3:
        raise ProtocolError(f"xbus: packet 0x{identifier:04X} holds {len(vector)} numbers: a vector has 3")
    return vector


def encode_output_configuration(entries: list[tuple[int, int]]) -> bytes:
    """Return the data of SetOutputConfiguration: (identifier, output rate in Hz) each."""
    return b"".join(struct.pack(">HH", *entry) for entry in entries)


def decode_output_configuration(data: bytes) -> list[tuple[int, int]]:
    """Read the data of SetOutputConfiguration, the inverse of `encode_output_configuration`."""
    if len(data) % 4:
        raise ProtocolError(f"xbus: an output configuration of {len(data)} bytes: 4 per entry belong")
    return [(identifier, rate) for identifier, rate in struct.iter_unpack(">HH", data)]


_SYNC_SETTING = struct.Struct(">BBBBHHHH")


def encode_sync_settings(settings: list[SyncSetting]) -> bytes:
    """Return the data of SetSyncSettings: 12 bytes per setting."""
    return b"".join(_SYNC_SETTING.pack(*setting) for setting in settings)


def decode_sync_settings(data: bytes) -> list[SyncSetting]:
    """Read the data of SetSyncSettings, the inverse of `encode_sync_settings`."""
    if len(data) % _SYNC_SETTING.size:
        raise ProtocolError(f"xbus: sync settings of {len(data)} bytes: {_SYNC_SETTING.size} per setting belong")
    return [SyncSetting(*fields) for fields in _SYNC_SETTING.iter_unpack(data)]
