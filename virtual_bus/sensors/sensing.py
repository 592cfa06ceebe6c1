"""The sensors of one emulated machine from sample to sample: their properties, memory and readings, as compiled code takes them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from virtual_bus.sensors.effects import ANY, DROPOUTS, new_memory
from virtual_bus.sensors.measure import BLOCKS, compiled_sensors, sensor_model
from virtual_bus.settings import PlantSettings


@dataclass
class Latched:
    """Sensor readings of one instant. One object is reused for every sample: copy what must be kept."""

    position_counts: np.ndarray  # (axes,) int64 motor side, zero where the machine was placed; 0 without a resolution
    link_counts: np.ndarray  # (axes,) int64 absolute, zero at joint position zero; 0 without a link encoder
    position: np.ndarray  # (axes,) rad or m at the joint, on the encoder's lattice; NaN without one
    link_position: np.ndarray  # (axes,) rad or m; NaN without a link encoder
    effort: np.ndarray  # (axes,) drive's unit
    imu: np.ndarray  # (6 imus,) specific force m/s^2, angular rate rad/s; six NaN without an IMU
    temperature_degC: np.ndarray  # (axes,) NaN without a thermometer


class Sensing:
    """Sensors that read a plant's state.

    Parameters
    ----------
    settings : PlantSettings
    state : array
        The plant's. It is read where it lies, as are the next two.
    currents : (axes,) array
        That flow in the drives, in their units.
    imu_motion : (6 imus,) array
        What the IMUs would read without effects, bias and noise.
    """

    def __init__(self, settings: PlantSettings, state: np.ndarray, currents: np.ndarray, imu_motion: np.ndarray) -> None:
        axes, imus = len(settings.drives), len(settings.imus)
        self._axes, self._state = axes, state
        self._model, self._memory = sensor_model(settings), new_memory(settings)
        self._has_effects = bool(self._model.switches[ANY])
        shapes = {"of_joints": (axes, len(settings.tree.joints)), "of_axes": (axes,), "of_imus": (6 * imus,)}
        blocks = {block: np.zeros((len(names), *shapes[block])) for block, names in BLOCKS.items()}
        rows = {name: blocks[block][row] for block, names in BLOCKS.items() for row, name in enumerate(names)}
        for name, row in rows.items():
            row[:] = getattr(self._model, name, 0.0)
        self._temperature_rise, self._seen = rows["temperature_rise"], rows["seen"]
        self._counts = np.zeros((3, axes), dtype=np.int64)
        self.latched = Latched(
            self._counts[1], self._counts[2], rows["read_position"], rows["read_link_position"], rows["read_effort"],
            rows["read_imu"] if imus else np.full(6, np.nan), rows["read_temperature_degC"],
        )  # fmt: skip
        self._last_of_imu = np.full(6, np.nan)
        self._compiled = compiled = compiled_sensors()
        effects = (*self._model.effects, *self._memory) if self._has_effects else ()
        sense, passing = (compiled.sense_affected, compiled.pass_affected) if effects else (compiled.sense, compiled.pass_sample)
        self.read = partial(sense, state, currents, imu_motion, *blocks.values(), self._counts, *effects)
        """Read every sensor into `latched`, with this noise (axes + 6 imus,)."""
        self.advance = partial(passing, currents, blocks["of_axes"], *effects)
        """Let a sample pass under the currents."""

    def start(self) -> None:
        """Begin at the plant's present state: cold windings, incremental encoders without an error, their counts not yet set to zero."""
        self._temperature_rise[:] = 0.0
        self._counts[0] = 0
        if self._has_effects:
            self._compiled.start(self._state, self._model, self._memory)

    def count_from_here(self) -> None:
        """Let the motor side's counts be zero at the latched position."""
        self._counts[0] = self.latched.position_counts

    def seen_by_imu(self) -> np.ndarray:
        """Return what the first IMU sees at the latched instant (6,): effects and bias, no noise and no lattice."""
        seen: np.ndarray = self._seen[:6] + self._model.imu_bias[:6]
        if self._model.switches[DROPOUTS]:
            lost = self._memory.latest[3 * self._axes :][:6] == self._memory.issued[3 * self._axes :][:6]
            seen = np.where(lost & np.isfinite(self._last_of_imu), self._last_of_imu, seen)
        self._last_of_imu = seen
        return seen

    def on_lattice_of_imu(self, value: np.ndarray) -> np.ndarray:
        """Return a value (6,) of the first IMU as that can tell it."""
        step = self._model.imu_resolution[:6]
        lattice = np.where(step > 0.0, step, 1.0)
        return np.where(step > 0.0, lattice * np.floor(value / lattice + 0.5), value)
