"""The DFKI's double pendulum: measured joint torques in, positions out, in open loop from rest, as the baseline takes it.

Recordings have the file's own rows. The measured torque is the effort. The commanded one is left out: which of the two acted is not known,
and the baseline finds one as good as the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from real.common import DATA, RealSet, free_run, machine_of, mean_efforts, nrmse, on_rows, recording_of, without_delay
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from hil.machine import Machine
from hil.recording import Recording
from hil.simulation import Simulator
from virtual_bus.settings import EffectSetting

RATE_Hz = 500.0
SUBSTEPS = 2
README_HOLD_ROWS, README_SECONDS = 4, 4.0  # torques are held for 8 ms, and positions compared as often
WINDOW_s = ZERO_SECONDS = 1.0
SMOOTH_ROWS = 13
ZERO_LIMIT_rad, ZERO_SCALE_rad = 0.3, 0.05
EFFORT_MAY_LEAD = True
"""Its metric takes a delay below zero: what was recorded as effort may have acted before its row."""
ALL = ("00", "02", "03", "04", "05")
SPLITS = {"readme": (("00", "05"), "04")} | {
    f"full, {held_out} held out": (tuple(name for name in ALL if name != held_out), held_out) for held_out in ("02", "03", "04")
}
"""Recordings to fit, and the one held out."""


@dataclass(frozen=True)
class Record:
    """A recording on even rows: positions, speeds and mean torques to the next row (rows, 2), which are held for `hold` rows."""

    position: np.ndarray
    speed: np.ndarray
    torque: np.ndarray
    hold: int

    def run(
        self, simulator: Simulator, answer: tuple[np.ndarray | None, Sequence[EffectSetting]], begin: int, rows: int, zero: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return changes of position (rows / hold, 2), simulated and measured, since the row `begin`; `zero` (2,) is added to positions."""
        inside = slice(begin, begin + rows)
        pose = self.position[begin] + zero
        path = free_run(simulator, self.torque[inside], pose, self.speed[begin], *answer)
        return (path - pose)[:: self.hold], (self.position[inside] - self.position[begin])[:: self.hold]


def load(name: str, hold: int, seconds: float, delays_s: np.ndarray, source: str) -> Record:
    """Return a recording from its start, resampled by straight lines between the recorded rows."""
    table = np.genfromtxt(DATA / "dfki_double_pendulum" / f"traj_{name}.csv", delimiter=",", names=True)
    recorded = table["time"]
    positions, torques = (np.stack([table[f"{kind}{joint}"] for joint in (1, 2)], axis=1) for kind in ("pos_meas", source))
    even = np.arange(0.0, recorded[-1], 1.0 / RATE_Hz)
    position = np.stack([np.interp(even, recorded, column) for column in positions.T], axis=1)
    speed = savgol_filter(position, SMOOTH_ROWS, 2, deriv=1, delta=1.0 / RATE_Hz, axis=0)
    speed[0] = 0.0  # at rest
    held = len(np.arange(0.0, min(seconds, recorded[-1]), hold / RATE_Hz))
    torque = mean_efforts(recorded, torques, np.arange(held + 1) * hold / RATE_Hz, delays_s)
    rows = held * hold
    return Record(position[:rows], speed[:rows], np.repeat(torque, hold, axis=0), hold)


def splits() -> dict[str, RealSet]:
    """Return the README's split and, at full length, each of 02, 03 and 04 held out."""
    machine = machine_of("dfki_double_pendulum")
    found = {}
    for split, (train, held_out) in SPLITS.items():
        seconds = README_SECONDS if split == "readme" else np.inf
        parts = ({f"traj_{name}": _recording(machine, name, seconds) for name in names} for names in (train, (held_out,)))
        found[split] = RealSet(machine, *parts)
    return found


def errors(
    split: str, machine: Machine, values: np.ndarray | None = None, effects: Sequence[EffectSetting] = (), source: str = "tau_meas"
) -> dict[str, dict[str, float]]:
    """Return the NRMSE of the change of position of both joints: in free runs of whole recordings, the same with two zeros of position
    fitted to the first second of each, and in windows of 1 s.

    `source` is the recorded torque that acts: "tau_meas", or "tau_con" for the commanded one.
    """
    train, held_out = SPLITS[split]
    hold, seconds = (README_HOLD_ROWS, README_SECONDS) if split == "readme" else (1, np.inf)
    others, delays = without_delay(machine, effects)
    simulator, answer = Simulator(on_rows(machine, RATE_Hz, SUBSTEPS)), (values, others)
    none, window = np.zeros(2), round(WINDOW_s * RATE_Hz)
    found: dict[str, dict[str, float]] = {}
    for part, names in (("train", train), ("held_out", (held_out,))):
        records = [load(name, hold, seconds, delays, source) for name in names]
        rows = min(len(record.position) for record in records)
        spread = np.concatenate([record.position[: round(ZERO_SECONDS * RATE_Hz)] for record in records]).std(axis=0)
        pairs = {
            "": [record.run(simulator, answer, 0, rows, none) for record in records],
            ", zeros fitted": [record.run(simulator, answer, 0, rows, _zeros(record, simulator, answer, spread)) for record in records],
            ", 1 s windows": [
                record.run(simulator, answer, begin, window, none)
                for record in records
                for begin in range(0, len(record.position) - window, window)
            ],
        }
        for kind, runs in pairs.items():
            for joint, name in enumerate(("shoulder", "elbow")):
                error = nrmse([model[:, joint] for model, _ in runs], [measured[:, joint] for _, measured in runs])
                found.setdefault(name + kind, {})[part] = error
    return found


def _zeros(
    record: Record, simulator: Simulator, answer: tuple[np.ndarray | None, Sequence[EffectSetting]], spread: np.ndarray
) -> np.ndarray:
    """Return the zeros of position (2,) that fit the first second best."""

    def residuals(scaled: np.ndarray) -> np.ndarray:
        model, measured = record.run(simulator, answer, 0, round(ZERO_SECONDS * RATE_Hz), scaled * ZERO_SCALE_rad)
        flat: np.ndarray = ((model - measured) / spread).ravel()
        return flat

    limit = ZERO_LIMIT_rad / ZERO_SCALE_rad
    zeros: np.ndarray = least_squares(residuals, np.zeros(2), bounds=(-limit, limit), diff_step=1e-3, ftol=1e-5, xtol=1e-5, max_nfev=30).x
    return zeros * ZERO_SCALE_rad


def _recording(machine: Machine, name: str, seconds: float) -> Recording:
    table = np.genfromtxt(DATA / "dfki_double_pendulum" / f"traj_{name}.csv", delimiter=",", names=True)
    table = table[table["time"] < seconds]
    columns = {}
    for joint, axis in enumerate(machine.axes, 1):
        columns[f"position_{axis}"] = ("rad", table[f"pos_meas{joint}"])
        columns[f"effort_{axis}"] = ("Nm", table[f"tau_meas{joint}"])
    return recording_of(machine, table["time"], columns)
