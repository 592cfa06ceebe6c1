"""One joint of a robot arm at a time: the measured current in, position out, in open loop, as the baseline takes it.

There is a machine file for each of the joints 1 to 3: a split's machine has one joint, and the others are parked. Recordings have the
file's own rows, 10 or 12 ms apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from real.common import DATA, RealSet, free_run, friction_along, machine_of, mean_efforts, nrmse, on_rows, recording_of, without_delay
from scipy.signal import savgol_filter

from hil.machine import Machine
from hil.recording import Recording
from hil.simulation import Simulator
from virtual_bus.inverse_dynamics import along_module
from virtual_bus.settings import EffectSetting

RATE_Hz = 100.0
SUBSTEPS = 4
WINDOW_ROWS = 200
README_s = ((2.0, 8.0), (40.0, 46.0))
FULL_SHARE = 0.6
SMOOTH_ROWS = 15
SLIP_SPEED_rad_s = 0.016  # as unsure as speeds are taken to be where friction turns over: about the baseline's tanh(speed / 0.02)
EFFORT_MAY_LEAD = True
"""Its metric takes a delay below zero: what was recorded as effort may have acted before its row."""
NAMES = [f"joint {joint}, {kind}" for joint in (1, 2, 3) for kind in ("readme", "full")]


@dataclass(frozen=True)
class Record:
    """A joint's recording: its own rows, and position and speed [rad, rad/s] on rows of the metric."""

    time_s: np.ndarray  # (N,)
    position: np.ndarray  # (N,)
    current: np.ndarray  # (N,)
    speed: np.ndarray  # (N,)
    even_position: np.ndarray  # (rows,)
    even_speed: np.ndarray  # (rows,)

    def parts(self, kind: str) -> tuple[range, range]:
        """Return the rows of the metric to fit and those held out."""
        rows = len(self.even_position)
        if kind == "full":
            return range(round(FULL_SHARE * rows)), range(round(FULL_SHARE * rows), rows)
        train, held_out = (range(*(round(second * RATE_Hz) for second in span)) for span in README_s)
        return train, held_out

    def currents(self, delays_s: np.ndarray) -> np.ndarray:
        """Return mean currents (rows, 1) from each row of the metric to the next."""
        edges = np.arange(len(self.even_position) + 1) / RATE_Hz
        return mean_efforts(self.time_s, self.current[:, None], edges, delays_s)


def load(joint: int) -> Record:
    """Return a joint's recording."""
    table = np.loadtxt(DATA / "ur5" / f"ur-20_01_22-joint_{joint}.csv", delimiter=",")
    time, position, speed, current = table[:, 0] - table[0, 0], table[:, joint], table[:, 6 + joint], table[:, 12 + joint]
    even = np.arange(0.0, time[-1], 1.0 / RATE_Hz)
    return Record(time, position, current, speed, np.interp(even, time, position), np.interp(even, time, speed))


def splits() -> dict[str, RealSet]:
    """Return, for each joint, the README's parts and the whole length."""
    found = {}
    for name in NAMES:
        joint, kind = int(name.split(",")[0][-1]), name.split(", ")[1]
        machine, record = machine_of(f"ur5_joint_{joint}"), load(joint)
        parts = [{_words(joint, part): _recording(machine, joint, record, part)} for part in record.parts(kind)]
        found[name] = RealSet(machine, *parts)
    return found


def errors(
    split: str, machine: Machine, values: np.ndarray | None = None, effects: Sequence[EffectSetting] = ()
) -> dict[str, dict[str, float]]:
    """Return the NRMSE of the change of position: in one free run over each part, and in windows of 2 s one after the other.

    Also that of the current which the measured motion asks for. It is of the same rows, and what joints 2 and 3 are better judged by: they
    move about an upright arm, which falls one way or the other in a free run.
    """
    record = load(int(split.split(",")[0][-1]))
    others, delays = without_delay(machine, effects)
    simulator = Simulator(on_rows(machine, RATE_Hz, SUBSTEPS))
    currents, asked = record.currents(delays), _asked(simulator, record, values, others)

    def run(start: int, rows: int) -> np.ndarray:
        begin, speed = record.even_position[start : start + 1], record.even_speed[start : start + 1]
        path: np.ndarray = free_run(simulator, currents[start : start + rows], begin, speed, values, others)[:, 0] - begin
        return path

    found: dict[str, dict[str, float]] = {"position": {}, "position, 2 s windows": {}, "current from measured motion": {}}
    for name, part in zip(("train", "held_out"), record.parts(split.split(", ")[1]), strict=True):
        for channel, rows in (("position", len(part)), ("position, 2 s windows", WINDOW_ROWS)):
            starts = range(part.start, part.stop - rows + 1, rows)
            measured = [record.even_position[start : start + rows] - record.even_position[start] for start in starts]
            found[channel][name] = nrmse([run(start, rows) for start in starts], measured)
        rows_of = slice(part.start, part.stop)
        found["current from measured motion"][name] = nrmse([asked[rows_of]], [record.currents(np.zeros(1))[rows_of, 0]])
    return found


def _asked(simulator: Simulator, record: Record, values: np.ndarray | None, effects: Sequence[EffectSetting]) -> np.ndarray:
    """Return the currents (rows,) that the measured motion asks for."""
    plant = simulator.plant
    model, module = plant.model(values, effects), along_module(plant)
    speed = savgol_filter(record.even_speed, SMOOTH_ROWS, 3)
    acceleration = savgol_filter(record.even_speed, SMOOTH_ROWS, 3, deriv=1, delta=1.0 / RATE_Hz)
    motion = [np.ascontiguousarray(each[:, None]) for each in (record.even_position, speed, acceleration)]
    needed = np.zeros_like(motion[0])
    module.efforts(model, plant.new_work(), *motion, needed)
    rubbed = friction_along(plant, model, motion[0], motion[1], SLIP_SPEED_rad_s, needed)
    currents: np.ndarray = (needed + rubbed)[:, 0] / plant.drive_gains(model, motion[0][0])[0]
    return currents


def _words(joint: int, part: range) -> str:
    return f"joint {joint}, {part.start / RATE_Hz:g} to {part.stop / RATE_Hz:g} s"


def _recording(machine: Machine, joint: int, record: Record, part: range) -> Recording:
    inside = (record.time_s >= part.start / RATE_Hz) & (record.time_s < part.stop / RATE_Hz)
    columns = {f"position_joint_{joint}": ("rad", record.position[inside]), f"current_joint_{joint}": ("A", record.current[inside])}
    return recording_of(machine, record.time_s[inside], columns, {"speeds": [float(record.speed[inside][0])]})
