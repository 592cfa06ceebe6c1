"""The IMU driver and the emulated tracker: the dialogue, every row's reading, and what goes wrong on the line."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from modbus_wiring import eventually

from drivers.errors import BusUnavailable, ConfigurationRefused, NodeAbsent, ProtocolError
from drivers.interface import Sample
from drivers.serial.imu import ImuDriver
from drivers.serial.stream import SerialStream
from drivers.serial.xbus import (
    MAX_RATE,
    DataId,
    ErrorCode,
    MessageId,
    Precision,
    Reading,
    StreamParser,
    SyncSetting,
    decode_output_configuration,
    decode_reading,
    encode,
    encode_output_configuration,
    encode_reading,
    encode_sync_settings,
)
from drivers.settings import ImuPort
from virtual_bus.serial.pipe import pipe
from virtual_bus.serial.pty import Pty
from virtual_bus.serial.xsens_imu import EmulatedImu, State

PORT = ImuPort(name="imu", device="", baud=921600, triggered_by_sync=True, rate_Hz=256.0)
FREE_RUNNING = replace(PORT, triggered_by_sync=False)
PERIOD_S = 1 / 256
IMU = np.array([0.125, -0.25, 9.8125, 0.5, -1.5, 0.0625])  # exact in float32


def no_wait(seconds: float) -> None:
    """In lockstep every answer is there at once."""


class Bench:
    """A driver and an emulated tracker on one in-process line."""

    def __init__(self, port: ImuPort = PORT, **device_options) -> None:
        self.bench_end, self.device_end = pipe()
        self.device = EmulatedImu(**device_options)
        self.device_end.on_data = lambda: self.device_end.write(self.device.receive(self.device_end.read()))
        self.driver = ImuDriver(port, self.bench_end)
        self.sample = Sample(2)

    def tick(self, number: int, imu: np.ndarray = IMU) -> bool:
        self.driver.before_sync()
        self.device_end.write(self.device.on_sync(imu, number * PERIOD_S))
        return self.driver.poll(self.sample)


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.driver.configure(no_wait)
    return bench


def answers(device: EmulatedImu, message_id: int, data: bytes = b"") -> list[tuple[int, bytes]]:
    return [tuple(message) for message in StreamParser().feed(device.receive(encode(message_id, data)))]


def test_configuration_leaves_the_device_measuring_and_identified(bench):
    assert bench.device.state is State.MEASUREMENT
    assert bench.driver.identity.product_code == "MTi-100-2A5G4"
    assert bench.driver.identity.device_id == 0x07700001
    assert bench.driver.identity.firmware == "1.9.0"


def test_the_dialogue_on_the_wire_is_the_documented_one():
    class Listener(Bench):
        def __init__(self):
            super().__init__()
            self.heard = b""
            self.device_end.on_data = self.hear

        def hear(self):
            data = self.device_end.read()
            self.heard += data
            self.device_end.write(self.device.receive(data))

    bench = Listener()
    bench.driver.configure(no_wait)
    assert bench.heard == bytes.fromhex(
        "FAFF3000D1 FAFF000001 FAFF1C00E5 FAFF1200EF"
        "FAFFC014 1020FFFF 1060FFFF 4020FFFF 8020FFFF E020FFFF 97"
        "FAFF2C0C 0802010000000000000000 00 BE FAFF1000F1"
    )


def test_every_sync_brings_one_reading_exact_to_float32(bench):
    for number in range(1, 20):
        imu = IMU * number
        assert bench.tick(number, imu)
        assert np.array_equal(bench.sample.imu, imu)
        assert bench.sample.imu_counter == number - 1
        assert bench.sample.imu_time_s == pytest.approx(number * PERIOD_S, abs=5.1e-5)  # 10 kHz ticks
    assert bench.driver.lost_packets == bench.driver.late_packets == bench.driver.checksum_errors == 0
    assert bench.sample.fault == ""


def test_the_device_sends_nothing_between_syncs_when_triggered(bench):
    assert bench.device.advance(5.0) == b""
    assert not bench.driver.poll(bench.sample)


def test_a_missing_packet_is_nan_and_not_the_last_one_again(bench):
    assert bench.tick(1)
    assert not bench.driver.poll(bench.sample)
    assert np.all(np.isnan(bench.sample.imu))
    assert math.isnan(bench.sample.imu_time_s)
    assert bench.sample.imu_counter == -1


def test_lost_packets_show_in_the_counter(bench):
    bench.tick(1)
    for number in (2, 3, 4):
        bench.device.on_sync(IMU, number * PERIOD_S)  # never reaches the line
    bench.tick(5)
    assert bench.driver.lost_packets == 3
    assert bench.sample.imu_counter == 4


def test_a_damaged_packet_is_counted_and_missing_in_its_row_only(bench):
    bench.tick(1)
    damaged = bytearray(bench.device.on_sync(IMU, 2 * PERIOD_S))
    damaged[20] ^= 0xFF
    bench.device_end.write(bytes(damaged))
    assert not bench.driver.poll(bench.sample)
    assert bench.tick(3)
    assert bench.driver.checksum_errors == 1
    assert bench.driver.lost_packets == 1


def test_a_packet_that_comes_after_its_row_was_closed_is_in_no_row(bench):
    bench.tick(1)
    late = bench.device.on_sync(IMU * 2, 2 * PERIOD_S)
    assert not bench.driver.poll(bench.sample)
    bench.device_end.write(late)
    assert bench.tick(3, IMU * 3)
    assert np.array_equal(bench.sample.imu, IMU * 3)
    assert (bench.driver.late_packets, bench.driver.lost_packets) == (1, 0)


def test_a_packet_split_over_two_reads_arrives_whole(bench):
    packet = bench.device.on_sync(IMU, PERIOD_S)
    bench.device_end.write(packet[:23])
    assert not bench.driver.poll(bench.sample)
    bench.device_end.write(packet[23:])
    assert bench.driver.poll(bench.sample)
    assert np.array_equal(bench.sample.imu, IMU)


def reading(counter: int, ticks: int) -> bytes:
    return encode_reading(Reading(counter, ticks, (0.0, 0.0, 9.81), (0.0, 0.0, 0.0), 1))


def test_counter_and_time_run_on_where_the_device_wraps(bench):
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
def test_every_number_format_a_tracker_may_be_set_to_is_read(bench, precision):
    bench.device_end.write(encode_reading(Reading(1, 1, (0.5, -0.25, 9.75), (1.5, 0.0, -2.0), 1), precision))
    assert bench.driver.poll(bench.sample)
    assert np.array_equal(bench.sample.imu, [0.5, -0.25, 9.75, 1.5, 0.0, -2.0])


def test_a_reading_without_acceleration_fills_no_row(bench):
    bench.device_end.write(encode_reading(Reading(1, 1, None, (0.0, 0.0, 0.0), 1)))
    assert not bench.driver.poll(bench.sample)
    assert np.all(np.isnan(bench.sample.imu))


@pytest.mark.parametrize(
    ("wire", "words"),
    [
        (encode(MessageId.ERROR, bytes((ErrorCode.DATA_OVERFLOW,))), "data overflow"),
        (encode(MessageId.ERROR, b"\x99"), "error 0x99"),
        (encode(MessageId.WAKE_UP), "started anew"),
        (encode_reading(Reading(1, 1, (0.0, 0.0, 9.81), (0.0, 0.0, 0.0), 0)), "self-test"),
        (encode(MessageId.MTDATA2, b"\x10\x20\x09"), "beyond the message"),
    ],
)
def test_device_faults_stand_in_the_sample_in_words_until_the_device_is_configured_anew(bench, wire, words):
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


def test_on_its_own_clock_the_device_sends_at_its_rate_with_its_clock_error():
    bench = Bench(FREE_RUNNING, clock_error_ppm=5000.0)
    bench.driver.configure(no_wait)
    times = []
    for number in range(1, 2561):
        bench.device_end.write(bench.device.on_sync(IMU, number * PERIOD_S))
        if bench.driver.poll(bench.sample):
            times.append(bench.sample.imu_time_s)
    # 10 s of machine time are 10.05 s of the device's: 2572.8 readings, seen by 2560 polls
    assert bench.sample.imu_counter == 2571
    assert times[-1] == pytest.approx(2572 / 256, abs=1e-4)
    assert bench.driver.lost_packets == bench.driver.late_packets == 0


def test_a_free_running_slow_device_leaves_rows_empty():
    bench = Bench(replace(FREE_RUNNING, rate_Hz=100.0))
    bench.driver.configure(no_wait)
    filled = sum(bench.tick(number) for number in range(1, 257))
    assert filled == 100


def test_a_rate_the_device_cannot_give_is_refused_with_the_one_it_has():
    bench = Bench(replace(FREE_RUNNING, rate_Hz=300.0))
    with pytest.raises(ConfigurationRefused, match=r"grants 299 Hz where rate_Hz = 300"):
        bench.driver.configure(no_wait)


def test_a_line_too_slow_for_the_rate_is_refused():
    bench = Bench(replace(PORT, baud=115200))
    with pytest.raises(ConfigurationRefused, match=r"54 bytes at 256 Hz need more than 138240 baud.*115200"):
        bench.driver.configure(no_wait)


def test_a_silent_line_says_what_to_check():
    waited = []
    bench_end, _ = pipe()
    driver = ImuDriver(replace(PORT, device="/dev/ttyUSB7"), bench_end)
    with pytest.raises(NodeAbsent, match=r"imu 'imu' on /dev/ttyUSB7: no answer to GO_TO_CONFIG within 0.5 s; check power, cable .*921600"):
        driver.configure(waited.append)
    assert sum(waited) == pytest.approx(1.5)  # three attempts


def test_a_device_that_wakes_up_deaf_is_asked_again():
    bench = Bench()
    answered = bench.device_end.on_data
    heard = []

    def second_time():
        heard.append(1)
        if len(heard) == 1:
            bench.device_end.read()
        else:
            answered()

    bench.device_end.on_data = second_time
    bench.driver.configure(no_wait)
    assert bench.device.state is State.MEASUREMENT


def test_configuration_works_on_a_device_that_is_streaming():
    bench = Bench()
    bench.device.advance(0.6)
    assert bench.device.state is State.MEASUREMENT
    bench.device_end.write(bench.device.advance(2.0))

    def stop_streaming():
        data = bench.device_end.read()
        cut_off = reading(1, 1)[:30] if bench.device.state is State.MEASUREMENT else b""
        bench.device_end.write(cut_off + bench.device.receive(data))

    bench.device_end.on_data = stop_streaming
    bench.driver.configure(no_wait)
    assert bench.device.state is State.MEASUREMENT


class ScriptedDevice:
    """Answers each command with what the script says, in the place of a device that is not what it should be."""

    def __init__(self, script: dict[int, bytes]) -> None:
        self.end, device_end = pipe()
        real = EmulatedImu()

        def answer():
            data = device_end.read()
            (message,) = StreamParser().feed(data)
            device_end.write(script.get(message.message_id, real.receive(data)))

        device_end.on_data = answer


def test_an_error_answer_is_told_in_words():
    device = ScriptedDevice({MessageId.SET_SYNC_SETTINGS: encode(MessageId.ERROR, bytes((ErrorCode.INVALID_PARAMETER,)))})
    with pytest.raises(ConfigurationRefused, match=r"answers SET_SYNC_SETTINGS with error 0x21 \(invalid parameter\)"):
        ImuDriver(PORT, device.end).configure(no_wait)


def test_outputs_that_are_not_granted_are_refused():
    granted = encode_output_configuration([(DataId.PACKET_COUNTER, MAX_RATE), (DataId.ACCELERATION, 400)])
    device = ScriptedDevice({MessageId.SET_OUTPUT_CONFIGURATION: encode(MessageId.SET_OUTPUT_CONFIGURATION + 1, granted)})
    with pytest.raises(ConfigurationRefused, match=r"grants the outputs 0x1020, 0x4020; counter, time"):
        ImuDriver(PORT, device.end).configure(no_wait)


def test_something_else_that_speaks_xbus_is_no_tracker():
    device = ScriptedDevice({MessageId.REQ_FIRMWARE_REVISION: encode(MessageId.REQ_FIRMWARE_REVISION + 1, b"\x01")})
    with pytest.raises(ProtocolError, match="no motion tracker"):
        ImuDriver(PORT, device.end).configure(no_wait)


# ---- the emulated device by itself ----------------------------------------------------------------------


def test_a_waking_device_waits_for_its_acknowledge_and_then_measures():
    device = EmulatedImu()
    assert device.power_on() == bytes.fromhex("FAFF3E00C3")
    assert device.advance(0.4) == b""
    assert device.state is State.WAKING
    device.advance(0.5)
    assert device.state is State.MEASUREMENT
    readings = [decode_reading(message.data) for message in StreamParser().feed(device.advance(1.5))]
    assert len(readings) == 100  # its default rate


def test_wake_up_acknowledged_in_time_leads_to_config():
    device = EmulatedImu()
    assert answers(device, MessageId.WAKE_UP_ACK) == []
    assert device.state is State.CONFIG


def test_reset_restarts_the_device_and_keeps_its_settings():
    device = EmulatedImu()
    answers(device, MessageId.GO_TO_CONFIG)
    wanted = encode_output_configuration([(DataId.ACCELERATION, 400)])
    answers(device, MessageId.SET_OUTPUT_CONFIGURATION, wanted)
    assert answers(device, MessageId.RESET) == [(MessageId.RESET + 1, b""), (MessageId.WAKE_UP, b"")]
    assert device.state is State.WAKING
    answers(device, MessageId.GO_TO_CONFIG)
    assert answers(device, MessageId.SET_OUTPUT_CONFIGURATION) == [(MessageId.SET_OUTPUT_CONFIGURATION + 1, wanted)]


@pytest.mark.parametrize("command", [MessageId.REQ_DEVICE_ID, MessageId.SET_OUTPUT_CONFIGURATION, MessageId.GO_TO_MEASUREMENT, 0x77])
def test_commands_of_the_config_state_are_refused_while_measuring(bench, command):
    assert answers(bench.device, command) == [(MessageId.ERROR, bytes((ErrorCode.INVALID_MESSAGE,)))]
    assert bench.device.state is State.MEASUREMENT


def test_a_damaged_command_is_not_obeyed_and_answered_with_an_error(bench):
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
def test_parameters_it_does_not_know_are_refused(command, data):
    device = EmulatedImu()
    answers(device, MessageId.GO_TO_CONFIG)
    assert answers(device, command, data) == [(MessageId.ERROR, bytes((ErrorCode.INVALID_PARAMETER,)))]


def test_granted_rates_are_told():
    device = EmulatedImu()
    answers(device, MessageId.GO_TO_CONFIG)
    asked = [(DataId.SAMPLE_TIME_FINE, 7), (DataId.ACCELERATION, 0), (DataId.RATE_OF_TURN, 9000)]
    ((_, data),) = answers(device, MessageId.SET_OUTPUT_CONFIGURATION, encode_output_configuration(asked))
    assert [rate for _, rate in decode_output_configuration(data)] == [MAX_RATE, 2000, 2000]


def test_sync_pulses_can_be_skipped():
    device = EmulatedImu()
    answers(device, MessageId.GO_TO_CONFIG)
    setting = SyncSetting(8, 2, 1, 0, skip_first=2, skip_factor=1, pulse_width=0, delay=0)
    answers(device, MessageId.SET_SYNC_SETTINGS, encode_sync_settings([setting]))
    assert answers(device, MessageId.SET_SYNC_SETTINGS) == [(MessageId.SET_SYNC_SETTINGS + 1, encode_sync_settings([setting]))]
    answers(device, MessageId.GO_TO_MEASUREMENT)
    assert [bool(device.on_sync(IMU, number * PERIOD_S)) for number in range(6)] == [False, False, True, False, True, False]


def test_the_status_word_marks_readings_drawn_by_sync(bench):
    (message,) = StreamParser().feed(bench.device.on_sync(IMU, 1.0))
    assert decode_reading(message.data).status == 1 << 21 | 0b11
    assert message.data[-4:] == struct.pack(">I", 1 << 21 | 0b11)


def test_a_pipe_nobody_reads_loses_new_bytes_as_a_port_does():
    bench_end, device_end = pipe()
    device_end.write(bytes(65_000))
    device_end.write(bytes(1000))
    assert len(bench_end.read()) == 65_536


# ---- a real file descriptor -----------------------------------------------------------------------------


def test_over_a_pseudo_terminal_the_driver_configures_and_reads():
    pty = Pty()
    device = EmulatedImu()
    pty.write(device.power_on())  # old bytes in the port are dropped when it is opened
    stream = SerialStream(pty.path, 921600)
    driver = ImuDriver(replace(PORT, device=pty.path), stream)

    def serve(seconds: float) -> None:
        if pty.wait(seconds):
            pty.write(device.receive(pty.read()))

    driver.configure(serve)
    sample = Sample(2)
    for number in range(1, 50):
        driver.before_sync()
        packet = device.on_sync(IMU * number, number * PERIOD_S)
        pty.write(packet[:11])
        pty.write(packet[11:])
        assert eventually(lambda: driver.poll(sample))  # the kernel hands bytes over in its own time
        assert np.array_equal(sample.imu, IMU * number)
    assert not driver.poll(sample)
    assert driver.lost_packets == driver.late_packets == driver.checksum_errors == 0
    stream.close()
    pty.close()


def test_a_line_that_is_hung_up_is_a_fault_in_words():
    pty = Pty()
    stream = SerialStream(pty.path, 921600)
    driver = ImuDriver(PORT, stream)
    sample = Sample(2)
    assert not driver.poll(sample)
    assert sample.imu_fault == ""
    pty.close()

    def fault_told():
        assert not driver.poll(sample)
        return "is gone" in sample.imu_fault

    assert eventually(fault_told)
    assert np.all(np.isnan(sample.imu))
    with pytest.raises(BusUnavailable, match="is gone"):
        driver.configure(no_wait)
    stream.close()


def test_a_port_that_does_not_exist_is_named():
    with pytest.raises(BusUnavailable, match=r"/dev/no_such_port at 921600 baud: No such file or directory"):
        SerialStream("/dev/no_such_port", 921600)


def test_a_port_in_use_is_named():
    pty = Pty()
    first = SerialStream(pty.path, 921600)
    with pytest.raises(BusUnavailable, match=pty.path):
        SerialStream(pty.path, 921600)
    first.close()
    pty.close()
