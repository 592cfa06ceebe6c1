"""A machine as the bench knows it: the file's text and what each floor needs of it, in SI and the drives' units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from controllers.cascade import AxisCommand, DriveLoops
from controllers.settings import AxisController, AxisLimits
from drivers.judging.settings import JudgingSettings
from drivers.settings import BusSettings
from hil.machine.standstill import Stop
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.settings import EffectSetting, PlantSettings


@dataclass(frozen=True)
class AxisUnits:
    """Units an axis is recorded in."""

    axis: str
    position: str  # "rad" or "m"
    effort: str  # "A", "V", "Nm" or "N"

    @property
    def edge(self) -> float:
        """One unit of the command line in SI: a degree, or a millimetre on a prismatic axis."""
        return math.pi / 180.0 if self.position == "rad" else 1e-3


@dataclass(frozen=True)
class Geometry:
    """Where source and detector sit, for imaging."""

    isocenter_m: np.ndarray  # (3,) in the world
    source_body: str
    source_position_m: np.ndarray  # (3,) focal spot, in the source body's frame
    detector_body: str
    detector_center_m: np.ndarray  # (3,) in the detector body's frame
    detector_size_m: np.ndarray  # (2,)
    detector_pixels: tuple[int, int]


@dataclass(frozen=True)
class Machine:
    """One machine file, read and checked. Axis order is the order of its drives."""

    name: str
    description: str
    text: str  # the file, as it is kept in recordings
    hash: str  # sha256 of the text, less a first line `#:schema`
    path: Path | None  # None when it came out of a recording
    axes: tuple[str, ...]
    sample_rate_Hz: float
    waits_on_overrun: bool  # a late loop shifts all later ticks and loses none; False: it skips and counts
    overrun_ticks: int  # ticks lost at once that the loop skips and counts; more stop the motors
    stale_ticks: int  # ticks in a row that a missing position is bridged with the last one; more stop the motors
    needs_recorder: bool  # a recorder that stands still stops the motors; False: it is told, and rows wait in memory
    units: tuple[AxisUnits, ...]
    plant: PlantSettings
    controllers: tuple[AxisController, ...]  # laws in effort, of bench and drive together; () for an open-loop machine
    commands: tuple[AxisCommand | None, ...]  # what the bench commands of a drive that closes loops of its own; None: the effort
    drive_loops: tuple[DriveLoops | None, ...]  # the drives' own, where the file says them
    limits: tuple[AxisLimits, ...]  # infinite where the file says nothing
    geometry: Geometry | None
    bus: BusSettings | None
    budgets: Mapping[str, Mapping[str, Stop]]  # by axis and class of fault: what may be taken to standstill
    brake_delay_s: tuple[float, ...]  # per axis: from the command to the full effort of its brake
    quick_stop: tuple[float | None, ...]  # per axis: deceleration by the drive's own ramp [rad/s^2 or m/s^2], where the file says it
    judging: JudgingSettings  # of the sensors on the bus; how fast encoders can move is not in it
    own_effects: tuple[EffectSetting, ...] = ()  # that the file itself states; `plant.effects` begins with them

    def axis_index(self, axis: str) -> int:
        """Return the axis's place in `axes`."""
        return self.axes.index(axis)

    def command_unit(self, axis: int) -> str:
        """Return the unit of what the bench commands of an axis: of an effort, a velocity or a position."""
        units, command = self.units[axis], self.commands[axis]
        if command is None:
            return units.effort
        return units.position if command.mode == "position" else f"{units.position}/s"

    @property
    def commanded(self) -> dict[str, dict[str, str]]:
        """What the loop commands of each axis, and the units in which command and excitation are recorded."""
        found = ("torque" if command is None else command.mode for command in self.commands)
        modes = found if self.bus is None else (scaling.mode for scaling in self.bus.scalings)
        return {
            units.axis: {"mode": mode, "unit": self.command_unit(axis), "excitation_unit": units.effort}
            for axis, (mode, units) in enumerate(zip(modes, self.units, strict=True))
        }

    def axis_of_channel(self, name: str) -> str | None:
        """Return the axis that a channel belongs to; None for channels of no axis.

        `position_fine_z` belongs to `fine_z` where there is such an axis beside `z`. An IMU's `imu_z` belongs to no axis, not to `z`.
        """
        if name in imu_channel_names(self.plant):
            return None
        return max((axis for axis in self.axes if name.endswith(f"_{axis}")), key=len, default=None)

    @property
    def line_imu(self) -> str:
        """Name of the IMU on the serial line; "" without one."""
        return self.bus.imu.name if self.bus is not None and self.bus.imu is not None else ""

    @property
    def bus_imu(self) -> str:
        """Name of the IMU that is a node of the bus; "" without one."""
        return next((node.sensor for node in self.bus.nodes if node.role == "imu"), "") if self.bus is not None else ""

    @property
    def added_effects(self) -> tuple[EffectSetting, ...]:
        """Physics beside what the file states."""
        return self.plant.effects[len(self.own_effects) :]

    def with_effects(self, effects: tuple[EffectSetting, ...]) -> Self:
        """Return the same machine with other physics added by name, beside what its file states."""
        added = tuple(effect for effect in effects if effect not in self.own_effects)
        return replace(self, plant=replace(self.plant, effects=(*self.own_effects, *added)))
