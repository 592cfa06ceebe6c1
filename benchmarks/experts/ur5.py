"""Baseline of a robot arm that moves one joint at a time: motor current in, position out, in open loop.

The joint is an inertia behind a harmonic drive, with Coulomb and viscous friction; joints 2 and 3 carry gravity too, the other joints
parked. The torque is the current times 101 x 0.125 Nm/A: currents alone cannot tell a wrong drive constant, so all torques are in this
scale. Joints 2 and 3 have friction in proportion to the torque that the gear transmits as well. A constant torque, and viscous friction
that grows with a power of speed (below 1: lubricants thin), are fitted if so each third of the training part is predicted better from the
other two. The length of the fitted windows is chosen in the same way.

The error is that of position in a free run of the whole part, from its first measured position and recorded speed. Joint 1 can be
followed so. Joints 2 and 3 cannot for more than some seconds: they move about an upright arm, which falls one way or the other. So
windows of 2 s are given, and the current computed from the measured motion (the inverse model). The README's 6 s are too short a
training part for these two joints.

The arm is not a UR5 but a UR10e: files of these names are in S. Mamedov's dynamic_calibration, and gravity is 2.5 and 3.8 times what the
README's masses of a UR5 give. The nominal values are the README's all the same. The documented frictions are Mamedov's, in amperes by his
drive gains of 10.0, 10.7 and 8.46 Nm/A, and so in the scale above.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import data_folder, fit_simulations, nrmse, run
from scipy.signal import savgol_filter

RATE_Hz = 100.0
STEPS_PER_ROW = 4  # of the integrator, 2.5 ms
DRIVE_Nm_A = 101.0 * 0.125
WINDOW_s = 2.0
README_FIT_s, README_HELD_OUT_s = (2.0, 8.0), (40.0, 46.0)
FULL_SHARE = 0.6  # of the whole length is for the fit
HORIZONS_s = {1: (6.0,), 2: (0.5, 1.0, 2.0), 3: (0.5, 1.0, 2.0)}  # of the windows that are fitted: joints 2 and 3 fall in longer ones
OVERLAP = 4  # fitted windows over each row, so that no reversal is near the end of all
LONGEST_SPACING_s = 0.5  # between their starts: long windows overlap more
SMOOTH_ROWS = 15  # rows of the cubic that takes acceleration from the recorded speed for the inverse model: 0.15 s
SLIP_SPEED_rad_s = 0.02  # below it the inverse model's friction fades to none
ITERATIONS = 5  # of the inverse model's friction, which depends on the torque that it adds to: each gains a factor of 20

ROTOR_kg_m2 = 101.0**2 * 2.5e-4
GRAVITY_m_s2 = 9.81
UPPER_ARM_m = 0.425
UPPER_ARM = (8.393, 0.2125)  # kg, m from joint 2
BEYOND_ELBOW = ((2.275, 0.135), (1.219, 0.39225), (1.219, 0.39225 + 0.09465), (0.1879, 0.39225 + 0.09465))  # kg, m from joint 3, in line
MAMEDOV_Nm_A = {1: 10.0, 2: 10.6956, 3: 8.4566}
MAMEDOV_COULOMB_Nm = {1: 12.548, 2: 13.266, 3: 4.994}
MAMEDOV_VISCOUS_Nm_s = {1: 21.256, 2: 20.221, 3: 10.378}


@dataclass(frozen=True)
class Parameter:
    """A number of the model: its unit, where a fit starts, its bounds and the scale of its changes."""

    unit: str
    start: float
    low: float
    high: float
    scale: float


PARAMETERS = {
    "inertia": Parameter("kg m2", 6.0, 0.1, 60.0, 3.0),
    "coulomb": Parameter("Nm", 10.0, 0.0, 60.0, 10.0),
    "viscous": Parameter("Nm (s/rad)^power", 20.0, 0.0, 100.0, 10.0),
    "viscous_power": Parameter("1", 1.0, 0.5, 2.0, 0.3),  # a lower one is Coulomb friction by another name
    "load_friction": Parameter("1", 0.0, -0.5, 0.5, 0.05),  # of the transmitted torque
    "constant": Parameter("Nm", 0.0, -20.0, 20.0, 1.0),
    "gravity": Parameter("Nm", -50.0, -300.0, 0.0, 30.0),  # see `lever`
}
NAMES = list(PARAMETERS)
FREE = ("inertia", "coulomb", "viscous")
CANDIDATES = ((), ("constant",), ("viscous_power",), ("constant", "viscous_power"))
POWER_START = 0.8
FOLDS = 3  # of the training part, for the choice between the candidates


def nominal(joint: int) -> dict[str, float]:
    """Return the README's numbers, without friction."""
    beyond_kg = sum(mass for mass, _ in BEYOND_ELBOW)
    moment = sum(mass * reach for mass, reach in BEYOND_ELBOW)
    second = sum(mass * reach**2 for mass, reach in BEYOND_ELBOW)
    point: dict[str, float] = dict.fromkeys(NAMES, 0.0) | {"viscous_power": 1.0}
    if joint == 1:
        return point | {"inertia": 0.25 + ROTOR_kg_m2}
    if joint == 3:  # the upper arm stands: upright is 0
        return point | {"inertia": second + ROTOR_kg_m2, "gravity": -GRAVITY_m_s2 * moment}
    mass, reach = UPPER_ARM
    stretched = beyond_kg * UPPER_ARM_m**2 + 2.0 * UPPER_ARM_m * moment + second
    gravity = -GRAVITY_m_s2 * (mass * reach + beyond_kg * UPPER_ARM_m + moment)
    return point | {"inertia": mass * reach**2 + stretched + ROTOR_kg_m2, "gravity": gravity}


