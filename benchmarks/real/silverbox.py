"""The Silverbox: voltage in, voltage out, in open loop, as the baseline takes it.

The input is band-limited between the rows. Recordings have the staircase of the same effect as their command; free runs are driven by the
interpolated input itself, by its mean over each of 16 steps a row: with four, errors of a good answer are a tenth too large.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from real.common import DATA, OpenLoop, RealSet, nrmse, on_rows, recording_of
from real_data import _one_row_later, hold_equivalent
from scipy.signal import resample

from hil.machine import Machine, load_machine
from hil.recording import Recording
from virtual_bus.settings import EffectSetting

STEPS = 16
"""Of a free run, a row."""
UNCOUNTED_ROWS = 50
"""The first ones of each part."""
PARTS = {
    "arrow": (100, 40575),
    "multisines": (40650, 127400),
    "multisines, first three quarters": (40650, 105712),
    "multisines, last quarter": (105712, 127400),
}
SPLITS = {
    "official": (("multisines, first three quarters",), ("arrow", "multisines, last quarter")),
    "reversed": (("arrow",), ("multisines",)),
}
"""Parts to fit and parts held out."""


def splits() -> dict[str, RealSet]:
    """Return the baselines' splits: "official" and "reversed"."""
    machine = load_machine("silverbox")
    return {
        split: RealSet(machine, *({name: _recording(machine, *PARTS[name]) for name in names} for names in both))
        for split, both in SPLITS.items()
    }


def errors(
    split: str, machine: Machine, values: np.ndarray | None = None, effects: Sequence[EffectSetting] = ()
) -> dict[str, dict[str, float]]:
    """Return the baselines' error of an answer: NRMSE of the output in a free run through each part, pooled over the parts.

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
    simulator = OpenLoop(on_rows(machine, STEPS * machine.sample_rate_Hz, 1))
    forces, output = step_means(), recorded()[1]
    found = {}
    for part, names in zip(("train", "held_out"), SPLITS[split], strict=True):
        runs, measured = [], []
        for first, end in (PARTS[name] for name in names):
            pose, speed = np.array([output[first]]), np.array([_first_speed(machine, first)])
            efforts = forces[STEPS * first : STEPS * end, None]
            outputs, _ = simulator.drive(efforts, pose, speed, values, (*machine.plant.effects, *effects))
            runs.append(outputs.position[::STEPS, 0][UNCOUNTED_ROWS:])
            measured.append(output[first + UNCOUNTED_ROWS : end])
        found[part] = nrmse(runs, measured)
    return {"V2": found}


@cache
def recorded() -> tuple[np.ndarray, np.ndarray]:
    """Return input and output [V] (rows,) of the whole record."""
    table = np.genfromtxt(DATA / "silverbox" / "SNLS80mV.csv", delimiter=",", skip_header=1)[:, :2]
    table = table[np.isfinite(table).all(axis=1)]
    return table[:, 0], table[:, 1]


@cache
def step_means() -> np.ndarray:
    """Return the mean (rows x STEPS,) of the band-limited input over each step, by Simpson's rule."""
    values = recorded()[0]
    fine = resample(np.concatenate([values, values[::-1]]), 2 * len(values) * 2 * STEPS)[: len(values) * 2 * STEPS + 1]
    means: np.ndarray = (fine[:-1:2] + 4.0 * fine[1::2] + fine[2::2]) / 6.0
    return means


def _first_speed(machine: Machine, row: int) -> float:
    """Return the slope of the output, by its neighbours."""
    output = recorded()[1]
    return float(0.5 * machine.sample_rate_Hz * (output[row + 1] - output[row - 1]))


def _recording(machine: Machine, first: int, end: int) -> Recording:
    entered, output = recorded()
    columns = {
        "command_mass": ("V", _one_row_later(hold_equivalent(entered))[first:end]),
        "position_mass": ("m", output[first:end]),
    }
    time = np.arange(end - first) / machine.sample_rate_Hz
    initial = {"speeds": [_first_speed(machine, first)]}
    return recording_of(machine, time, columns, initial, experiment={"settle_rows": UNCOUNTED_ROWS})
