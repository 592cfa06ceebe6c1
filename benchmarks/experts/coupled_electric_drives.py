"""Baseline of the Coupled Electric Drives: two motors drive a belt over a pulley that springs hold; records of 10 s at 50 Hz.

The model has an inertia for the motors, one for the pulley, the belt as spring and damper between them, and the documented sensor of the
pulley's speed, which does not know its sign. Voltage counts as torque and speed as the sensor's output, so inertias are in units of both.
A lag lies before the sensor, and one may lie behind it; its output may grow faster than the speed. Friction of the motors may be Coulomb
friction that changes with speed, that of the pulley quadratic. How much of this is kept is chosen within the training rows: fitted to the
first three quarters, judged by the last.

The sensor hides the sign of the speed, so the error has many minima: every fit begins from several starts, drawn around a guess.

The linear part is propagated exactly between steps, four a row; after every step friction takes its impulse from the speed and stops at
zero. The voltage is held from its row to the next. All records begin at rest.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import data_folder, fit_simulations, nrmse, run
from scipy.linalg import expm
from scipy.optimize import least_squares

PERIOD_s = 0.02
STEPS = 4  # a row; the belt's resonance at 4 Hz takes 50 steps a period
TRAIN_ROWS = 400
VALIDATION_ROWS = 100  # the last of the training rows
GIVEN_ROWS = 10  # of the held-out rows the benchmark gives these to find the state at their beginning
STARTS = 6
START_SPREAD = 0.7  # standard deviation of a start's logarithms: a factor of two either way
NO_LAG_s = 1e-4  # much shorter than a step
LOG_LIMIT = 7.0  # how far a parameter may go from its guess, as a logarithm
FILES = {"uniform": ("DATAUNIF.csv", ((0, 2), (1, 3))), "prbs": ("DATAPRBS.csv", ((1, 0), (3, 2), (5, 4)))}


@dataclass(frozen=True)
class Parameter:
    """A parameter and a guess. All but the offset are positive and fitted as logarithms."""

    name: str
    unit: str
    guess: float
    absent: float = 0.0


PARAMETERS = (
    Parameter("motor_inertia", "V s2", 0.2),
    Parameter("motor_viscous", "V s", 1.0),
    Parameter("pulley_inertia", "V s2", 0.03),  # with belt_stiffness: a belt resonance of 3 Hz, as the oscillations in the records
    Parameter("belt_stiffness", "V", 12.0),
    Parameter("belt_damping", "V s", 0.1),
    Parameter("sensor_lag", "s", 0.05),
    Parameter("sensor_offset", "", 0.02),
    Parameter("sensor_curve", "", 0.5),  # output is s + curve s^2
    Parameter("coulomb", "V", 0.6),
    Parameter("coulomb_at_rest", "V", 0.3),
    Parameter("coulomb_speed", "1", 0.5, absent=1.0),  # at which Coulomb friction is 1/e from its moving value
    Parameter("pulley_quadratic", "V s2", 0.3),
    Parameter("sensor_smoothing", "s", 0.01),  # lag behind the rectifier
)
NAMES = [parameter.name for parameter in PARAMETERS]
OFFSET = NAMES.index("sensor_offset")
OFFSET_SCALE = 0.02
BELT = ("motor_inertia", "motor_viscous", "pulley_inertia", "belt_stiffness", "belt_damping", "sensor_lag", "sensor_offset")
BY_SPEED = ("coulomb", "coulomb_at_rest", "coulomb_speed")
STRUCTURES = {
    "rectified": BELT,
    "rectified, Coulomb": (*BELT, "coulomb"),
    "rectified and curved, Coulomb": (*BELT, "coulomb", "sensor_curve"),
    "rectified and curved, Coulomb by speed": (*BELT, *BY_SPEED, "sensor_curve"),
    "rectified and curved, Coulomb by speed, quadratic at the pulley": (*BELT, *BY_SPEED, "sensor_curve", "pulley_quadratic"),
    "rectified, curved and smoothed, Coulomb by speed, quadratic at the pulley": (
        *BELT,
        *BY_SPEED,
        "sensor_curve",
        "pulley_quadratic",
        "sensor_smoothing",
    ),
}


@dataclass(frozen=True)
class Records:
    """Records of equal length: voltages and sensor outputs, (records, rows)."""

    names: tuple[str, ...]
    voltage: np.ndarray
    output: np.ndarray

    def first(self, rows: int) -> Records:
        return Records(self.names, self.voltage[:, :rows], self.output[:, :rows])


def read_records(kind: str) -> Records:
    """Return the records of one file."""
    name, columns = FILES[kind]
    path = data_folder() / "coupled_electric_drives" / name
    names = path.read_text().splitlines()[0].replace('"', "").split(",")
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    inputs, outputs = ([pair[k] for pair in columns] for k in (0, 1))
    return Records(tuple(names[k] for k in outputs), table[:, inputs].T, table[:, outputs].T)


def simulate(
    parameters: np.ndarray, voltage: np.ndarray, state: np.ndarray | None = None, *, signed: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return outputs (rows, sets, records) and the last state of (sets, 13) parameters under voltages (records, rows).

    The state (sets, records, 5) is motor speed, belt twist, pulley speed, lagged pulley speed and output without offset; None is rest.
    The state that is returned is the one of the row behind the last.
    """
    j1, d1, j2, k, c, lag, offset, curve, coulomb, at_rest, speed, quadratic, smoothing = parameters.T
    at_rest = np.where(at_rest > 0.0, at_rest, coulomb)
    system = np.zeros((len(parameters), 5, 5))
    system[:, 0] = np.stack([-(d1 + c) / j1, -k / j1, c / j1, 0.0 * k, 1.0 / j1], axis=1)
    system[:, 1, 0], system[:, 1, 2] = 1.0, -1.0
    system[:, 2, :3] = np.stack([c / j2, k / j2, -c / j2], axis=1)
    system[:, 3, 2], system[:, 3, 3] = 1.0 / lag, -1.0 / lag
    step = PERIOD_s / STEPS
    transition = expm(step * system)
    advance, push = transition[:, :4, :4].swapaxes(1, 2), transition[:, None, :4, 4]
    moving, extra = (step / j1 * coulomb)[:, None], (step / j1 * (at_rest - coulomb))[:, None]
    rate, drag, bend = 1.0 / speed[:, None], (step / j2 * quadratic)[:, None], curve[:, None]
    kept = np.exp(-step / np.maximum(smoothing, NO_LAG_s))[:, None]
    start = np.zeros((len(parameters), len(voltage), 5)) if state is None else state
    x, output = start[:, :, :4].copy(), start[:, :, 4].copy()
    outputs = np.empty((voltage.shape[1], *output.shape))
    for row in range(voltage.shape[1]):
        outputs[row] = output
        pushed = voltage[None, :, row, None] * push
        for _ in range(STEPS):
            friction = moving + extra * np.exp(-np.abs(x[:, :, 0]) * rate)
            x = x @ advance + pushed
            x[:, :, 0] -= np.clip(x[:, :, 0], -friction, friction)
            x[:, :, 2] /= 1.0 + drag * np.abs(x[:, :, 2])
            size = np.abs(x[:, :, 3])
            output = kept * output + (1.0 - kept) * (x[:, :, 3] if signed else size * (1.0 + bend * size))
    return outputs + offset[:, None], np.concatenate([x, output[:, :, None]], axis=2)


