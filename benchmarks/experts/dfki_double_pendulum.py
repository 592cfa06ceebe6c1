"""Baseline of the DFKI double pendulum: two arms, a geared motor at each joint, swinging up to 2 rad from hanging.

The model is the double pendulum with the rotors' inertia and, at each joint, Coulomb, viscous and load-dependent friction. Torques are
given, positions are simulated, in open loop. Fitted on whole recordings: inertias, gravity, frictions, the gain of the elbow's torque
(the shoulder's is 1, which sets the scale), the delay of the torques, and for each training recording two zeros of position. Both
torques, measured and commanded, are tried: the one that fits the training recordings better is taken.

The zeros are needed because a pendulum at rest is held by its friction anywhere within some 0.1 rad, and is called zero there. A held-out
recording is run with zeros of 0; beside that, its zeros are fitted on its first second.

The error is that of position in a free run of the whole recording, from rest. Windows of 1 s from the measured state are given as well.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import data_folder, fit_simulations, nrmse, run
from scipy.signal import savgol_filter

RECORDINGS = ("00", "02", "03", "04", "05")
FULL_RATE_Hz = 500.0
README_RATE_Hz, README_SECONDS = 125.0, 4.0
STEP_s = 2e-3  # of the integrator at most: friction turns over in no less than 7 ms, see SLIP_SPEED_rad_s
WINDOW_s = 1.0
FIRST_SECONDS = (2.0, np.inf)  # a fit begins with the first 2 s, where a wrong start cannot throw the pendulum off its course
ZERO_SECONDS = 1.0
SMOOTH_ROWS = 13  # rows at 500 Hz of the quadratic whose slope is a window's first speed: 26 ms, in which the speed hardly bends
SLIP_SPEED_rad_s = 0.1  # friction is smooth below it; 0.05 and 0.25 fit the training recordings as well
GRAVITY_m_s2 = 9.81
FIRST_ARM_m = 0.2

FIRST_kg, SECOND_kg = 0.5476, 0.5979
FIRST_CENTRE_m, SECOND_CENTRE_m = 0.2, 0.275
FIRST_kg_m2, SECOND_kg_m2 = 0.02421, 0.05345  # about their joints
ROTOR_kg_m2 = 6.0**2 * 6.287e-5  # behind a gear of 6


@dataclass(frozen=True)
class Parameter:
    """A number of the model: its unit, nominal value, where a fit starts, its bounds, the scale of its changes, the documented value."""

    unit: str
    nominal: float
    start: float
    low: float
    high: float
    scale: float
    documented: float | None


def _body(unit: str, nominal: float) -> Parameter:
    return Parameter(unit, nominal, nominal, 0.0, 4.0 * nominal, nominal, nominal)


PARAMETERS = {
    # the first arm about the shoulder, with the second one's mass at the elbow and the first rotor
    "inertia_shoulder": _body("kg m2", FIRST_kg_m2 + SECOND_kg * FIRST_ARM_m**2 + ROTOR_kg_m2),
    "inertia_elbow": _body("kg m2", SECOND_kg_m2),  # the second arm about the elbow
    "rotor_elbow": _body("kg m2", ROTOR_kg_m2),
    "gravity_shoulder": _body("Nm", (FIRST_kg * FIRST_CENTRE_m + SECOND_kg * FIRST_ARM_m) * GRAVITY_m_s2),
    "gravity_elbow": _body("Nm", SECOND_kg * SECOND_CENTRE_m * GRAVITY_m_s2),
    "coulomb_shoulder": Parameter("Nm", 0.0, 0.0928, 0.0, 0.5, 0.05, 0.0928),
    "coulomb_elbow": Parameter("Nm", 0.0, 0.0771, 0.0, 0.5, 0.05, 0.0771),
    "viscous_shoulder": Parameter("Nm s/rad", 0.0, 0.0111, 0.0, 0.1, 0.01, 0.0111),
    "viscous_elbow": Parameter("Nm s/rad", 0.0, 0.0044, 0.0, 0.1, 0.01, 0.0044),
    "load_friction_shoulder": Parameter("1", 0.0, 0.02, -0.3, 0.5, 0.1, None),  # of the motor's torque
    "load_friction_elbow": Parameter("1", 0.0, 0.02, -0.3, 0.5, 0.1, None),
    "torque_gain_elbow": Parameter("1", 1.0, 1.0, 0.5, 2.0, 0.2, None),
    "delay": Parameter("s", 0.0, 0.004, -0.01, 0.03, 0.005, None),
}
NAMES = list(PARAMETERS)
NOMINAL = np.array([parameter.nominal for parameter in PARAMETERS.values()])
ZERO_SCALE_rad, ZERO_LIMIT_rad = 0.05, 0.3


@dataclass(frozen=True)
class Record:
    """A recording on even rows: position and speed (rows, 2), and both torques as integrals over the recorded times."""

    name: str
    row_s: float
    position: np.ndarray
    speed: np.ndarray
    recorded_s: np.ndarray
    impulses: Mapping[str, np.ndarray]

    def torque(self, source: str, delay: float) -> np.ndarray:
        """Return the torques (rows, 2) [Nm] that act from each row to the next: means of the recorded ones, delayed [s]."""
        edges = np.arange(len(self.position) + 1) * self.row_s - delay
        impulse = [np.interp(edges, self.recorded_s, column) for column in self.impulses[source].T]
        mean: np.ndarray = np.diff(impulse, axis=1).T / self.row_s
        return mean


def load(name: str, rate_Hz: float, seconds: float) -> Record:
    """Return a recording from its start, resampled by straight lines between the recorded rows."""
    table = np.genfromtxt(data_folder() / "dfki_double_pendulum" / f"traj_{name}.csv", delimiter=",", names=True)
    recorded = table["time"]
    columns = {kind: np.stack([table[f"{kind}{joint}"] for joint in (1, 2)], axis=1) for kind in ("pos_meas", "tau_meas", "tau_con")}
    fine = np.arange(0.0, recorded[-1], 1.0 / FULL_RATE_Hz)
    even = np.stack([np.interp(fine, recorded, column) for column in columns["pos_meas"].T], axis=1)
    slope = savgol_filter(even, SMOOTH_ROWS, 2, deriv=1, delta=1.0 / FULL_RATE_Hz, axis=0)
    times = np.arange(0.0, min(seconds, recorded[-1]), 1.0 / rate_Hz)
    position, speed = (np.stack([np.interp(times, fine, column) for column in both.T], axis=1) for both in (even, slope))
    speed[0] = 0.0  # at rest
    impulses = {}
    for source in ("tau_meas", "tau_con"):
        torque = columns[source]
        areas = 0.5 * (torque[1:] + torque[:-1]) * np.diff(recorded)[:, None]
        impulses[source] = np.vstack([np.zeros(2), np.cumsum(areas, axis=0)])
    return Record(name, 1.0 / rate_Hz, position, speed, recorded, impulses)


def accelerations(parameters: Mapping[str, np.ndarray], angle: np.ndarray, speed: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Return (2, sets, runs) accelerations [rad/s²] of shoulder and elbow; the elbow's angle is relative to the first arm."""
    p = parameters
    sticking = np.tanh(speed / SLIP_SPEED_rad_s)
    coupling = p["gravity_elbow"] / GRAVITY_m_s2 * FIRST_ARM_m
    even, odd = coupling * np.cos(angle[1]), coupling * np.sin(angle[1])
    second_gravity = p["gravity_elbow"] * np.sin(angle[0] + angle[1])
    shoulder = (
        torque[0]
        - (p["coulomb_shoulder"] + p["load_friction_shoulder"] * np.abs(torque[0])) * sticking[0]
        - p["viscous_shoulder"] * speed[0]
        - p["gravity_shoulder"] * np.sin(angle[0])
        - second_gravity
        + odd * speed[1] * (2.0 * speed[0] + speed[1])
    )
    elbow = (
        torque[1]
        - (p["coulomb_elbow"] + p["load_friction_elbow"] * np.abs(torque[1])) * sticking[1]
        - p["viscous_elbow"] * speed[1]
        - second_gravity
        - odd * speed[0] ** 2
    )
    first = p["inertia_shoulder"] + p["inertia_elbow"] + 2.0 * even
    mixed = p["inertia_elbow"] + even
    second = p["inertia_elbow"] + p["rotor_elbow"]
    both: np.ndarray = np.stack([second * shoulder - mixed * elbow, first * elbow - mixed * shoulder]) / (first * second - mixed**2)
    return both


