"""The Coupled Electric Drives: voltage in, speed of the pulley out, in open loop from rest, as the baseline takes it.

A voltage acts from its row to the next. Held-out recordings are whole, so that the motion where the held-out rows begin is known; the rows
before only settle.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from real.common import DATA, OpenLoop, RealSet, nrmse, on_rows, recording_of
from real_data import _one_row_later
from scipy.optimize import least_squares

from hil.machine import Machine, load_machine
from hil.recording import Recording
from virtual_bus.settings import EffectSetting

TRAIN_ROWS = 400
GIVEN_ROWS = 10
"""The first held-out rows, which the official split takes the state from and does not count."""
RECORDS = {
    "uniform": ("DATAUNIF.csv", {"z11": (0, 2), "z12": (1, 3)}),
    "prbs": ("DATAPRBS.csv", {"z1": (1, 0), "z2": (3, 2), "z3": (5, 4)}),
}
"""File, and columns of voltage and sensor by the record's name."""
SPLITS = {"official": "uniform", "readme": "uniform", "prbs": "prbs"}
FITTED_STATES = [1, 2, 3]
"""Twist of the belt, speed of the motors and speed of the twist: of two positions and two speeds, those that the sensor depends on."""


def splits() -> dict[str, RealSet]:
    """Return the baselines' splits: "official", "readme" (the same recordings) and "prbs"."""
    machine = load_machine("coupled_electric_drives")
    found = {}
    for split, kind in SPLITS.items():
        train, held_out = (
            {name: _recording(machine, *pair, rows, settle) for name, pair in records(kind).items()}
            for rows, settle in ((TRAIN_ROWS, 0), (None, TRAIN_ROWS + (GIVEN_ROWS if split == "official" else 0)))
        )
        found[split] = RealSet(machine, train, held_out)
    return found


def errors(
    split: str, machine: Machine, values: np.ndarray | None = None, effects: Sequence[EffectSetting] = ()
) -> dict[str, dict[str, float]]:
    """Return the baselines' error of an answer: NRMSE of the sensor's output in a free run from rest, pooled over the records.

    In the official split the held-out rows have a run of their own, from the state that fits the given rows best.

    Parameters
    ----------
    split : str
        One of `splits`.
    machine : Machine
    values : (parameters,) array or None
        Plant parameters; None: the machine's own.
    effects : sequence of EffectSetting
        Besides the machine's own.
    """
    simulator = OpenLoop(on_rows(machine, machine.sample_rate_Hz, machine.plant.substeps))
    answer = values, (*machine.plant.effects, *effects)
    rest = np.zeros(1)
    pairs: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"train": [], "held_out": []}
    for voltage, sensor in records(SPLITS[split]).values():
        whole = simulator.drive(voltage[:, None], rest, rest, *answer)[0].speed[:, 0]
        pairs["train"].append((whole[:TRAIN_ROWS], sensor[:TRAIN_ROWS]))
        if split != "official":
            pairs["held_out"].append((whole[TRAIN_ROWS:], sensor[TRAIN_ROWS:]))
            continue
        _, border = simulator.drive(voltage[:TRAIN_ROWS, None], rest, rest, *answer)
        restarted = _restarted(simulator, border.copy(), voltage[TRAIN_ROWS:, None], sensor[TRAIN_ROWS:], answer)
        pairs["held_out"].append((restarted[GIVEN_ROWS:], sensor[TRAIN_ROWS + GIVEN_ROWS :]))
    return {"z": {part: nrmse([model for model, _ in both], [measured for _, measured in both]) for part, both in pairs.items()}}


@cache
def records(kind: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return voltage and sensor's output (rows,) of a file's records."""
    file, columns = RECORDS[kind]
    table = np.genfromtxt(DATA / "coupled_electric_drives" / file, delimiter=",", skip_header=1)
    return {name: (table[:, voltage], table[:, sensor]) for name, (voltage, sensor) in columns.items()}


def _restarted(
    simulator: OpenLoop,
    border: np.ndarray,
    voltage: np.ndarray,
    sensor: np.ndarray,
    answer: tuple[np.ndarray | None, Sequence[EffectSetting]],
) -> np.ndarray:
    """Return the sensor's outputs (rows,) from the state that fits the given rows best, searched from the state `border` on.

    The first of them does not count: in the baseline it is a state of its own, that of the sensor.
    """
    rest = np.zeros(1)

    def outputs(states: np.ndarray, rows: int | None = None) -> np.ndarray:
        begin = border.copy()
        begin[FITTED_STATES] = states
        read: np.ndarray = simulator.drive(voltage[:rows], rest, rest, *answer, begin)[0].speed[:, 0]
        return read

    def residuals(states: np.ndarray) -> np.ndarray:
        missing: np.ndarray = (outputs(states, GIVEN_ROWS) - sensor[:GIVEN_ROWS])[1:]
        return missing

    return outputs(least_squares(residuals, border[FITTED_STATES]).x)


def _recording(machine: Machine, voltage: np.ndarray, sensor: np.ndarray, rows: int | None, settle_rows: int) -> Recording:
    columns = {"command_motors": ("V", _one_row_later(voltage)[:rows]), "speed_motors": ("rad/s", sensor[:rows])}
    time = np.arange(len(sensor[:rows])) / machine.sample_rate_Hz
    return recording_of(machine, time, columns, experiment={"settle_rows": settle_rows} if settle_rows else {})
