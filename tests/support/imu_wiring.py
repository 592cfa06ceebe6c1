"""The driver of the IMU and an emulated one at the two ends of a line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.interface import Sample
from drivers.serial.imu import ImuDriver
from drivers.serial.xbus import (
    Reading,
    StreamParser,
    encode,
    encode_reading,
)
from drivers.settings import ImuPort
from virtual_bus.serial.pipe import pipe
from virtual_bus.serial.xsens_imu import EmulatedImu

PORT = ImuPort(name="imu", device="", baud=921600, triggered_by_sync=True, rate_Hz=256.0)
FREE_RUNNING = replace(PORT, triggered_by_sync=False)
PERIOD_S = 1 / 256
IMU = np.array([0.125, -0.25, 9.8125, 0.5, -1.5, 0.0625])  # exact in float32


def no_wait(seconds: float) -> None:
    """In lockstep every answer is there at once."""


class Bench:
    """A driver and an emulated tracker on one in-process line."""

    def __init__(self, port: ImuPort = PORT, **device_options: float) -> None:
        self.bench_end, self.device_end = pipe()
        self.device = EmulatedImu(**device_options)
        self.device_end.on_data = lambda: self.device_end.write(self.device.receive(self.device_end.read()))
        self.driver = ImuDriver(port, self.bench_end)
        self.sample = Sample(2)

    def tick(self, number: int, imu: np.ndarray = IMU) -> bool:
        self.driver.before_sync()
        self.device_end.write(self.device.on_sync(imu, number * PERIOD_S))
        return self.driver.poll(self.sample)


def answers(device: EmulatedImu, message_id: int, data: bytes = b"") -> list[tuple[int, bytes]]:
    return [tuple(message) for message in StreamParser().feed(device.receive(encode(message_id, data)))]


def reading(counter: int, ticks: int) -> bytes:
    return encode_reading(Reading(counter, ticks, (0.0, 0.0, 9.81), (0.0, 0.0, 0.0), 1))