@dataclass(frozen=True)
class Runs:
    """Runs of one length and row time, simulated side by side: where each begins, and which torque drives it."""

    records: Sequence[Record]
    starts: Sequence[tuple[int, int]]  # number of the record and row
    rows: int
    source: str

    def measured(self) -> np.ndarray:
        """Return (rows, 2, runs) positions [rad]."""
        return np.stack([self.records[number].position[row : row + self.rows] for number, row in self.starts], axis=2)

    def simulate(self, points: np.ndarray, zeros: np.ndarray) -> np.ndarray:
        """Return (rows, 2, sets, runs) positions [rad] for parameters (sets, n) and zeros of position (sets, records, 2)."""
        parameters = dict(zip(NAMES, points.T[:, :, None], strict=True))
        torque = np.empty((self.rows, 2, len(points), len(self.starts)))
        for number, record in enumerate(self.records):
            own = [(run, row) for run, (recorded, row) in enumerate(self.starts) if recorded == number]
            for index, point in enumerate(points):
                whole = record.torque(self.source, point[NAMES.index("delay")])
                whole[:, 1] *= point[NAMES.index("torque_gain_elbow")]
                for run_number, row in own:
                    torque[:, :, index, run_number] = whole[row : row + self.rows]
        offset = np.stack([zeros[:, number] for number, _ in self.starts], axis=2).transpose(1, 0, 2)
        angle = offset + np.stack([self.records[number].position[row] for number, row in self.starts], axis=1)[:, None]
        speed = np.stack([self.records[number].speed[row] for number, row in self.starts], axis=1)[:, None] + np.zeros_like(angle)
        steps = max(1, round(self.records[0].row_s / STEP_s))
        step = self.records[0].row_s / steps
        path = np.empty((self.rows, *angle.shape))
        for row in range(self.rows):
            path[row] = angle - offset
            for _ in range(steps):  # Runge-Kutta 4
                a1 = accelerations(parameters, angle, speed, torque[row])
                speed2 = speed + 0.5 * step * a1
                a2 = accelerations(parameters, angle + 0.5 * step * speed, speed2, torque[row])
                speed3 = speed + 0.5 * step * a2
                a3 = accelerations(parameters, angle + 0.5 * step * speed2, speed3, torque[row])
                speed4 = speed + step * a3
                a4 = accelerations(parameters, angle + step * speed3, speed4, torque[row])
                angle = angle + step / 6.0 * (speed + 2.0 * speed2 + 2.0 * speed3 + speed4)
                speed = speed + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        return path


