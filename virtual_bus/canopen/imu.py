"""An IMU as a CANopen node: it samples at SYNC, and its TPDOs carry the six readings and the sample's number."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drivers.canopen.can_imu import COUNTER, COUNTS, FORCE, OBJECTS, FORCE_STEP_m_s2, RATE_STEP_rad_s
from drivers.canopen.eds import load_object_dictionary
from virtual_bus.canopen.node import Emit, Node
from virtual_bus.settings import EmulatedCanImu

MOST = (1 << 15) - 1  # of a signed number of 16 bits: beyond it the reading stays at full scale


class CanImu(Node):
    """One IMU on the bus."""

    volatile = frozenset({index for index, _ in OBJECTS} | {COUNTER})

    def __init__(self, settings: EmulatedCanImu, emit: Emit, memory: Path | None = None) -> None:
        super().__init__(load_object_dictionary(settings.eds, settings.node_id), settings.node_id, emit, memory)
        self.settings = settings
        self._read = [self.objects.find(index, subindex) for index, subindex in OBJECTS]
        self._steps = [FORCE_STEP_m_s2 if index == FORCE else RATE_STEP_rad_s for index, _ in OBJECTS]
        self._counter = self.objects.find(COUNTER)
        self._samples = 0

    def latch(self, readings: np.ndarray) -> None:
        """Take the sample (6,): specific force [m/s^2] and angular rate [rad/s] in the sensor's frame."""
        for entry, step, value in zip(self._read, self._steps, readings.tolist(), strict=True):
            entry.value = min(max(round(value / step), -MOST), MOST)
        self._samples = (self._samples + 1) % COUNTS
        self._counter.value = self._samples
