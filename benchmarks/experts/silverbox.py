"""Baseline of the Silverbox: an electronic mass on a hardening spring, voltage in, voltage out, 131 072 rows at 610.35 Hz.

The model is `m y'' + (d + d1 y + d2 y^2) y' + k y + k2 y^2 + k3 y^3 = u + u0` in volts and seconds: the documented cubic spring with its
small offset and asymmetry. The circuit only resembles its equation, so the damping may change with the position; that is chosen within
the training part, every fourth window of it left out.

The input was recorded through an anti-alias filter: between two rows it is no staircase but the band-limited signal, here interpolated in
the spectrum of the record and its mirror image. The equation is integrated by Runge and Kutta's fourth-order method, four steps a row.

Free runs are fitted in windows that run side by side. Each starts at rest long before its first counted row: the oscillator forgets its
start in 30 rows. Errors are those of free runs through whole parts of the record.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import data_folder, fit_simulations, nrmse, run

RATE_Hz = 1e7 / 2**14
STEPS = 4  # a row; the resonance at 70 Hz then takes 35 steps a period
FORGET_ROWS = 500  # a motion has died away to 1e-7 after them
WINDOWS = 100
UNCOUNTED_ROWS = 50  # the benchmark gives these for finding the initial state
MILLI = 1e3
LEFT_OUT = 4  # one window in so many, for choosing: an arrow's last quarter would hold its largest amplitudes alone

# Parts of the record as the benchmark's loader cuts them: an arrow of growing noise, then ten odd multisines.
ARROW = (100, 40575)
ARROW_INSIDE = (100, 32100)  # no larger than the multisines
MULTISINES = (40650, 127400)
MULTISINES_TRAIN = (40650, 105712)  # three quarters
MULTISINES_TEST = (105712, 127400)


@dataclass(frozen=True)
class Parameter:
    """A parameter, its start and its scale."""

    name: str
    unit: str
    start: float
    scale: float


PARAMETERS = (
    Parameter("inverse_mass", "1/s2", 1.85e5, 1.85e5),  # V/V: from a resonance of 68 Hz at stiffness 1
    Parameter("damping", "s", 2.3e-4, 2.3e-4),
    Parameter("stiffness", "V/V", 1.0, 1.0),
    Parameter("offset", "V", 0.0, 1e-3),
    Parameter("quadratic", "1/V", 0.0, 0.1),
    Parameter("cubic", "1/V2", 0.0, 1.0),
    Parameter("damping_by_position", "s/V", 0.0, 1e-4),
    Parameter("damping_by_position_squared", "s/V2", 0.0, 1e-3),
)
NAMES = [parameter.name for parameter in PARAMETERS]
LINEAR = ("inverse_mass", "damping", "stiffness", "offset")
CUBIC = (*LINEAR, "cubic")
STRUCTURES = {
    "cubic": CUBIC,
    "cubic and quadratic": (*CUBIC, "quadratic"),
    "cubic, quadratic, and damping that changes with the position": (
        *CUBIC,
        "quadratic",
        "damping_by_position",
        "damping_by_position_squared",
    ),
}


@dataclass(frozen=True)
class Box:
    """The record: input between the rows, STEPS x 2 values a row, and output (rows,)."""

    fine_input_V: np.ndarray
    output_V: np.ndarray


def read_box() -> Box:
    """Return the whole record."""
    rows = np.genfromtxt(data_folder() / "silverbox" / "SNLS80mV.csv", delimiter=",", skip_header=1)[:, :2]
    rows = rows[np.isfinite(rows).all(axis=1)]
    return Box(interpolated(rows[:, 0], 2 * STEPS), rows[:, 1])


def interpolated(values: np.ndarray, factor: int) -> np.ndarray:
    """Return the band-limited signal with these samples at `factor` times their rate."""
    both = np.concatenate([values, values[::-1]])
    spectrum = np.zeros(len(both) * factor // 2 + 1, dtype=complex)
    spectrum[: len(values) + 1] = np.fft.rfft(both)
    spectrum[len(values)] *= 0.5
    return np.asarray(np.fft.irfft(spectrum, len(both) * factor)[: len(values) * factor] * factor)


def simulate(parameters: np.ndarray, box: Box, starts: np.ndarray, rows: int, state: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return outputs [V], (rows, sets, windows), of (sets, 8) parameters, from `state`, position and speed of each window, on."""
    inverse_mass, damping, stiffness, offset, quadratic, cubic, damping_1, damping_2 = parameters.T[:, :, None]
    step = 1.0 / (RATE_Hz * STEPS)

    def acceleration(y: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        spring = y * (stiffness + y * (quadratic + y * cubic))
        return np.asarray((force - (damping + y * (damping_1 + y * damping_2)) * v - spring) * inverse_mass)

    shape = (len(parameters), len(starts))
    y, v = (np.broadcast_to(values, shape) for values in state)
    outputs = np.empty((rows, *shape))
    at = starts * 2 * STEPS
    last = len(box.fine_input_V) - 1
    for row in range(rows):
        outputs[row] = y
        for _ in range(STEPS):
            before, middle, after = (box.fine_input_V[np.minimum(at + k, last)] + offset for k in range(3))
            a1 = acceleration(y, v, before)
            v2 = v + 0.5 * step * a1
            a2 = acceleration(y + 0.5 * step * v, v2, middle)
            v3 = v + 0.5 * step * a2
            a3 = acceleration(y + 0.5 * step * v2, v3, middle)
            v4 = v + step * a3
            a4 = acceleration(y + step * v3, v4, after)
            y = y + step / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v = v + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            at = at + 2
    return outputs


def filled(values: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return (sets, 8) parameters from (sets, n) of `names`, the others zero."""
    full = np.zeros((len(values), len(NAMES)))
    full[:, [NAMES.index(name) for name in names]] = values
    return full


@dataclass(frozen=True)
class Windows:
    """Windows of a part: first rows (windows,), what is counted of each (rows, windows), and the box."""

    box: Box
    starts: np.ndarray
    measured_V: np.ndarray

    @classmethod
    def of(cls, box: Box, part: tuple[int, int]) -> Windows:
        rows = (part[1] - part[0] - FORGET_ROWS) // WINDOWS
        starts = part[0] + np.arange(WINDOWS) * rows
        return cls(box, starts, box.output_V[starts[:, None] + FORGET_ROWS + np.arange(rows)].T)

    def only(self, chosen: np.ndarray) -> Windows:
        return Windows(self.box, self.starts[chosen], self.measured_V[:, chosen])

    def outputs(self, parameters: np.ndarray) -> np.ndarray:
        """Return the counted outputs [V], (rows, sets, windows)."""
        rest = np.zeros(len(self.starts))
        outputs = simulate(parameters, self.box, self.starts, FORGET_ROWS + len(self.measured_V), (rest, rest))
        return outputs[FORGET_ROWS:]


def fit(windows: Windows, names: Sequence[str]) -> np.ndarray:
    """Return all parameters (8,), those of `names` fitted to the windows."""

    def residuals(values: np.ndarray) -> np.ndarray:
        errors = windows.outputs(filled(values, names)) - windows.measured_V[:, None]
        return np.asarray(MILLI * errors).transpose(1, 0, 2).reshape(len(values), -1)

    chosen = [PARAMETERS[NAMES.index(name)] for name in names]
    found, _ = fit_simulations(residuals, [p.start for p in chosen], [p.scale for p in chosen], max_nfev=15, xtol=1e-7, ftol=1e-7)
    return np.asarray(filled(found[None], names)[0])


def choose(windows: Windows) -> tuple[str, dict[str, float]]:
    """Return the structure that predicts the windows left out best, fitted to the others, and the NRMSE there of each."""
    left_out = np.arange(WINDOWS) % LEFT_OUT == LEFT_OUT - 1
    judged = windows.only(left_out)
    stages = np.array([fit(windows.only(~left_out), names) for names in STRUCTURES.values()])
    outputs = judged.outputs(stages)
    errors = {words: round(nrmse(outputs[:, k], judged.measured_V), 6) for k, words in enumerate(STRUCTURES)}
    return min(errors, key=lambda words: errors[words]), errors


def free_run(stages: np.ndarray, box: Box, part: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return outputs (rows, stages) of a whole part and what was measured (rows,), without the first rows."""
    first, end = part
    speed = 0.5 * RATE_Hz * (box.output_V[first + 1] - box.output_V[first - 1])
    outputs = simulate(stages, box, np.array([first]), end - first, (box.output_V[[first]], np.array([speed])))
    return outputs[UNCOUNTED_ROWS:, :, 0], box.output_V[first + UNCOUNTED_ROWS : end]


def split(box: Box, train: dict[str, tuple[int, int]], held_out: dict[str, tuple[int, int]], *, official: bool) -> dict[str, Any]:
    """Fit the training part and measure both; `held_out` may name subsets behind a comma, which are not pooled."""
    began = time.perf_counter()
    (part,) = train.values()
    windows = Windows.of(box, part)
    words, validation = choose(windows)
    stages = {
        "nominal": fit(windows, LINEAR),
        "cubic": fit(windows, CUBIC),
        "fitted": fit(windows, STRUCTURES[words]),
    }
    values = np.array(list(stages.values()))
    runs = {name: free_run(values, box, rows) for name, rows in (train | held_out).items()}
    pooled = {"train": list(train), "held_out": [name for name in held_out if "," not in name]}
    return {
        "train": [f"{name}, rows {a} to {b - 1}" for name, (a, b) in train.items()],
        "held_out": [f"{name}, rows {a} to {b - 1}" for name, (a, b) in held_out.items()],
        "metric": f"NRMSE of the output V2 in a free run through each whole part at {RATE_Hz:.3f} Hz, driven by the input V1, which is "
        f"interpolated band-limited between rows; pooled over parts, the first {UNCOUNTED_ROWS} rows of each not counted. Initial output: "
        "measured at the part's first row. Initial speed: slope there of a quadratic through that row and its two neighbours.",
        "official": official,
        "nominal_is": "linear spring, mass, damper and offset, fitted to the training part; 'cubic' adds the cubic spring; "
        f"'fitted' is: {words}",
        "parameters": {
            parameter.name: {"value": float(f"{value:.6g}"), "unit": parameter.unit, "documented": None}
            for parameter, value in zip(PARAMETERS, stages["fitted"], strict=True)
            if parameter.name in STRUCTURES[words]
        },
        "channels": {
            "V2": {
                stage: {
                    side: round(nrmse([runs[name][0][:, k] for name in names], [runs[name][1] for name in names]), 6)
                    for side, names in pooled.items()
                }
                for k, stage in enumerate(stages)
            }
        },
        "other_metrics": {
            "rms error [mV]": {
                name: {stage: round(float(MILLI * np.sqrt(np.mean((outputs[:, k] - measured) ** 2))), 4) for k, stage in enumerate(stages)}
                for name, (outputs, measured) in runs.items()
            },
            "NRMSE by structure in every fourth window of the training part, fitted to the others": validation,
        },
        "seconds": round(time.perf_counter() - began, 1),
    }


def splits() -> dict[str, Any]:
    """Return both splits."""
    box = read_box()
    arrow = {"arrow": ARROW}
    return {
        "official": split(
            box,
            {"multisines, first three quarters": MULTISINES_TRAIN},
            arrow | {"arrow, no larger than the multisines": ARROW_INSIDE} | {"multisines": MULTISINES_TEST},
            official=True,
        ),
        "reversed": split(box, arrow, {"multisines": MULTISINES}, official=False),
    }


if __name__ == "__main__":
    run("silverbox", __doc__, splits)
