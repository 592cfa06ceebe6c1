"""The IMU behind a serial device server: its line on a TCP port."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from imu_wiring import IMU, PERIOD_S, PORT, no_wait
from modbus_wiring import eventually

from drivers.errors import BusUnavailableError
from drivers.interface import Sample
from drivers.serial.imu import ImuDriver
from drivers.serial.stream import open_stream
from virtual_bus.serial.tcp_line import TcpLine
from virtual_bus.serial.xsens_imu import EmulatedImu


@pytest.fixture
def line() -> Iterator[TcpLine]:
    line = TcpLine()
    yield line
    line.close()


def test_the_driver_configures_and_reads(line: TcpLine) -> None:
    device = EmulatedImu()
    stream = open_stream(line.url, 921600)
    driver = ImuDriver(replace(PORT, device=line.url), stream)
    driver.configure(lambda seconds: line.write(device.receive(line.read())))
    sample = Sample(2)
    for number in range(1, 50):
        driver.before_sync()
        line.write(device.on_sync(IMU * number, number * PERIOD_S))
        assert eventually(lambda: driver.poll(sample))
        assert np.array_equal(sample.imu, IMU * number)
    assert not driver.poll(sample)
    assert driver.lost_packets == driver.late_packets == driver.checksum_errors == 0
    stream.close()


def test_a_line_that_is_hung_up_is_a_fault_in_words(line: TcpLine) -> None:
    stream = open_stream(line.url, 921600)
    driver = ImuDriver(PORT, stream)
    line.read()
    line.close()
    sample = Sample(2)

    def fault_told() -> bool:
        assert not driver.poll(sample)
        return f"serial line {line.url} is gone: the other end hung up" in sample.imu_fault

    assert eventually(fault_told)
    with pytest.raises(BusUnavailableError, match="is gone"):
        driver.configure(no_wait)
    stream.close()


def test_nobody_listening_is_named(line: TcpLine) -> None:
    line.close()
    with pytest.raises(BusUnavailableError, match=rf"serial line {line.url}: Connection refused; name a device server"):
        open_stream(line.url, 921600)


@pytest.mark.parametrize("url", ["tcp:", "tcp:127.0.0.1", "tcp:127.0.0.1:99999", "tcp:127.0.0.1:port"])
def test_an_address_that_is_none_is_told_what_would_be_right(url: str) -> None:
    with pytest.raises(BusUnavailableError, match=rf"serial line {url}: a device server's reads tcp:HOST:PORT"):
        open_stream(url, 921600)


def test_one_listener_at_a_time_and_the_next_when_it_has_left(line: TcpLine) -> None:
    first = open_stream(line.url, 921600)
    line.read()
    second = open_stream(line.url, 921600)
    line.read()

    def hung_up() -> bool:
        try:
            return second.read() != b""
        except BusUnavailableError:
            return True

    assert eventually(hung_up)
    line.write(b"to the first")
    assert eventually(lambda: first.read() == b"to the first")
    first.close()
    assert eventually(lambda: line.read() == b"" and not line.connected)
    third = open_stream(line.url, 921600)
    line.read()
    line.write(b"to the third")
    assert eventually(lambda: third.read() == b"to the third")
    second.close()
    third.close()
