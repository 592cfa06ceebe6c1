"""Readings of the IMU, row by row: exact, missing, damaged, late, wrapped, faulty."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from imu_wiring import IMU, PERIOD_S, Bench, no_wait, reading

from drivers.serial.xbus import (
    ErrorCode,
    MessageId,
    Precision,
    Reading,
    encode,
    encode_reading,
)

WHOLE = reading(7, 70)
OTHER = encode_reading(Reading(8, None, (0.0, 0.0, 9.81), (0.0, 0.0, 0.0), 1))
parts = st.sampled_from([WHOLE, OTHER, WHOLE[:30], encode(MessageId.WAKE_UP), b"\xfa"])
changes = st.lists(st.tuples(st.integers(0, len(WHOLE) - 1), st.integers(0, 255)), max_size=2)


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.driver.configure(no_wait)
    return bench


def test_every_sync_brings_one_reading_exact_to_float32(bench: Bench) -> None:
    for number in range(1, 20):
        imu = IMU * number
        assert bench.tick(number, imu)
        assert np.array_equal(bench.sample.imu, imu)
        assert bench.sample.imu_counter == number - 1
        assert bench.sample.imu_time_s == pytest.approx(number * PERIOD_S, abs=5.1e-5)  # 10 kHz ticks
    assert bench.driver.lost_packets == bench.driver.late_packets == bench.driver.checksum_errors == 0
    assert bench.sample.fault == ""


def test_the_device_sends_nothing_between_syncs_when_triggered(bench: Bench) -> None:
    assert bench.device.advance(5.0) == b""
    assert not bench.driver.poll(bench.sample)


def test_a_missing_packet_is_nan_and_not_the_last_one_again(bench: Bench) -> None:
    assert bench.tick(1)
    assert not bench.driver.poll(bench.sample)
    assert np.all(np.isnan(bench.sample.imu))
    assert math.isnan(bench.sample.imu_time_s)
    assert bench.sample.imu_counter == -1


def test_lost_packets_show_in_the_counter(bench: Bench) -> None:
    bench.tick(1)
    for number in (2, 3, 4):
        bench.device.on_sync(IMU, number * PERIOD_S)  # never reaches the line
    bench.tick(5)
    assert bench.driver.lost_packets == 3
    assert bench.sample.imu_counter == 4


def test_a_damaged_packet_is_counted_and_missing_in_its_row_only(bench: Bench) -> None:
    bench.tick(1)
    damaged = bytearray(bench.device.on_sync(IMU, 2 * PERIOD_S))
    damaged[20] ^= 0xFF
    bench.device_end.write(bytes(damaged))
    assert not bench.driver.poll(bench.sample)
    assert bench.tick(3)
    assert bench.driver.checksum_errors == 1
    assert bench.driver.lost_packets == 1


def test_a_packet_that_comes_after_its_row_was_closed_is_in_no_row(bench: Bench) -> None:
    bench.tick(1)
    late = bench.device.on_sync(IMU * 2, 2 * PERIOD_S)
    assert not bench.driver.poll(bench.sample)
    bench.device_end.write(late)
    assert bench.tick(3, IMU * 3)
    assert np.array_equal(bench.sample.imu, IMU * 3)
    assert (bench.driver.late_packets, bench.driver.lost_packets) == (1, 0)


def test_a_packet_split_over_two_reads_arrives_whole(bench: Bench) -> None:
    packet = bench.device.on_sync(IMU, PERIOD_S)
    bench.device_end.write(packet[:23])
    assert not bench.driver.poll(bench.sample)
    bench.device_end.write(packet[23:])
    assert bench.driver.poll(bench.sample)
    assert np.array_equal(bench.sample.imu, IMU)


def row(bench: Bench, pieces: list[bytes]) -> tuple[object, ...]:
    """What has come when these pieces have arrived one after the other, each polled by itself."""
    got = None
    for piece in pieces:
        bench.device_end.write(piece)
        if bench.driver.poll(bench.sample):
            got = bench.sample.imu.tolist(), bench.sample.imu_time_s, bench.sample.imu_counter
    driver, sample = bench.driver, bench.sample
    faults = driver.malformed, driver.first_malformed, driver.lost_packets, sample.imu_damaged, sample.imu_fault
    return repr(got), *faults


@given(st.lists(st.tuples(parts, changes, st.booleans()), max_size=4))
@example([(WHOLE, [], False)])
@example([(WHOLE[:30], [], False), (WHOLE, [], False)])  # the second is hidden until the first, cut off, has its length
@example([(WHOLE, [(40, 1)], False), (WHOLE, [], False)])
@example([(WHOLE, [(1, 0x01)], True), (WHOLE, [(2, 0x42)], True)])  # the other bus id, another message
@example([(WHOLE, [(4, 0x11)], True), (WHOLE, [(3, 0x30)], True)])  # another identifier, another length
def test_bytes_mean_the_same_whether_they_arrive_at_once_or_one_by_one(sent: list[tuple[bytes, list[tuple[int, int]], bool]]) -> None:
    at_once, one_by_one = Bench(), Bench()
    for part, changed, fits in sent:
        wire = bytearray(part)
        for position, byte in changed:
            wire[position % len(wire)] = byte
        if fits:
            wire[-1] = -sum(wire[1:-1]) & 0xFF
        assert row(at_once, [bytes(wire)]) == row(one_by_one, [bytes((byte,)) for byte in wire])


def test_counter_and_time_run_on_where_the_device_wraps(bench: Bench) -> None:
    bench.device_end.write(reading(0xFFFF, 0xFFFFFFF0))
    bench.driver.poll(bench.sample)
    before_s = bench.sample.imu_time_s
    bench.device_end.write(reading(0, 0x17))
    bench.driver.poll(bench.sample)
    assert bench.sample.imu_counter == 0x10000
    assert bench.sample.imu_time_s - before_s == pytest.approx(39e-4)
    bench.device_end.write(reading(1, 0x17 + 100_000))  # a pause of 10 s
    bench.driver.poll(bench.sample)
    assert bench.sample.imu_time_s - before_s == pytest.approx(10.0039)
    assert bench.driver.lost_packets == 0


@pytest.mark.parametrize("precision", Precision)
def test_every_number_format_a_tracker_may_be_set_to_is_read(bench: Bench, precision: Precision) -> None:
    bench.device_end.write(encode_reading(Reading(1, 1, (0.5, -0.25, 9.75), (1.5, 0.0, -2.0), 1), precision))
    assert bench.driver.poll(bench.sample)
    assert np.array_equal(bench.sample.imu, [0.5, -0.25, 9.75, 1.5, 0.0, -2.0])


def test_a_reading_without_acceleration_fills_no_row(bench: Bench) -> None:
    bench.device_end.write(encode_reading(Reading(1, 1, None, (0.0, 0.0, 0.0), 1)))
    assert not bench.driver.poll(bench.sample)
    assert np.all(np.isnan(bench.sample.imu))


def test_a_message_whose_content_is_no_reading_is_counted_and_fills_no_row(bench: Bench) -> None:
    bench.device_end.write(encode(MessageId.MTDATA2, b"\x10\x20\x09"))
    assert not bench.driver.poll(bench.sample)
    assert (bench.driver.malformed, bench.sample.imu_fault) == (1, "")


@pytest.mark.parametrize(
    ("wire", "words"),
    [
        (encode(MessageId.ERROR, bytes((ErrorCode.DATA_OVERFLOW,))), "data overflow"),
        (encode(MessageId.ERROR, b"\x99"), "error 0x99"),
        (encode(MessageId.WAKE_UP), "started anew"),
        (encode_reading(Reading(1, 1, (0.0, 0.0, 9.81), (0.0, 0.0, 0.0), 0)), "self-test"),
    ],
)
def test_device_faults_stand_in_the_sample_in_words_until_the_device_is_configured_anew(bench: Bench, wire: bytes, words: str) -> None:
    bench.device_end.write(wire)
    bench.driver.poll(bench.sample)
    bench.device_end.write(encode(MessageId.WAKE_UP))
    bench.driver.poll(bench.sample)
    assert words in bench.sample.imu_fault  # the first one stands
    assert bench.sample.imu_fault.startswith("imu 'imu': ")
    assert bench.sample.fault == ""  # motion does not hang on it
    bench.driver.configure(no_wait)
    bench.driver.poll(bench.sample)
    assert bench.sample.imu_fault == ""


def test_messages_that_lack_a_field_are_counted_and_the_field_is_named(bench: Bench) -> None:
    without_time = Reading(3, None, (0.0, 0.0, 9.81), (0.0, 0.0, 0.0), None)
    bench.device_end.write(encode_reading(without_time))
    assert not bench.driver.poll(bench.sample)
    assert (bench.driver.malformed, bench.driver.first_malformed) == (1, "without sample time fine (1060h)")
