"""The emulated IMU by itself: states, refusals, rates and status word as the manual of the real one has them."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from imu_wiring import IMU, PERIOD_S, Bench, answers, no_wait

from drivers.serial.xbus import (
    DataId,
    ErrorCode,
    MessageId,
    StreamParser,
    SyncSetting,
    decode_output_configuration,
    decode_reading,
    encode_output_configuration,
    encode_sync_settings,
)
from hil.emulated.machine import build_emulated
from hil.machine import load_machine
from virtual_bus.serial.pipe import pipe
from virtual_bus.serial.xsens_imu import EmulatedImu, State


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.driver.configure(no_wait)
    return bench


def test_a_waking_device_waits_for_its_acknowledge_and_then_measures() -> None:
    device = EmulatedImu()
    assert device.power_on() == bytes.fromhex("FAFF3E00C3")
    assert device.advance(0.4) == b""
    assert device.state is State.WAKING
    device.advance(0.5)
    assert device.state is State.MEASUREMENT
    readings = [decode_reading(message.data) for message in StreamParser().feed(device.advance(1.5))]
    assert len(readings) == 100  # its default rate


def test_wake_up_acknowledged_in_time_leads_to_config() -> None:
    device = EmulatedImu()
    assert answers(device, MessageId.WAKE_UP_ACK) == []
    assert device.state is State.CONFIG


def test_reset_restarts_the_device_and_keeps_its_settings() -> None:
    device = EmulatedImu()
    answers(device, MessageId.GO_TO_CONFIG)
    wanted = encode_output_configuration([(DataId.ACCELERATION, 400)])
    answers(device, MessageId.SET_OUTPUT_CONFIGURATION, wanted)
    assert answers(device, MessageId.RESET) == [(MessageId.RESET + 1, b""), (MessageId.WAKE_UP, b"")]
    assert device.state is State.WAKING
    answers(device, MessageId.GO_TO_CONFIG)
    assert answers(device, MessageId.SET_OUTPUT_CONFIGURATION) == [(MessageId.SET_OUTPUT_CONFIGURATION + 1, wanted)]


@pytest.mark.parametrize("command", [MessageId.REQ_DEVICE_ID, MessageId.SET_OUTPUT_CONFIGURATION, MessageId.GO_TO_MEASUREMENT, 0x77])
def test_commands_of_the_config_state_are_refused_while_measuring(bench: Bench, command: MessageId | int) -> None:
    assert answers(bench.device, command) == [(MessageId.ERROR, bytes((ErrorCode.INVALID_MESSAGE,)))]
    assert bench.device.state is State.MEASUREMENT


def test_a_damaged_command_is_not_obeyed_and_answered_with_an_error(bench: Bench) -> None:
    assert bench.device.receive(bytes.fromhex("FAFF3000D2")) == bytes.fromhex("FAFF420104BA")
    assert bench.device.state is State.MEASUREMENT


@pytest.mark.parametrize(
    ("command", "data"),
    [
        (MessageId.SET_OUTPUT_CONFIGURATION, bytes.fromhex("20100064")),  # it has no orientation
        (MessageId.SET_OUTPUT_CONFIGURATION, bytes(3)),
        (MessageId.SET_SYNC_SETTINGS, encode_sync_settings([SyncSetting(9, 2, 1, 0, 0, 0, 0, 0)])),
        (MessageId.SET_SYNC_SETTINGS, bytes(5)),
    ],
)
def test_parameters_it_does_not_know_are_refused(command: MessageId, data: bytes) -> None:
    device = EmulatedImu()
    answers(device, MessageId.GO_TO_CONFIG)
    assert answers(device, command, data) == [(MessageId.ERROR, bytes((ErrorCode.INVALID_PARAMETER,)))]


def test_granted_rates_are_told() -> None:
    device = EmulatedImu()
    answers(device, MessageId.GO_TO_CONFIG)
    asked = [(DataId.SAMPLE_TIME_FINE, 7), (DataId.ACCELERATION, 0), (DataId.RATE_OF_TURN, 9000)]
    ((_, data),) = answers(device, MessageId.SET_OUTPUT_CONFIGURATION, encode_output_configuration(asked))
    assert [rate for _, rate in decode_output_configuration(data)] == [0xFFFF, 2000, 2000]  # Xsens: 0xFFFF stands for "with every message"


def test_sync_pulses_can_be_skipped() -> None:
    device = EmulatedImu()
    answers(device, MessageId.GO_TO_CONFIG)
    setting = SyncSetting(8, 2, 1, 0, skip_first=2, skip_factor=1, pulse_width=0, delay=0)
    answers(device, MessageId.SET_SYNC_SETTINGS, encode_sync_settings([setting]))
    assert answers(device, MessageId.SET_SYNC_SETTINGS) == [(MessageId.SET_SYNC_SETTINGS + 1, encode_sync_settings([setting]))]
    answers(device, MessageId.GO_TO_MEASUREMENT)
    assert [bool(device.on_sync(IMU, number * PERIOD_S)) for number in range(6)] == [False, False, True, False, True, False]


def test_the_status_word_marks_readings_drawn_by_sync(bench: Bench) -> None:
    (message,) = StreamParser().feed(bench.device.on_sync(IMU, 1.0))
    assert decode_reading(message.data).status == 1 << 21 | 0b11
    assert message.data[-4:] == struct.pack(">I", 1 << 21 | 0b11)


@pytest.mark.parametrize(("rate_Hz", "clock_ppm"), [(100, 0.0), (400, 0.0), (400, 3000.0)])
def test_on_its_own_clock_a_reading_is_that_of_the_instant_it_is_stamped_with(rate_Hz: int, clock_ppm: float) -> None:
    """A rate of turn of 2 Hz, which a straight line over a SYNC period misses by (2 pi 2 Hz T)^2 / 8 of it at most."""
    device = EmulatedImu(clock_error_ppm=clock_ppm)
    answers(device, MessageId.GO_TO_CONFIG)
    asked = [(DataId.SAMPLE_TIME_FINE, 7), (DataId.ACCELERATION, rate_Hz), (DataId.RATE_OF_TURN, rate_Hz)]
    answers(device, MessageId.SET_OUTPUT_CONFIGURATION, encode_output_configuration(asked))
    answers(device, MessageId.GO_TO_MEASUREMENT)
    sent = b""
    for number in range(256):
        turning = np.sin(2.0 * np.pi * 2.0 * number * PERIOD_S)
        sent += device.on_sync(np.array([0.0, 0.0, 9.81, 0.0, 0.0, turning]), number * PERIOD_S)
    readings = [decode_reading(message.data) for message in StreamParser().feed(sent)]
    assert len(readings) == pytest.approx(rate_Hz, abs=3)
    time_s = np.array([each.time_ticks for each in readings]) / 10_000.0 / (1.0 + clock_ppm * 1e-6)
    wanted = np.sin(2.0 * np.pi * 2.0 * time_s)
    shown = np.array([each.rate_of_turn[2] for each in readings])
    assert np.abs(shown - wanted).max() < (2.0 * np.pi * 2.0 * PERIOD_S) ** 2 / 8.0 + 2.0 * np.pi * 2.0 * 5e-5  # ticks are 0.1 ms


def test_standing_on_its_own_clock_each_message_has_the_noise_of_the_file_and_none_of_the_one_before() -> None:
    """At four messages in a SYNC period, with seed 3: a standard deviation is sure to 1 / sqrt(2 N), a correlation to 1 / sqrt(N)."""
    machine = load_machine("carm")
    emulated = build_emulated(machine, seed=3)
    assert emulated.imu is not None
    answers(emulated.imu, MessageId.GO_TO_CONFIG)
    asked = [(DataId.ACCELERATION, 1000), (DataId.RATE_OF_TURN, 1000)]
    answers(emulated.imu, MessageId.SET_OUTPUT_CONFIGURATION, encode_output_configuration(asked))
    answers(emulated.imu, MessageId.GO_TO_MEASUREMENT)
    sent: list[bytes] = []
    emulated.imu_out = sent.append
    for _ in range(512):
        emulated.receive(emulated.bus.sync_cob_id, b"")
    readings = [decode_reading(message.data) for message in StreamParser().feed(b"".join(sent))]
    count = len(readings)
    assert count == pytest.approx(2000, abs=5)
    shown = np.array([[*each.acceleration, *each.rate_of_turn] for each in readings])
    (unit,) = machine.plant.imus
    stated = np.concatenate([unit.accelerometer_noise_rms_m_s2, unit.gyro_noise_rms_rad_s])
    np.testing.assert_allclose(shown.std(axis=0), stated, rtol=4.0 / np.sqrt(2.0 * count))
    following = [np.corrcoef(channel[:-1], channel[1:])[0, 1] for channel in shown.T]
    assert np.abs(following).max() < 4.0 / np.sqrt(count)


def test_a_pipe_nobody_reads_loses_new_bytes_as_a_port_does() -> None:
    bench_end, device_end = pipe()
    device_end.write(bytes(65_000))
    device_end.write(bytes(1000))
    assert len(bench_end.read()) == 65_536
