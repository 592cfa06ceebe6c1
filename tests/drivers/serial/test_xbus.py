"""Xbus: bytes as the manufacturer documents them and as trackers send them; nothing is lost to garbage, splits or damage."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from refusals import answer_or_refusal

from drivers.errors import ProtocolError
from drivers.serial.xbus import (
    DataId,
    ErrorCode,
    Message,
    MessageId,
    Precision,
    Reading,
    StreamParser,
    SyncSetting,
    decode_mtdata2,
    decode_output_configuration,
    decode_reading,
    decode_sync_settings,
    encode,
    encode_mtdata2,
    encode_output_configuration,
    encode_reading,
    encode_sync_settings,
    pack_reals,
    unpack_reals,
)

# (message id, data, bytes on the wire): MT Low Level Communication Protocol MT0101P, and captures from MTi trackers on public record
DOCUMENTED = [
    (MessageId.GO_TO_CONFIG, "", "FA FF 30 00 D1"),
    (MessageId.GO_TO_CONFIG + 1, "", "FA FF 31 00 D0"),
    (MessageId.GO_TO_MEASUREMENT, "", "FA FF 10 00 F1"),
    (MessageId.REQ_DEVICE_ID, "", "FA FF 00 00 01"),
    (MessageId.RESET, "", "FA FF 40 00 C1"),
    (MessageId.ERROR, "04", "FA FF 42 01 04 BA"),
    (
        MessageId.SET_OUTPUT_CONFIGURATION,
        "1020FFFF 1060FFFF 20100064 40200190 80200190 C0200064 E020FFFF 50420064 50220064 D0120064",
        "FA FF C0 28 10 20 FF FF 10 60 FF FF 20 10 00 64 40 20 01 90 80 20 01 90 C0 20 00 64 E0 20 FF FF 50 42 00 64 50 22 00 64"
        " D0 12 00 64 73",
    ),
    (MessageId.MTDATA2, "80400C3B8BBC00BBE24F003B4E4A00", "FA FF 36 0F 80 40 0C 3B 8B BC 00 BB E2 4F 00 3B 4E 4A 00 AF"),
]

# From an MTi-630 at rest: time, quaternion, rate of turn (HR), magnetic field, acceleration, status word
LONGEST = 2048  # bytes of data in an extended message: MT Low-Level Communication Protocol Documentation
CAPTURED_AT_REST = bytes.fromhex(
    "FA FF 36 4E 10 60 04 02 53 35 CB 20 10 10 3F 7F FA 66 BB 40 34 B8 3C 49 96 2D 3B 5A 1F 82 80 20 0C 39 FF 91 01 BA EC DD 81 BA 86 53"
    " 80 40 20 0C BE 64 DB 99 BC E7 FF 83 41 1D C2 CF C0 20 0C BE 90 48 80 3F 67 32 04 BF 54 89 04 E0 20 04 00 00 00 03 C9"
)

messages = st.tuples(st.integers(0, 255), st.binary(max_size=40)) | st.tuples(st.integers(0, 255), st.binary(min_size=250, max_size=300))
finite = st.floats(-30000, 30000)


@pytest.mark.parametrize(("message_id", "data", "wire"), DOCUMENTED)
def test_documented_messages_encode_and_decode(message_id: MessageId | int, data: str, wire: str) -> None:
    assert encode(message_id, bytes.fromhex(data)) == bytes.fromhex(wire)
    assert StreamParser().feed(bytes.fromhex(wire)) == [Message(message_id, bytes.fromhex(data))]


def test_a_captured_reading_decodes_to_a_tracker_at_rest() -> None:
    (message,) = StreamParser().feed(CAPTURED_AT_REST)
    reading = decode_reading(message.data)
    assert reading.counter is None
    assert reading.time_ticks == 0x025335CB
    assert reading.status == 3
    assert math.hypot(*reading.acceleration) == pytest.approx(9.81, abs=0.08)
    assert reading.acceleration[2] == pytest.approx(9.8601, abs=1e-4)
    assert math.hypot(*reading.rate_of_turn) < 0.003


def test_every_message_sums_to_zero_without_its_preamble() -> None:
    for size in (0, 1, 253, 254, 255, 256, LONGEST):
        assert sum(encode(0x36, bytes(range(256)) * 8)[1:]) % 256 == 0
        assert StreamParser().feed(encode(0x36, bytes(size))) == [Message(0x36, bytes(size))]
    assert encode(0x36, bytes(254))[3] == 254
    assert encode(0x36, bytes(255))[3:6] == b"\xff\x00\xff"


def test_a_message_that_is_too_long_is_refused() -> None:
    with pytest.raises(ProtocolError, match="at most 2048"):
        encode(0x36, bytes(LONGEST + 1))


@pytest.mark.slow
@given(st.lists(messages, max_size=6), st.lists(st.integers(1, 60), max_size=40))
def test_split_reads_lose_nothing(sent: list[tuple[int, bytes]], cuts: list[int]) -> None:
    stream = b"".join(encode(*message) for message in sent)
    parser = StreamParser()
    received, start = [], 0
    for cut in [*cuts, len(stream)]:
        received += parser.feed(stream[start : start + cut])
        start += cut
    assert received == [Message(*message) for message in sent]
    assert parser.checksum_errors == parser.skipped_bytes == 0


@given(st.lists(st.tuples(st.binary(max_size=20), messages), min_size=1, max_size=5))
@example([(b"\xfa", (0x36, b"")), (b"\xfa\xff\x36", (0x36, b"\xfa\xff"))])
def test_garbage_between_messages_hides_none(parts: list[tuple[bytes, tuple[int, bytes]]]) -> None:
    parser = StreamParser()
    received = parser.feed(b"".join(garbage + encode(*message) for garbage, message in parts))
    received += parser.feed(bytes(LONGEST + 8))  # a false start may wait for as many bytes
    sent = [Message(*message) for _, message in parts]
    made_up = [message for message in received if message not in sent]
    if not made_up:  # garbage can spell a valid message: one in 256 false starts has a fitting checksum
        assert received == sent


@given(messages, st.data())
def test_any_single_damaged_byte_is_noticed(message: tuple[int, bytes], data: st.DataObject) -> None:
    wire = bytearray(encode(*message))
    position = data.draw(st.integers(1, len(wire) - 1))
    wire[position] ^= data.draw(st.integers(1, 255))
    received = StreamParser().feed(bytes(wire) + bytes(LONGEST + 8))
    assert Message(*message) not in received


def test_any_single_damaged_bit_is_noticed() -> None:
    for position in range(8, 8 * len(CAPTURED_AT_REST)):
        wire = bytearray(CAPTURED_AT_REST)
        wire[position // 8] ^= 1 << position % 8
        assert all(message.message_id != MessageId.MTDATA2 for message in StreamParser().feed(bytes(wire)))


def test_damage_is_counted_and_the_next_message_is_read() -> None:
    parser = StreamParser()
    damaged = bytearray(CAPTURED_AT_REST)
    damaged[40] ^= 0x10
    assert parser.feed(bytes(damaged) + CAPTURED_AT_REST) == StreamParser().feed(CAPTURED_AT_REST)
    assert parser.checksum_errors >= 1


def test_a_lost_byte_costs_one_message_only() -> None:
    parser = StreamParser()
    short = CAPTURED_AT_REST[:30] + CAPTURED_AT_REST[31:]
    assert len(parser.feed(short + CAPTURED_AT_REST + CAPTURED_AT_REST)) == 2


def test_giving_up_finds_what_a_cut_off_message_hides() -> None:
    parser = StreamParser()
    assert parser.feed(CAPTURED_AT_REST[:30] + encode(0x31)) == []
    assert parser.give_up() == [Message(0x31, b"")]
    assert parser.feed(encode(0x11)) == [Message(0x11, b"")]


@given(st.binary(max_size=300))
def test_no_bytes_make_the_parser_fail(data: bytes) -> None:
    parser = StreamParser()
    for message in parser.feed(data):
        assert len(message.data) <= LONGEST


def test_fixed_point_is_packed_as_documented() -> None:
    # MT0101P, fixed-point formats: round(x * 2^20) as int32; round(x * 2^32) in 48 bits, the 32 fraction bits first
    assert pack_reals((1.5,), Precision.FIXED_12_20) == bytes.fromhex("00180000")
    assert pack_reals((-1.0,), Precision.FIXED_12_20) == bytes.fromhex("FFF00000")
    assert pack_reals((3.1415,), Precision.FIXED_16_32) == bytes.fromhex("243958100003")
    assert pack_reals((-0.25,), Precision.FIXED_16_32) == bytes.fromhex("C0000000FFFF")
    assert unpack_reals(bytes.fromhex("243958100003"), Precision.FIXED_16_32)[0] == pytest.approx(3.1415, abs=2**-32)


@pytest.mark.parametrize("precision", [Precision.FIXED_12_20, Precision.FIXED_16_32])
@pytest.mark.parametrize("value", [1e6, -1e6, math.nan, math.inf])
def test_fixed_point_out_of_range_is_refused(precision: Precision, value: float) -> None:
    with pytest.raises(ProtocolError, match="does not fit"):
        pack_reals((value,), precision)


@given(st.lists(finite, min_size=3, max_size=3), st.sampled_from(Precision))
def test_reals_survive_within_their_resolution(values: list[float], precision: Precision) -> None:
    if precision == Precision.FIXED_12_20:
        values = [value / 15 for value in values]
    resolution = {Precision.FIXED_12_20: 2**-20, Precision.FIXED_16_32: 2**-32, Precision.FLOAT32: 2e-3, Precision.FLOAT64: 0.0}[precision]
    assert unpack_reals(pack_reals(tuple(values), precision), precision) == pytest.approx(values, abs=resolution, rel=0)


vectors = st.tuples(*[st.floats(-100, 100, width=32)] * 3)
readings = st.builds(
    Reading,
    st.none() | st.integers(0, 0xFFFF),
    st.none() | st.integers(0, 0xFFFFFFFF),
    st.none() | vectors,
    st.none() | vectors,
    st.none() | st.integers(0, 0xFFFFFFFF),
)


@given(readings, st.sampled_from([Precision.FLOAT32, Precision.FLOAT64]))
def test_readings_survive_the_wire_exactly(reading: Reading, precision: Precision) -> None:
    (message,) = StreamParser().feed(encode_reading(reading, precision))
    assert message.message_id == MessageId.MTDATA2
    assert decode_reading(message.data) == reading


def test_unknown_packets_are_skipped() -> None:
    known = (DataId.PACKET_COUNTER, b"\x00\x07")
    message = encode_mtdata2([(0x2010, bytes(16)), known, (0xC020, bytes(12))])
    assert decode_reading(StreamParser().feed(message)[0].data).counter == 7


@given(st.binary(max_size=80))
def test_no_reading_makes_the_decoder_fail_without_a_clear_error(data: bytes) -> None:
    _, refusal = answer_or_refusal(ProtocolError, decode_reading, data)
    assert refusal is None or refusal.startswith("xbus: ")


@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.binary(max_size=20)), max_size=8))
def test_packets_survive(packets: list[tuple[int, bytes]]) -> None:
    (message,) = StreamParser().feed(encode_mtdata2(packets))
    assert decode_mtdata2(message.data) == packets


@pytest.mark.parametrize("data", ["1020", "102002", "10200200", "1020030000", "10200300 0000", "40200800000000 00000000", "402003000000"])
def test_a_packet_of_the_wrong_size_is_refused(data: str) -> None:
    with pytest.raises(ProtocolError):
        decode_reading(bytes.fromhex(data))


@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF)), max_size=8))
def test_output_configurations_survive(entries: list[tuple[int, int]]) -> None:
    assert decode_output_configuration(encode_output_configuration(entries)) == entries


def test_sync_settings_lie_as_documented() -> None:
    # function, line, polarity, trigger once: bytes; skip first, skip factor, pulse width, delay: words
    setting = SyncSetting(8, 2, 1, 0, 1, 2, 3, 4)
    data = encode_sync_settings([setting])
    assert data == bytes.fromhex("08020100 0001 0002 0003 0004")
    assert decode_sync_settings(data) == [setting]


@pytest.mark.parametrize("decode", [decode_output_configuration, decode_sync_settings])
def test_settings_of_the_wrong_size_are_refused(decode: Callable[..., object]) -> None:
    with pytest.raises(ProtocolError, match="belong"):
        decode(bytes(7))


def test_error_codes_are_the_documented_ones() -> None:
    assert (ErrorCode.INVALID_PERIOD, ErrorCode.INVALID_MESSAGE, ErrorCode.INVALID_PARAMETER) == (3, 4, 33)
