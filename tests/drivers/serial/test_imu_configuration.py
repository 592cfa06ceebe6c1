"""The IMU configured: the dialogue, rates it cannot give, lines that are silent, devices that wake up, refuse or are something else."""

from __future__ import annotations

from dataclasses import replace

import pytest
from imu_wiring import FREE_RUNNING, IMU, PERIOD_S, PORT, Bench, no_wait, reading

from drivers.errors import ConfigurationRefusedError, NodeAbsentError, ProtocolError
from drivers.serial.imu import ImuDriver
from drivers.serial.xbus import (
    DataId,
    ErrorCode,
    MessageId,
    StreamParser,
    encode,
    encode_output_configuration,
)
from virtual_bus.serial.pipe import pipe
from virtual_bus.serial.xsens_imu import EmulatedImu, State


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.driver.configure(no_wait)
    return bench


def test_configuration_leaves_the_device_measuring_and_identified(bench: Bench) -> None:
    assert bench.device.state is State.MEASUREMENT
    assert bench.driver.identity.product_code == "MTi-100-2A5G4"
    assert bench.driver.identity.device_id == 0x07700001
    assert bench.driver.identity.firmware == "1.9.0"


def test_the_dialogue_on_the_wire_is_the_documented_one() -> None:
    class Listener(Bench):
        def __init__(self) -> None:
            super().__init__()
            self.heard = b""
            self.device_end.on_data = self.hear

        def hear(self) -> None:
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


def test_on_its_own_clock_the_device_sends_at_its_rate_with_its_clock_error() -> None:
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


def test_a_free_running_slow_device_leaves_rows_empty() -> None:
    bench = Bench(replace(FREE_RUNNING, rate_Hz=100.0))
    bench.driver.configure(no_wait)
    filled = sum(bench.tick(number) for number in range(1, 257))
    assert filled == 100


def test_a_rate_the_device_cannot_give_is_refused_with_the_one_it_has() -> None:
    bench = Bench(replace(FREE_RUNNING, rate_Hz=300.0))
    with pytest.raises(ConfigurationRefusedError, match=r"grants 299 Hz where rate_Hz = 300"):
        bench.driver.configure(no_wait)


def test_a_line_too_slow_for_the_rate_is_refused() -> None:
    bench = Bench(replace(PORT, baud=115200))
    with pytest.raises(ConfigurationRefusedError, match=r"54 bytes at 256 Hz need more than 138240 baud.*115200"):
        bench.driver.configure(no_wait)


def test_a_silent_line_says_what_to_check() -> None:
    waited = []
    bench_end, _ = pipe()
    driver = ImuDriver(replace(PORT, device="/dev/ttyUSB7"), bench_end)
    with pytest.raises(
        NodeAbsentError, match=r"imu 'imu' on /dev/ttyUSB7: no answer to GO_TO_CONFIG within 0.5 s; check power, cable .*921600"
    ):
        driver.configure(waited.append)
    assert sum(waited) == pytest.approx(1.5)  # three attempts


@pytest.mark.parametrize(
    ("device", "sent", "words"),
    [
        ("/dev/ttyUSB7", b"", r"check power, cable and the machine file's baud = 921600$"),
        ("tcp:10.0.0.9:4001", b"", r"check power, cable and the device server's baud rate$"),
        ("/dev/ttyUSB7", b"\x80\x1f\xe0" * 9, r"27 bytes came that are no Xbus message; check the machine file's baud = 921600 and what"),
        ("/dev/ttyUSB7", encode(0x32, bytes(40)), r"messages 32h came; check the line towards the device$"),
    ],
)
def test_what_came_where_an_answer_belongs_is_named(device: str, sent: bytes, words: str) -> None:
    """Silence, bytes of another rate, and a tracker that sends and does not hear are three faults."""
    bench_end, far = pipe()
    driver = ImuDriver(replace(PORT, device=device), bench_end)

    def wait(_: float) -> None:
        nonlocal steps
        steps += 1
        if steps % 500 == 5:
            far.write(sent)

    steps = 0
    with pytest.raises(NodeAbsentError, match=words):
        driver.configure(wait)


def test_a_device_that_wakes_up_deaf_is_asked_again() -> None:
    bench = Bench()
    answered = bench.device_end.on_data
    heard = []

    def second_time() -> None:
        heard.append(1)
        if len(heard) == 1:
            bench.device_end.read()
        else:
            answered()

    bench.device_end.on_data = second_time
    bench.driver.configure(no_wait)
    assert bench.device.state is State.MEASUREMENT


def test_configuration_works_on_a_device_that_is_streaming() -> None:
    bench = Bench()
    bench.device.advance(0.6)
    assert bench.device.state is State.MEASUREMENT
    bench.device_end.write(bench.device.advance(2.0))

    def stop_streaming() -> None:
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

        def answer() -> None:
            data = device_end.read()
            (message,) = StreamParser().feed(data)
            device_end.write(script.get(message.message_id, real.receive(data)))

        device_end.on_data = answer


def test_an_error_answer_is_told_in_words() -> None:
    device = ScriptedDevice({MessageId.SET_SYNC_SETTINGS: encode(MessageId.ERROR, bytes((ErrorCode.INVALID_PARAMETER,)))})
    with pytest.raises(ConfigurationRefusedError, match=r"answers SET_SYNC_SETTINGS with error 0x21 \(invalid parameter\)"):
        ImuDriver(PORT, device.end).configure(no_wait)


def test_outputs_that_are_not_granted_are_refused() -> None:
    granted = encode_output_configuration([(DataId.PACKET_COUNTER, 0xFFFF), (DataId.ACCELERATION, 400)])
    device = ScriptedDevice({MessageId.SET_OUTPUT_CONFIGURATION: encode(MessageId.SET_OUTPUT_CONFIGURATION + 1, granted)})
    with pytest.raises(ConfigurationRefusedError, match=r"grants the outputs 0x1020, 0x4020; counter, time"):
        ImuDriver(PORT, device.end).configure(no_wait)


def test_something_else_that_speaks_xbus_is_no_tracker() -> None:
    device = ScriptedDevice({MessageId.REQ_FIRMWARE_REVISION: encode(MessageId.REQ_FIRMWARE_REVISION + 1, b"\x01")})
    with pytest.raises(ProtocolError, match=r"device id of 4 bytes and a firmware revision of 1, where a motion tracker has 4 or 8 and 3"):
        ImuDriver(PORT, device.end).configure(no_wait)
