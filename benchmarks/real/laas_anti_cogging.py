"""The motor with strong cogging of the LAAS: measured current in, position out, in open loop, as the baseline takes it.

Recordings are the whole halves without compensation at an even 1 kHz, with the measured current as the drive's effort. The recorded speed,
which lags, is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from real.common import DATA, OpenLoop, RealSet, nrmse, on_rows, recording_of, without_delay
from scipy.signal import savgol_filter

from hil.machine import Machine, load_machine
from hil.machine.load import machine_from_text
from virtual_bus.settings import EffectSetting

RATE_Hz = 1000.0
STEPS = 4
"""Of a free run, a row: the current goes along straight lines between rows."""
EFFORT_MAY_LEAD = True
"""Its metric takes a delay below zero: what was recorded as effort may have acted before its row."""
AXIS = "rotor"
ROUGH_FLAG = {"speed_test1": 0, "speed_test": 1}
"""The flag's value where nothing compensates."""
SPLITS = {"forward": ("speed_test1", "speed_test"), "reversed": ("speed_test", "speed_test1")}
"""File to fit, and file held out."""
RUN_UP_ROWS = 1000
"""The motor starts from standstill there."""
END_ROWS = 50
SLOPE_ROWS, SLOPE_ORDER = 11, 4
"""Of the local polynomial that speeds are taken from."""
WINDOW_ROWS = {"0.1 s": 100, "0.5 s": 500}
CURRENT_SENSOR = """
[sensors.current_rotor]
type = "current"
axis = "rotor"
resolution_A = 0.0
"""


@dataclass(frozen=True)
class Motion:
    """The half of a file without compensation, at an even 1 kHz (rows,)."""

    position: np.ndarray
    speed: np.ndarray
    current: np.ndarray

    @property
    def time_s(self) -> np.ndarray:
        """From 0 on."""
        return np.arange(len(self.position)) / RATE_Hz


def splits() -> dict[str, RealSet]:
    """Return the baselines' splits: "forward" and "reversed"."""
    machine = machine_from_text(load_machine("laas_anti_cogging").text + CURRENT_SENSOR, label="laas_anti_cogging, current measured")
    recordings = {}
    for name in ROUGH_FLAG:
        motion = load(name)
        columns = {f"position_{AXIS}": ("rad", motion.position), f"current_{AXIS}": ("A", motion.current)}
        begins = RATE_Hz * float(motion.position[1] - motion.position[0])  # a local polynomial is far off at the edge
        recordings[name] = recording_of(machine, motion.time_s, columns, {"speeds": [begins]})
    return {split: RealSet(machine, *({name: recordings[name]} for name in names)) for split, names in SPLITS.items()}


@cache
def load(name: str) -> Motion:
    """Return the rough half of a file.

    Stamps are one row late, so each row gets the one before its own; rows that repeat the row before are dropped.
    """
    table = np.genfromtxt(DATA / "laas_anti_cogging" / f"{name}.txt", delimiter=",", skip_header=1)
    is_new = np.any(np.diff(table[:, [1, 2, 4]], axis=0) != 0.0, axis=1)
    kept = (table[1:, 5] == ROUGH_FLAG[name]) & is_new
    stamp, rows = table[:-1, 0][kept], table[1:][kept]
    even = np.arange(stamp[0], stamp[-1], 1.0 / RATE_Hz)
    position, current = np.interp(even, stamp, rows[:, 1]), np.interp(even, stamp, rows[:, 4])
    return Motion(position, savgol_filter(position, SLOPE_ROWS, SLOPE_ORDER, deriv=1, delta=1.0 / RATE_Hz), current)


def errors(
    split: str, machine: Machine, values: np.ndarray | None = None, effects: Sequence[EffectSetting] = (), *, medians: bool = False
) -> dict[str, dict[str, float]]:
    """Return the baselines' error of an answer: NRMSE of the change of position and of the speed in free runs over windows.

    Windows follow each other without gap. A few, in which a run fails at a crest of the cogging, make most of the error.

    Parameters
    ----------
    split : str
        One of `splits`.
    machine : Machine
    values : (parameters,) array or None
        Plant parameters; None: the machine's own.
    effects : sequence of EffectSetting
        Besides the machine's own.
    medians : bool
        Instead, the median window's error over the same denominators.
    """
    others, delays = without_delay(machine, (*machine.plant.effects, *effects))
    simulator = OpenLoop(on_rows(machine, STEPS * RATE_Hz, 1))
    found: dict[str, dict[str, float]] = {}
    for part, name in zip(("train", "held_out"), SPLITS[split], strict=True):
        motion = load(name)
        middles = (np.arange(STEPS * len(motion.position)) + 0.5) / (STEPS * RATE_Hz)
        currents = np.interp(middles - delays, motion.time_s, motion.current)[:, None]
        for words, rows in WINDOW_ROWS.items():
            starts = np.arange(RUN_UP_ROWS, len(motion.position) - rows - END_ROWS, rows)
            runs = []
            for start in starts:
                inside = slice(STEPS * start, STEPS * (start + rows + 1))
                begin = motion.position[start : start + 1], motion.speed[start : start + 1]
                outputs, _ = simulator.drive(currents[inside], *begin, values, others)
                runs.append((outputs.position[::STEPS, 0] - begin[0], outputs.speed[::STEPS, 0]))
            compared = starts[:, None] + np.arange(rows + 1)
            changes = motion.position[compared] - motion.position[starts][:, None]
            for k, (channel, measured) in enumerate({"position": changes, "speed": motion.speed[compared]}.items()):
                model = np.array([run[k] for run in runs])
                typical = np.median(np.sqrt(np.mean((model - measured) ** 2, axis=1))) / measured.std()
                error = float(typical) if medians else nrmse(model, measured)
                found.setdefault(f"{channel}, windows of {words}", {})[part] = error
    return found
