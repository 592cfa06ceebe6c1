"""The free double pendulum: windows of 1.333 s from recorded angles and the slope of a quadratic, as the baseline takes them.

The two drives of the machine file have nothing to do: the recordings have commands of 0. The recorded speeds, which lag the angles by 0.5
to 1 ms, are left out.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from real.common import DATA, RealSet, free_run, machine_of, nrmse, on_rows, recording_of
from scipy.signal import savgol_filter

from hil.machine import Machine
from hil.recording import Recording
from hil.simulation import Simulator
from virtual_bus.settings import EffectSetting

RATE_Hz = 1000.0
SUBSTEPS = 2
WINDOW_ROWS = 1333
SLOPE_ROWS = 21
NUMBERS = range(1, 61)
ODD, EVEN = tuple(NUMBERS)[::2], tuple(NUMBERS)[1::2]
SPLITS = {"readme": (ODD, EVEN), "reversed": (EVEN, ODD), "time": (tuple(NUMBERS)[:30], tuple(NUMBERS)[30:])}
"""Windows to fit and windows held out, counted from 1."""


def splits() -> dict[str, RealSet]:
    """Return the splits. Windows that follow each other are one recording: of "time" there are two of 40 s."""
    machine = machine_of("dpend")
    angles, slopes = _table()
    return {
        name: RealSet(machine, *({_words(run): _recording(machine, angles, slopes, run) for run in _stretches(part)} for part in parts))
        for name, parts in SPLITS.items()
    }


def errors(
    split: str, machine: Machine, values: np.ndarray | None = None, effects: Sequence[EffectSetting] = ()
) -> dict[str, dict[str, float]]:
    """Return the NRMSE of both absolute angles in free runs over the windows of both parts."""
    angles, slopes = _table()
    simulator = Simulator(on_rows(machine, RATE_Hz, SUBSTEPS))
    none = np.zeros((WINDOW_ROWS, 2))
    found: dict[str, dict[str, float]] = {"angle_1": {}, "angle_2": {}}
    for part, numbers in zip(("train", "held_out"), SPLITS[split], strict=True):
        starts = [WINDOW_ROWS * (number - 1) for number in numbers]
        paths = [free_run(simulator, none, _of_joints(angles[row]), _of_joints(slopes[row]), values, effects) for row in starts]
        measured = [angles[row : row + WINDOW_ROWS] for row in starts]
        for arm, errors_of in enumerate(found.values()):
            errors_of[part] = nrmse([path[:, arm] for path in paths], [window[:, arm] for window in measured])
    return found


def _table() -> tuple[np.ndarray, np.ndarray]:
    """Return absolute angles (rows, 2) and their slopes."""
    angles = np.genfromtxt(DATA / "dpend" / "dpend.csv.gz", delimiter=",", skip_header=1)[:, 1:3]
    return angles, savgol_filter(angles, SLOPE_ROWS, 2, deriv=1, delta=1.0 / RATE_Hz, axis=0, mode="interp")


def _of_joints(absolute: np.ndarray) -> np.ndarray:
    """Return positions or speeds (2,) of the joints from those of the arms."""
    return np.array([absolute[0], absolute[1] - absolute[0]])


def _stretches(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """Return the first and last of numbers that follow each other."""
    edges = [0, *(np.flatnonzero(np.diff(numbers) != 1) + 1).tolist(), len(numbers)]
    return [(numbers[a], numbers[b - 1]) for a, b in itertools.pairwise(edges)]


def _words(run: tuple[int, int]) -> str:
    return f"window {run[0]}" if run[0] == run[1] else f"windows {run[0]} to {run[1]}"


def _recording(machine: Machine, angles: np.ndarray, slopes: np.ndarray, run: tuple[int, int]) -> Recording:
    rows = slice(WINDOW_ROWS * (run[0] - 1), WINDOW_ROWS * run[1])
    first, second = angles[rows].T
    time, none = np.arange(len(first)) / RATE_Hz, np.zeros(len(first))
    columns = {"position_first": ("rad", first), "position_second": ("rad", second), "command_first": ("Nm", none)}
    columns["command_second"] = ("Nm", none)
    initial = {"speeds": _of_joints(slopes[rows.start]).tolist()}  # of the joints, as the start pose is: the second encoder reads a sum
    return recording_of(machine, time, columns, initial, experiment={"start_pose": _of_joints(angles[rows.start]).tolist()})