@dataclass(frozen=True)
class Record:
    """A joint's recording at 100 Hz: position, speed and the mean torque from each row to the next [rad, rad/s, Nm] (rows,)."""

    joint: int
    position: np.ndarray
    speed: np.ndarray
    torque: np.ndarray


def load(joint: int) -> Record:
    """Return a joint's recording, resampled by straight lines between the recorded rows."""
    table = np.loadtxt(data_folder() / "ur5" / f"ur-20_01_22-joint_{joint}.csv", delimiter=",")
    recorded = table[:, 0] - table[0, 0]
    position, speed, current = table[:, joint], table[:, 6 + joint], table[:, 12 + joint]
    times = np.arange(0.0, recorded[-1], 1.0 / RATE_Hz)
    charge = np.concatenate([[0.0], np.cumsum(0.5 * (current[1:] + current[:-1]) * np.diff(recorded))])
    mean = np.diff(np.interp(np.append(times, times[-1] + 1.0 / RATE_Hz), recorded, charge)) * RATE_Hz
    return Record(joint, np.interp(times, recorded, position), np.interp(times, recorded, speed), DRIVE_Nm_A * mean)


def lever(joint: int, angle: np.ndarray) -> np.ndarray:
    """Return the share of its largest torque that gravity has: joint 2 is level at 0, joint 3 upright at 0; the parked arm is straight."""
    return np.asarray(np.cos(angle) if joint == 2 else np.sin(angle))