def from_logarithms(points: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return (sets, 13) parameters from (sets, n) coordinates of a fit; parameters that are not in `names` have no effect."""
    full = np.tile([parameter.absent for parameter in PARAMETERS], (len(points), 1))
    for column, name in enumerate(names):
        full[:, NAMES.index(name)] = points[:, column] if name == "sensor_offset" else np.exp(points[:, column])
    return full


def fit(records: Records, names: Sequence[str], *, signed: bool = False) -> np.ndarray:
    """Return all parameters (13,), those of `names` fitted to the free runs of the records: the best of several starts."""
    free = [PARAMETERS[NAMES.index(name)] for name in names]
    is_offset = np.array([p.name == "sensor_offset" for p in free])
    guess = np.where(is_offset, 0.0, np.log([p.guess for p in free]))
    scale = np.where(is_offset, OFFSET_SCALE, 1.0)
    random = np.random.default_rng(0)

    def residuals(points: np.ndarray) -> np.ndarray:
        outputs, _ = simulate(from_logarithms(points, names), records.voltage, signed=signed)
        return np.asarray(outputs - records.output.T[:, None]).transpose(1, 0, 2).reshape(len(points), -1)

    found = []
    for number in range(STARTS):
        start = guess + (START_SPREAD * ~is_offset * random.standard_normal(len(free)) if number else 0.0)
        bounds = ((guess - LOG_LIMIT) / scale, (guess + LOG_LIMIT) / scale)
        found.append(fit_simulations(residuals, start, scale, bounds=bounds, max_nfev=60, xtol=1e-6, ftol=1e-6))
    best = min(found, key=lambda pair: pair[1])[0]
    return np.asarray(from_logarithms(best[None], names)[0])


def choose(train: Records) -> tuple[str, dict[str, float]]:
    """Return the structure that predicts the last training rows best, fitted to those before, and the NRMSE there of each."""
    rows = train.output.shape[1] - VALIDATION_ROWS
    errors = {}
    for words, names in STRUCTURES.items():
        outputs, _ = simulate(fit(train.first(rows), names)[None], train.voltage)
        errors[words] = round(nrmse(outputs[rows:, 0], train.output[:, rows:].T), 5)
    return min(errors, key=lambda words: errors[words]), errors


def continued(values: np.ndarray, records: Records, rows: slice, *, signed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return outputs and measured outputs (rows, records) of a free run from the records' beginning on."""
    outputs, _ = simulate(values[None], records.voltage, signed=signed)
    return outputs[rows, 0], records.output[:, rows].T


def restarted(values: np.ndarray, records: Records, *, signed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return outputs and measured outputs (rows, records) of held-out rows behind the given ones.

    The state at the beginning of each record's held-out rows is fitted to the given rows, starting from the state that the free run
    through the training rows ends in.
    """
    _, at_border = simulate(values[None], records.voltage[:, :TRAIN_ROWS], signed=signed)
    columns = []
    for number in range(len(records.names)):
        voltage = records.voltage[number : number + 1, TRAIN_ROWS:]
        given = records.output[number, TRAIN_ROWS : TRAIN_ROWS + GIVEN_ROWS]

        def outputs(state: np.ndarray, voltage: np.ndarray) -> np.ndarray:
            return np.asarray(simulate(values[None], voltage, state[None, None], signed=signed)[0][:, 0, 0])

        def residual(state: np.ndarray, voltage: np.ndarray = voltage[:, :GIVEN_ROWS], given: np.ndarray = given) -> np.ndarray:
            return np.asarray(outputs(state, voltage) - given)

        state = least_squares(residual, at_border[0, number]).x
        columns.append(outputs(state, voltage)[GIVEN_ROWS:])
    return np.stack(columns, axis=1), records.output[:, TRAIN_ROWS + GIVEN_ROWS :].T


@dataclass(frozen=True)
class Fitted:
    """All stages fitted to a file's training rows, the structure that was chosen, and the errors that it was chosen by."""

    records: Records
    stages: dict[str, np.ndarray]
    words: str
    validation: dict[str, float]
    seconds: float


def fit_file(kind: str) -> Fitted:
    """Choose the structure for a file's records and fit all stages."""
    began = time.perf_counter()
    records = read_records(kind)
    train = records.first(TRAIN_ROWS)
    words, validation = choose(train)
    stages = {"nominal": fit(train, BELT, signed=True), "rectified": fit(train, BELT), "fitted": fit(train, STRUCTURES[words])}
    return Fitted(records, stages, words, validation, time.perf_counter() - began)


def split(fitted: Fitted, *, official: bool) -> dict[str, Any]:
    """Measure both parts of a file's records; `official` restarts the held-out rows as the benchmark does."""
    records, stages, words = fitted.records, fitted.stages, fitted.words
    signed = {"nominal"}
    parts: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {"train": {}, "held_out": {}}
    rms = {}
    for stage, values in stages.items():
        run_on = continued(values, records, slice(TRAIN_ROWS, None), signed=stage in signed)
        parts["train"][stage] = continued(values, records, slice(TRAIN_ROWS), signed=stage in signed)
        parts["held_out"][stage] = restarted(values, records, signed=stage in signed) if official else run_on
        outputs, measured = parts["held_out"][stage]
        rms[stage] = {name: round(float(np.sqrt(np.mean((outputs - measured)[:, k] ** 2))), 4) for k, name in enumerate(records.names)}
    last = records.output.shape[1] - 1
    way = (
        f"first {GIVEN_ROWS} of the held-out rows not counted: they give the state at row {TRAIN_ROWS} of each record by least squares, "
        "begun at the state that the free run through the training rows ends in"
        if official
        else "through the training rows into the held-out rows, all counted"
    )
    return {
        "train": [f"{name}, rows 0 to {TRAIN_ROWS - 1}" for name in records.names],
        "held_out": [f"{name}, rows {TRAIN_ROWS} to {last}" for name in records.names],
        "metric": "NRMSE of the sensor's output z, pooled over the records, in a free run at 50 Hz driven by the voltage u, held from its "
        f"row to the next; from rest at row 0; {way}.",
        "official": official,
        "nominal_is": "linear: motors, belt and pulley, lag and offset, and a sensor that knows the sign, fitted to the training rows; "
        f"'rectified' has the documented sensor; 'fitted' is: {words}",
        "parameters": {
            parameter.name: {"value": float(f"{value:.4g}"), "unit": parameter.unit, "documented": None}
            for parameter, value in zip(PARAMETERS, stages["fitted"], strict=True)
            if parameter.name in STRUCTURES[words]
        },
        "channels": {
            "z": {
                stage: {part: round(nrmse(*(runs.ravel()[None] for runs in found[stage])), 5) for part, found in parts.items()}
                for stage in stages
            }
        },
        "other_metrics": {
            "rms error of the held-out rows by record [the sensor's unit]": rms,
            f"NRMSE by structure in rows {TRAIN_ROWS - VALIDATION_ROWS} to {TRAIN_ROWS - 1}, fitted to those before": fitted.validation,
        },
        "seconds": round(fitted.seconds, 1),
    }


def splits() -> dict[str, Any]:
    """Return all splits."""
    uniform, prbs = fit_file("uniform"), fit_file("prbs")
    return {
        "official": split(uniform, official=True),
        "readme": split(uniform, official=False),
        "prbs": split(prbs, official=False),
    }


if __name__ == "__main__":
    run("coupled_electric_drives", __doc__, splits)
