"""What the real sets share: their machine files, recordings made of columns, and the error of the baselines.

Scripts that use a set have the folder `benchmarks` on their path: `from real.tx40 import splits`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from experts.common import nrmse
from real_data import DATA, RealSet

from hil.machine import Machine
from hil.machine.load import machine_from_text
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import Inputs, Outputs, Simulator
from hil.simulation.several import Prepared
from virtual_bus.inverse_dynamics import along_module
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.settings import EffectSetting

__all__ = [
    "AS_FILED",
    "DATA",
    "ControllerSide",
    "OpenLoop",
    "RealSet",
    "free_run",
    "friction_along",
    "machine_of",
    "mean_efforts",
    "nrmse",
    "on_rows",
    "recording_of",
    "without_delay",
]  # fmt: skip

HERE = Path(__file__).resolve().parent
PASSES = 8
"""In which friction that is a third of the drives' efforts is found to a ten-thousandth."""


@dataclass(frozen=True)
class ControllerSide:
    """What an answer says of the controller's side of a machine: numbers that no machine file of today holds.

    Attributes
    ----------
    gain : float
        Of the controller, in units of the file's.
    lateness_s : float
        By how much references, or measured efforts, act later than they were recorded.
    effort_zero, effort_lag_s : float
        What a measured effort is too large by, and the time constant that it follows the effort with.
    speed_limit : float
        Largest speed of a reference [rad/s or m/s].
    """

    gain: float = 1.0
    lateness_s: float = 0.0
    effort_zero: float = 0.0
    effort_lag_s: float = 0.0
    speed_limit: float = np.inf


AS_FILED = ControllerSide()


def machine_of(file: str, **changes: str) -> Machine:
    """Return the machine of `file`.toml beside this module.

    Parameters
    ----------
    file : str
    changes : str
        By key of the file: what its first line with this key says instead.

    Raises
    ------
    KeyError
        No line begins with a key.
    """
    lines = (HERE / f"{file}.toml").read_text().splitlines()
    for key, value in changes.items():
        found = [number for number, line in enumerate(lines) if line.startswith(f"{key} = ")]
        if not found:
            raise KeyError(f"{file}.toml has no {key}")
        lines[found[0]] = f"{key} = {value}"
    return machine_from_text("\n".join(lines) + "\n", label=f"{file}.toml")


def recording_of(
    machine: Machine,
    time_s: np.ndarray,
    columns: Mapping[str, tuple[str, np.ndarray]],
    initial: Mapping[str, Any] | None = None,
    **tables: Any,
) -> Recording:
    """Return a recording of a machine.

    Parameters
    ----------
    machine : Machine
    time_s : (rows,) array
        As it was recorded, even or not; the recording begins at 0.
    columns : mapping of str to (str, (rows,) array)
        Unit and values by the channel's name; NaN where a sample is missing.
    initial : mapping, optional
        States at the first row: see docs/generated/file-formats.md.
    tables
        Further tables of the metadata.
    """
    channels = {"time": Channel("s", time_s - time_s[0])}
    channels |= {name: Channel(unit, values) for name, (unit, values) in columns.items()}
    return Recording(channels, recording_metadata(machine, initial=initial, **tables))


def on_rows(machine: Machine, rate_Hz: float, substeps: int) -> Machine:
    """Return the machine at another sample rate and without the lattices of its sensors, as a metric simulates it."""
    plant = replace(
        machine.plant,
        sample_period_s=1.0 / rate_Hz,
        substeps=substeps,
        encoders=tuple(replace(encoder, resolution=0.0) for encoder in machine.plant.encoders),
        currents=tuple(replace(current, resolution=0.0) for current in machine.plant.currents),
        speeds=tuple(replace(speed, resolution=0.0) for speed in machine.plant.speeds),
    )
    return replace(machine, sample_rate_Hz=rate_Hz, plant=plant)


def without_delay(machine: Machine, effects: Sequence[EffectSetting]) -> tuple[tuple[EffectSetting, ...], np.ndarray]:
    """Return the effects but those of the drives' delay, and the delays (axes,) [s], for efforts that are known before a run begins."""
    delays = [sum(effect.parameters["Td"] for effect in effects if (effect.name, effect.at) == ("delay", axis)) for axis in machine.axes]
    return tuple(effect for effect in effects if effect.name != "delay"), np.array(delays, dtype=float)


