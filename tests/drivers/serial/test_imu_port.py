"""The IMU over a real file descriptor."""

from __future__ import annotations

import errno
from dataclasses import replace

import numpy as np
import pytest
from imu_wiring import IMU, PERIOD_S, PORT, no_wait
from modbus_wiring import eventually

from drivers.errors import BusUnavailableError
from drivers.interface import Sample
from drivers.serial.imu import ImuDriver
from drivers.serial.stream import SerialStream
from drivers.serial_port import why_not_opened
from virtual_bus.serial.pty import Pty
from virtual_bus.serial.xsens_imu import EmulatedImu


def test_over_a_pseudo_terminal_the_driver_configures_and_reads() -> None:
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


def test_a_line_that_is_hung_up_is_a_fault_in_words() -> None:
    pty = Pty()
    stream = SerialStream(pty.path, 921600)
    driver = ImuDriver(PORT, stream)
    sample = Sample(2)
    assert not driver.poll(sample)
    assert sample.imu_fault == ""
    pty.close()

    def fault_told() -> bool:
        assert not driver.poll(sample)
        return "is gone" in sample.imu_fault

    assert eventually(fault_told)
    assert np.all(np.isnan(sample.imu))
    with pytest.raises(BusUnavailableError, match="is gone"):
        driver.configure(no_wait)
    stream.close()


def test_a_port_that_does_not_exist_is_named() -> None:
    with pytest.raises(BusUnavailableError, match=r"/dev/no_such_port at 921600 baud: No such file or directory; name a port that exists$"):
        SerialStream("/dev/no_such_port", 921600)


def test_a_port_in_use_is_named() -> None:
    pty = Pty()
    first = SerialStream(pty.path, 921600)
    with pytest.raises(BusUnavailableError, match=rf"{pty.path} at 921600 baud: another program has it open; end that program$"):
        SerialStream(pty.path, 921600)
    first.close()
    pty.close()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError(errno.EACCES, "x"), "Permission denied; run as a user who may open it, on Linux often one of the group dialout"),
        (OSError(errno.EIO, "x"), "Input/output error"),
        (ValueError("Not a valid baudrate: -5"), "Not a valid baudrate: -5"),
    ],
)
def test_a_port_is_not_opened_for_the_reason_that_the_system_gives(error: OSError | ValueError, words: str) -> None:
    assert why_not_opened(error) == words


def test_a_rate_that_is_none_is_not_taken_for_a_missing_port() -> None:
    pty = Pty()
    with pytest.raises(BusUnavailableError, match=r"(?i)at -5 baud: .*baud") as refused:
        SerialStream(pty.path, -5)
    assert "exists" not in str(refused.value)
    pty.close()