def friction(parameters: Mapping[str, np.ndarray], speed: np.ndarray, motor: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Return the size [Nm] of the friction of a gear between these torques; it transmits the mean of both."""
    p = parameters
    transmitted = np.abs(0.5 * (motor + load))
    return np.asarray(p["coulomb"] + p["viscous"] * np.abs(speed) ** p["viscous_power"] + p["load_friction"] * transmitted)


def simulate(record: Record, starts: Sequence[int], rows: int, points: np.ndarray) -> np.ndarray:
    """Return (rows, sets, windows) positions [rad] for parameters (sets, n), from the recorded states at the rows `starts`."""
    parameters = dict(zip(NAMES, points.T[:, :, None], strict=True))
    torque = np.stack([record.torque[start : start + rows] for start in starts], axis=1)
    angle = record.position[list(starts)] + np.zeros((len(points), 1))
    speed = record.speed[list(starts)] + np.zeros((len(points), 1))
    step = 1.0 / RATE_Hz / STEPS_PER_ROW
    gain = step / parameters["inertia"]
    path = np.empty((rows, *angle.shape))
    for row in range(rows):
        path[row] = angle
        for _ in range(STEPS_PER_ROW):
            gravity = parameters["gravity"] * lever(record.joint, angle)
            pushed = speed + gain * (torque[row] - gravity - parameters["constant"])
            brake = gain * friction(parameters, speed, torque[row], gravity)
            slowed = np.sign(pushed) * np.maximum(np.abs(pushed) - brake, 0.0)  # friction stops, and never reverses
            angle = angle + 0.5 * step * (speed + slowed)
            speed = slowed
    return path


def measured(record: Record, starts: Sequence[int], rows: int) -> np.ndarray:
    """Return (rows, windows) positions [rad]."""
    return np.stack([record.position[start : start + rows] for start in starts], axis=1)


def fit(record: Record, parts: Sequence[range], extra: Sequence[str], horizon_s: float) -> np.ndarray:
    """Return the parameters (n,) that fit overlapping windows of the parts."""
    rows = min(round(horizon_s * RATE_Hz), *(len(part) for part in parts))
    spacing = min(rows // OVERLAP, round(LONGEST_SPACING_s * RATE_Hz))
    starts = [start for part in parts for start in range(part.start, part.stop - rows + 1, spacing)]
    change = measured(record, starts, rows) - record.position[starts]
    names = [*FREE, *(("load_friction", "gravity") if record.joint > 1 else ()), *extra]
    chosen = [PARAMETERS[name] for name in names]
    free = [NAMES.index(name) for name in names]
    begin = {name: parameter.start for name, parameter in PARAMETERS.items()}
    begin |= {} if "gravity" in names else {"gravity": 0.0}
    begin |= {"viscous_power": POWER_START} if "viscous_power" in names else {}
    point = np.array([begin[name] for name in NAMES])

    def filled(trials: np.ndarray) -> np.ndarray:
        points = np.tile(point, (len(trials), 1))
        points[:, free] = trials
        return points

    def residuals(trials: np.ndarray) -> np.ndarray:
        model = simulate(record, starts, rows, filled(trials))
        error = (model - model[0] - change[:, None]) / (change.std() * np.sqrt(change.size))
        flat: np.ndarray = error.transpose(1, 0, 2).reshape(len(trials), -1)
        return flat

    scale = np.array([parameter.scale for parameter in chosen])
    low, high = (np.array([getattr(parameter, side) for parameter in chosen]) / scale for side in ("low", "high"))
    found, _ = fit_simulations(residuals, point[free], scale, bounds=(low, high), ftol=1e-7, xtol=1e-7, max_nfev=60)
    return np.asarray(filled(found[None])[0])


def position_paths(record: Record, part: range, point: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return changes of position (rows, windows), simulated and measured, in windows one after the other; one window if it is longer."""
    rows = min(round(seconds * RATE_Hz), len(part))
    starts = list(range(part.start, part.stop - rows + 1, rows))
    model, real = simulate(record, starts, rows, point[None])[:, 0], measured(record, starts, rows)
    return model - model[0], real - real[0]


def position_error(record: Record, part: range, point: np.ndarray, seconds: float) -> float:
    """Return the error of the change of position in such windows."""
    return nrmse(*position_paths(record, part, point, seconds))


def current_error(record: Record, part: range, point: np.ndarray) -> float:
    """Return the error of the current that the measured motion asks for."""
    parameters = {name: np.array(value) for name, value in zip(NAMES, point, strict=True)}
    speed = savgol_filter(record.speed, SMOOTH_ROWS, 3)
    acceleration = savgol_filter(record.speed, SMOOTH_ROWS, 3, deriv=1, delta=1.0 / RATE_Hz)
    gravity = parameters["gravity"] * lever(record.joint, record.position)
    wanted = parameters["inertia"] * acceleration + gravity + parameters["constant"]
    motor = wanted
    for _ in range(ITERATIONS):
        motor = wanted + np.tanh(speed / SLIP_SPEED_rad_s) * friction(parameters, speed, motor, gravity)
    rows = slice(part.start, part.stop)
    return nrmse([motor[rows]], [record.torque[rows]])


def choose(record: Record, part: range) -> tuple[tuple[str, ...], float]:
    """Return what is fitted besides, and in windows of what length: what predicts each third of a part best when fitted to the others."""
    edges = [part.start + round(third * len(part) / FOLDS) for third in range(FOLDS + 1)]
    thirds = [range(*pair) for pair in itertools.pairwise(edges)]
    horizons = HORIZONS_s[record.joint]

    def error(candidate: tuple[tuple[str, ...], float]) -> float:
        pairs = []
        for left_out in thirds:
            point = fit(record, [third for third in thirds if third is not left_out], *candidate)
            pairs.append(position_paths(record, left_out, point, max(horizons)))
        return nrmse([model for model, _ in pairs], [real for _, real in pairs])

    return min(itertools.product(CANDIDATES, horizons), key=error)


def split(record: Record, train: range, held_out: range) -> dict[str, Any]:
    """Fit the training part and measure both."""
    began = time.perf_counter()
    joint = record.joint
    extra, horizon_s = choose(record, train)
    points = {"nominal": np.array([nominal(joint)[name] for name in NAMES]), "fitted": fit(record, [train], extra, horizon_s)}
    parts = {"train": train, "held_out": held_out}
    scale = DRIVE_Nm_A / MAMEDOV_Nm_A[joint]
    documented = {"coulomb": MAMEDOV_COULOMB_Nm[joint] * scale, "viscous": MAMEDOV_VISCOUS_Nm_s[joint] * scale}
    horizons = {"position": len(record.position) / RATE_Hz, "position, 2 s windows": WINDOW_s}
    return {
        "train": [f"joint {joint}, {train.start / RATE_Hz:g} to {train.stop / RATE_Hz:g} s"],
        "held_out": [f"joint {joint}, {held_out.start / RATE_Hz:g} to {held_out.stop / RATE_Hz:g} s"],
        "metric": f"NRMSE of the change of position since the start; rows at {RATE_Hz:g} Hz, recorded values interpolated; one free run of "
        "the whole part from the first measured position and recorded speed; the measured current, held over each row at its mean there, "
        f"times {DRIVE_Nm_A:g} Nm/A; 'windows': the same in windows of {WINDOW_s:g} s one after the other",
        "official": False,
        "nominal_is": "the README's masses, lengths, rotor and drive constant (a UR5's; the arm is a UR10e), no friction",
        "fitted_besides": list(extra),
        "fitted_window_s": horizon_s,
        "parameters": {
            name: {
                "value": float(f"{value:.5g}"),
                "unit": PARAMETERS[name].unit,
                "documented": round(documented[name], 2) if name in documented else None,
            }
            for name, value in zip(NAMES, points["fitted"], strict=True)
        },
        "channels": {
            channel: {
                stage: {name: position_error(record, part, point, seconds) for name, part in parts.items()}
                for stage, point in points.items()
            }
            for channel, seconds in horizons.items()
        },
        "other_metrics": {
            "current from measured motion": {
                stage: {name: current_error(record, part, point) for name, part in parts.items()} for stage, point in points.items()
            }
        },
        "seconds": round(time.perf_counter() - began, 1),
    }


def splits() -> dict[str, Any]:
    """Return, for each joint, the README's parts and the whole length."""
    found: dict[str, Any] = {}
    for joint in (1, 2, 3):
        record = load(joint)
        fitted, held_out = (range(*(round(second * RATE_Hz) for second in span)) for span in (README_FIT_s, README_HELD_OUT_s))
        found[f"joint {joint}, readme"] = split(record, fitted, held_out)
        rows = len(record.position)
        found[f"joint {joint}, full"] = split(record, range(round(FULL_SHARE * rows)), range(round(FULL_SHARE * rows), rows))
    return found


if __name__ == "__main__":
    run("ur5", __doc__, splits)