def mean_efforts(time_s: np.ndarray, efforts: np.ndarray, edges_s: np.ndarray, delays_s: np.ndarray) -> np.ndarray:
    """Return means (rows, axes) of recorded efforts (N, axes), each delayed, between the edges (rows + 1,) of rows.

    Efforts go along straight lines between their samples, and are 0 beyond them.
    """
    areas = 0.5 * (efforts[1:] + efforts[:-1]) * np.diff(time_s)[:, None]
    impulses = np.vstack([np.zeros(efforts.shape[1]), np.cumsum(areas, axis=0)])
    passed = [np.interp(edges_s - delay, time_s, column) for delay, column in zip(delays_s, impulses.T, strict=True)]
    means: np.ndarray = np.diff(passed, axis=1).T / np.diff(edges_s)[:, None]
    return means


def free_run(
    simulator: Simulator,
    efforts: np.ndarray,
    pose: np.ndarray,
    speed: np.ndarray,
    values: np.ndarray | None = None,
    effects: Sequence[EffectSetting] = (),
) -> np.ndarray:
    """Return what the encoders read (rows, axes) in a free run, every joint driven, from joint positions and speeds (axes,) at row 0.

    `efforts` (rows, axes) act from each row to the next. A simulation takes none for the first row: the drives hold the machine there, as
    if it stood. So it begins where, one row later, it has the position and speed that the first effort would have led to.
    """
    plant, period_s = simulator.plant, simulator.machine.plant.sample_period_s
    model = plant.model(values, effects)
    inertia, holding = plant.inertia_and_bias(model, pose, np.zeros(len(pose)))
    missed = np.linalg.solve(inertia, plant.drive_gains(model, pose) * efforts[0] - holding)
    command, none = np.vstack([efforts[1:], efforts[-1:]]), np.zeros_like(efforts)
    begins = pose - 0.5 * period_s**2 * missed
    inputs = Inputs(None, none, none, command, begins, start_speed=speed + period_s * missed)
    return simulator.run(inputs, values, effects).position


def friction_along(
    plant: CompiledPlant, model: np.ndarray, position: np.ndarray, speed: np.ndarray, deviation: float, needed: np.ndarray
) -> np.ndarray:
    """Return the friction (rows, joints) of a motion whose drives give `needed` and overcome it.

    It may depend on what the drives give, so it is found in passes; `deviation` [rad/s or m/s] is that of the speed.
    """
    module, work = along_module(plant), plant.new_work()
    friction = np.zeros_like(needed)
    for _ in range(PASSES):
        given, friction = needed + friction, np.zeros_like(needed)
        module.rub(model, work, position, speed, np.full_like(speed, deviation), given, friction, np.zeros_like(needed))
    return friction


class OpenLoop(Simulator):
    """A simulator of runs in open loop that begin in any state and tell the one that they end in; an effort acts from its own row on."""

    _begin: np.ndarray | None
    _state: np.ndarray

    def drive(
        self,
        efforts: np.ndarray,
        pose: np.ndarray,
        speed: np.ndarray,
        values: np.ndarray | None = None,
        effects: Sequence[EffectSetting] = (),
        state: np.ndarray | None = None,
    ) -> tuple[Outputs, np.ndarray]:
        """Return what the sensors read in a free run, and the plant's state at the row behind the last.

        Parameters
        ----------
        efforts : (rows, axes) array
            Each is held to the next row.
        pose, speed : (axes,) array
            At row 0, with the springs at rest.
        values : (parameters,) array, optional
        effects : sequence of EffectSetting, optional
        state : array, optional
            The plant's whole state at row 0 instead.
        """
        self._begin = state
        none = np.zeros_like(efforts)
        inputs = Inputs(None, none, none, np.vstack([efforts[1:], efforts[-1:]]), pose, start_speed=speed, first_effort=efforts[0])
        return self.run(inputs, values, effects), self._state

    def _prepared(self, inputs: Inputs, values: np.ndarray | None, effects: Sequence[EffectSetting] | None) -> Prepared:
        prepared = super()._prepared(inputs, values, effects)
        if self._begin is not None:
            prepared.state[:] = self._begin
        self._state = prepared.state  # a run advances it
        return prepared