def free_runs(records: Sequence[Record], source: str, seconds: float = np.inf) -> Runs:
    """Return the free run of each record from its start, cut to the shortest of them."""
    rows = min(len(record.position) for record in records)
    return Runs(records, [(number, 0) for number in range(len(records))], round(min(rows, seconds / records[0].row_s)), source)


def windows(records: Sequence[Record], source: str) -> Runs:
    """Return windows of 1 s side by side, one after the other."""
    rows = round(WINDOW_s / records[0].row_s)
    starts = [(number, row) for number, record in enumerate(records) for row in range(0, len(record.position) - rows, rows)]
    return Runs(records, starts, rows, source)


def fit(runs: Runs, point: np.ndarray, zeros: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit the named parameters, from `point` (n,), and the zeros (records, 2); return both and the cost."""
    measured = runs.measured()
    weight = 1.0 / (measured.std(axis=(0, 2)) * np.sqrt(measured.size))
    free = [NAMES.index(name) for name in names]
    chosen = [PARAMETERS[name] for name in names]
    scale = np.array([parameter.scale for parameter in chosen] + [ZERO_SCALE_rad] * zeros.size)
    low = np.array([parameter.low for parameter in chosen] + [-ZERO_LIMIT_rad] * zeros.size)
    high = np.array([parameter.high for parameter in chosen] + [ZERO_LIMIT_rad] * zeros.size)

    def unpack(trials: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points = np.tile(point, (len(trials), 1))
        points[:, free] = trials[:, : len(free)]
        return points, trials[:, len(free) :].reshape(-1, *zeros.shape)

    def residuals(trials: np.ndarray) -> np.ndarray:
        error = (runs.simulate(*unpack(trials)) - measured[:, :, None]) * weight[:, None, None]
        rows: np.ndarray = error.transpose(2, 0, 1, 3).reshape(len(trials), -1)
        return rows

    inside = 1e-3 * scale
    start = np.clip(np.concatenate([point[free], zeros.ravel()]), low + inside, high - inside)
    found, cost = fit_simulations(residuals, start, scale, bounds=(low / scale, high / scale), ftol=1e-5, xtol=1e-5, max_nfev=30)
    points, all_zeros = unpack(found[None])
    return points[0], all_zeros[0], cost


def errors(runs: Runs, point: np.ndarray, zeros: np.ndarray) -> list[float]:
    """Return the error of shoulder and elbow: of the change of position since each run's start."""
    measured, model = runs.measured(), runs.simulate(point[None], zeros[None])[:, :, 0]
    return [nrmse(model[:, joint] - model[0, joint], measured[:, joint] - measured[0, joint]) for joint in (0, 1)]


def split(held_out: str, train: Sequence[str], rate_Hz: float, seconds: float) -> dict[str, Any]:
    """Fit the training recordings and measure both parts."""
    began = time.perf_counter()
    parts = {"train": [load(name, rate_Hz, seconds) for name in train], "held_out": [load(held_out, rate_Hz, seconds)]}
    none = {part: np.zeros((len(records), 2)) for part, records in parts.items()}
    fits = {}
    for source in ("tau_meas", "tau_con"):
        point, zeros = np.array([parameter.start for parameter in PARAMETERS.values()]), none["train"]
        for horizon in FIRST_SECONDS:
            point, zeros, cost = fit(free_runs(parts["train"], source, horizon), point, zeros, NAMES)
        fits[source] = (cost, point, zeros)
    chosen = min(fits, key=lambda source: fits[source][0])
    _, fitted, fitted_zeros = fits[chosen]

    channels: dict[str, dict[str, dict[str, float]]] = {}
    for stage, source, point in (("nominal", "tau_meas", NOMINAL), ("fitted", chosen, fitted)):
        for part, records in parts.items():
            whole = free_runs(records, source)
            begins = free_runs(records, source, ZERO_SECONDS)
            fitting = stage == "fitted" and part == "train"
            zeros = fitted_zeros if fitting else fit(begins, point, none[part], ())[1]
            found = {
                "": errors(whole, point, none[part]),
                ", zeros fitted": errors(whole, point, zeros),
                ", 1 s windows": errors(windows(records, source), point, none[part]),
            }
            for name, values in found.items():
                for joint, value in zip(("shoulder", "elbow"), values, strict=True):
                    channels.setdefault(joint + name, {}).setdefault(stage, {})[part] = value
            if part == "held_out" and stage == "fitted":
                held_out_zeros = zeros
    return {
        "train": [f"traj_{name}" for name in train],
        "held_out": [f"traj_{held_out}"],
        "metric": f"NRMSE of the change of position since the start, pooled over recordings; rows at {rate_Hz:g} Hz, recorded positions "
        f"interpolated; {'whole recordings' if np.isinf(seconds) else f'first {seconds:g} s'} in one free run from the first measured "
        f"position at rest; torques held over each row at their mean there; zeros of position 0. 'zeros fitted': the same with two zeros "
        f"a recording, from the first {ZERO_SECONDS:g} s (training recordings: from the fit). '1 s windows': one after the other, zeros 0, "
        f"from the measured position and the slope of a quadratic over {SMOOTH_ROWS} rows at {FULL_RATE_Hz:g} Hz",
        "official": False,
        "nominal_is": "the documented masses, inertias and rotors, no friction, measured torques undelayed",
        "torque": f"{chosen} ({', '.join(f'{source} {np.sqrt(2.0 * fits[source][0]):.4f}' for source in fits)} NRMSE in training)",
        "zeros_rad": dict(zip((*train, held_out), np.vstack([fitted_zeros, held_out_zeros]).round(4).tolist(), strict=True)),
        "parameters": {
            name: {"value": float(f"{value:.5g}"), "unit": PARAMETERS[name].unit, "documented": PARAMETERS[name].documented}
            for name, value in zip(NAMES, fitted, strict=True)
        },
        "channels": channels,
        "seconds": round(time.perf_counter() - began, 1),
    }


def splits() -> dict[str, Any]:
    """Return the README's split and, at full rate and length, each of 02, 03 and 04 held out."""
    found = {"readme": split("04", ("00", "05"), README_RATE_Hz, README_SECONDS)}
    for held_out in ("02", "03", "04"):
        train = [name for name in RECORDINGS if name != held_out]
        found[f"full, {held_out} held out"] = split(held_out, train, FULL_RATE_Hz, np.inf)
    return found


if __name__ == "__main__":
    run("dfki_double_pendulum", __doc__, splits)
