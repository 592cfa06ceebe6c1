"""Baseline of a Dynamixel XL330 servo that swings 0.49 kg at 0.1 m, in the position loop of its firmware.

The drive's duty is kp · 4096 / (2 pi) / (256 · 885) · (goal - position), at most 1; the recorded load is 885 times the duty. Its voltage
makes the motor's torque, less the back-EMF. The model is a point mass on a massless rod with Coulomb, viscous and load-dependent friction
and their Stribeck excess, a tilt, a constant torque and a delay of the goal. Load-dependent friction is a share of the motor's torque
less another share of gravity's, as the servo's authors (Rhoban's BAM) have it. At last the supply has a resistance, through which the
motor's current flows while the bridge is on, so that torque falls behind duty. The recorded voltage is too rough to measure it (it reads 6
to 8 V in turn at a high duty), but without it a fit to gain 100 is more than twice as wrong at gain 200, and the other way round.

Whether the Stribeck excess is fitted whole, without its two shares or not at all, and whether the motor's constants are fitted too or
left at the README's set, is chosen: the choice predicts each half of the training recordings best from the other (the README's split: each
recording; the other one: each gain). `fitted` is that choice; the best one with the constants fitted or left, whichever it is not, is
given as well.

The error is that of position and command (load) in a free run of the closed loop, from the recorded goal. In lift_and_drop the motor is
switched off at 2 s, and turns freely from there: this part is a channel of its own.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import data_folder, fit_simulations, nrmse, run

RATE_Hz = 200.0
STEPS_PER_ROW = 4  # of the integrator, 1.25 ms, about the period of the firmware
FIRST_ROWS = 3  # whose mean is the first position: it rests, but the encoder's step is 0.0015 rad
DUTY_PER_RAD = 4096.0 / (2.0 * np.pi) / (256.0 * 885.0)  # for a gain of 1
FULL_LOAD = 885.0
SUPPLY_V = 7.4
GRAVITY_Nm = 0.49 * 9.81 * 0.1
INERTIA_kg_m2 = 0.49 * 0.1**2
SIGNED = 2**15  # of the 16 bits that load is recorded in

MOTORS = {
    "m6": {"torque_per_volt": 0.124178, "back_emf": 0.037702, "armature": 0.0020566},
    "m1": {"torque_per_volt": 0.06785, "back_emf": 0.0219, "armature": 0.00164},
}


@dataclass(frozen=True)
class Parameter:
    """A number of the model: its unit, its bounds, the scale of its changes and the documented value."""

    unit: str
    low: float
    high: float
    scale: float
    documented: float | None = None


PARAMETERS = {
    "torque_per_volt": Parameter("Nm/V", 0.02, 0.4, 0.3),
    "back_emf": Parameter("Nm s/rad", 0.002, 0.2, 0.1),
    "armature": Parameter("kg m2", 1e-4, 0.01, 0.01),
    "coulomb": Parameter("Nm", 0.0, 0.3, 0.1),
    "viscous": Parameter("Nm s/rad", 0.0, 0.1, 0.05),
    "load_friction_motor": Parameter("1", 0.0, 0.8, 1.0, 0.27),  # of the motor's torque
    "load_friction_gravity": Parameter("1", 0.0, 0.8, 1.0),
    "stribeck": Parameter("Nm", 0.0, 0.3, 0.2),  # the excess at rest, and of the two shares
    "stribeck_motor": Parameter("1", 0.0, 0.8, 1.0),
    "stribeck_gravity": Parameter("1", 0.0, 0.8, 1.0),
    "stribeck_speed": Parameter("rad/s", 0.05, 3.0, 3.0),
    "tilt": Parameter("rad", -0.2, 0.2, 0.2),  # of the vertical from the encoder's zero
    "constant": Parameter("Nm", -0.1, 0.1, 0.2),
    "delay": Parameter("s", -0.01, 0.02, 0.02),
    "supply_resistance": Parameter("1", 0.0, 2.0, 0.5),  # over the motor's resistance
}  # scales are such that a ten-thousandth of them is beyond the grain of sticking and slipping, in which the error moves in steps
NAMES = list(PARAMETERS)
CONSTANTS = ("torque_per_volt", "back_emf", "armature")
EXCESSES = {  # parameters that are left at 0
    "whole Stribeck excess": (),
    "Stribeck excess without shares": ("stribeck_motor", "stribeck_gravity"),
    "no Stribeck excess": ("stribeck", "stribeck_motor", "stribeck_gravity", "stribeck_speed"),
}
STRIBECK_POWER = 1.8  # of speed, in the exponent: the documented one
NOMINAL = dict.fromkeys(NAMES, 0.0) | {"stribeck_speed": 1.0}
STARTS = (  # the first is near the documented friction, the second has less load-dependent and more Stribeck friction
    {
        "coulomb": 0.006,
        "viscous": 0.008,
        "load_friction_motor": 0.28,
        "load_friction_gravity": 0.11,
        "stribeck": 0.002,
        "stribeck_motor": 0.09,
        "stribeck_gravity": 0.03,
        "stribeck_speed": 0.5,
        "tilt": 0.01,
        "delay": 0.002,
        "supply_resistance": 0.5,
    },
    {
        "coulomb": 0.015,
        "viscous": 0.008,
        "load_friction_motor": 0.15,
        "load_friction_gravity": 0.15,
        "stribeck": 0.01,
        "stribeck_motor": 0.2,
        "stribeck_gravity": 0.01,
        "stribeck_speed": 0.8,
        "tilt": 0.01,
        "delay": 0.002,
        "supply_resistance": 0.3,
    },
)


@dataclass(frozen=True)
class Record:
    """A recording at 200 Hz: position [rad], load and whether the motor is on (rows,); the goal on the recorded times."""

    trajectory: str
    kp: float
    times: np.ndarray
    position: np.ndarray
    load: np.ndarray
    on: np.ndarray
    recorded_s: np.ndarray
    goal: np.ndarray

    def goal_at(self, delay: float) -> np.ndarray:
        """Return the goal (rows,) [rad], delayed [s]."""
        return np.asarray(np.interp(self.times - delay, self.recorded_s, self.goal))


def load_all() -> dict[tuple[str, int], Record]:
    """Return the recordings by trajectory and gain, resampled by straight lines between the recorded rows."""
    found = {}
    for path in sorted((data_folder() / "bam_xl330").glob("*.json")):
        content = json.loads(path.read_text())
        columns = {key: np.array([entry[key] for entry in content["entries"]], dtype=float) for key in content["entries"][0]}
        load = np.where(columns["load"] >= SIGNED, columns["load"] - 2 * SIGNED, columns["load"])
        recorded = columns["timestamp"]
        times = np.arange(recorded[0], recorded[-1], 1.0 / RATE_Hz)
        position, load, on = (np.interp(times, recorded, column) for column in (columns["position"], load, columns["torque_enable"]))
        key = (content["trajectory"], content["kp"])
        found[key] = Record(*key, times, position, load, on > 0.5, recorded, columns["goal_position"])
    return found


def padded(values: np.ndarray, rows: int) -> np.ndarray:
    """Return values (rows,), the last one repeated."""
    return np.append(values, np.full(rows - len(values), values[-1]))


def friction(parameters: Mapping[str, np.ndarray], speed: np.ndarray, motor: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Return the size [Nm] of the friction between the motor's torque and gravity's."""
    p = parameters
    moving = p["coulomb"] + np.abs(p["load_friction_motor"] * motor - p["load_friction_gravity"] * gravity)
    excess = p["stribeck"] + np.abs(p["stribeck_motor"] * motor - p["stribeck_gravity"] * gravity)
    return np.asarray(moving + excess * np.exp(-((np.abs(speed) / p["stribeck_speed"]) ** STRIBECK_POWER)) + p["viscous"] * np.abs(speed))


def simulate(records: Sequence[Record], points: np.ndarray) -> np.ndarray:
    """Return (2, rows, sets, records) position [rad] and load for parameters (sets, n); shorter recordings are padded."""
    parameters = dict(zip(NAMES, points.T[:, :, None], strict=True))
    p = parameters
    rows = max(len(record.times) for record in records)
    goals = np.array([[padded(record.goal_at(delay), rows) for record in records] for delay in p["delay"][:, 0]]).transpose(2, 0, 1)
    goals = np.concatenate([goals, goals[-1:]])
    switches = np.stack([padded(record.on.astype(float), rows) for record in records], axis=1)
    duty_per_rad = DUTY_PER_RAD * np.array([record.kp for record in records])
    angle = np.array([record.position[:FIRST_ROWS].mean() for record in records]) + np.zeros((len(points), 1))
    speed = np.zeros_like(angle)  # it has rested at the first goal for a second
    step = 1.0 / RATE_Hz / STEPS_PER_ROW
    gain = step / (INERTIA_kg_m2 + p["armature"])
    paths = np.empty((2, rows, *angle.shape))
    for row in range(rows):
        on = switches[row]
        paths[0, row] = angle
        paths[1, row] = FULL_LOAD * on * np.clip(duty_per_rad * (goals[row] - angle), -1.0, 1.0)
        for part in range(STEPS_PER_ROW):
            goal = goals[row] + (part + 0.5) / STEPS_PER_ROW * (goals[row + 1] - goals[row])
            duty = on * np.clip(duty_per_rad * (goal - angle), -1.0, 1.0)
            # while the bridge is on, the motor's current flows through the supply too: as a mean, duty times its resistance is added
            motor = on * (p["torque_per_volt"] * SUPPLY_V * duty - p["back_emf"] * speed) / (1.0 + p["supply_resistance"] * np.abs(duty))
            gravity = -GRAVITY_Nm * np.sin(angle + p["tilt"])
            pushed = speed + gain * (motor + gravity - p["constant"])
            brake = gain * friction(p, speed, motor, gravity)
            slowed = np.sign(pushed) * np.maximum(np.abs(pushed) - brake, 0.0)  # friction stops, and never reverses
            angle = angle + 0.5 * step * (speed + slowed)
            speed = slowed
    return paths


@dataclass(frozen=True)
class Choice:
    """What is fitted: the motor's constants or not, and which part of the Stribeck excess."""

    constants: bool
    excess: str

    def names(self) -> list[str]:
        """Return the names of the fitted parameters."""
        left = EXCESSES[self.excess] if self.constants else (*EXCESSES[self.excess], *CONSTANTS)
        return [name for name in NAMES if name not in left]


CHOICES = [Choice(constants, excess) for constants in (False, True) for excess in EXCESSES]


def fit(records: Sequence[Record], begin: Mapping[str, float], names: Sequence[str]) -> tuple[dict[str, float], float]:
    """Return the parameters that fit the recordings, from `begin`, and their cost: position and command count alike."""
    rows = max(len(record.times) for record in records)
    measured = np.stack(
        [
            np.stack([padded(values, rows) for values in channel], axis=1)
            for channel in zip(*((r.position, r.load) for r in records), strict=True)
        ]
    )
    there = np.stack([np.arange(rows) < len(record.times) for record in records], axis=1)
    weight = there / measured[:, there].std(axis=1)[:, None, None] / np.sqrt(2.0 * there.sum())
    scale = np.array([PARAMETERS[name].scale for name in names])
    low, high = (np.array([getattr(PARAMETERS[name], side) for name in names]) / scale for side in ("low", "high"))

    def filled(trials: np.ndarray) -> np.ndarray:
        points = np.tile([begin[name] for name in NAMES], (len(trials), 1))
        points[:, [NAMES.index(name) for name in names]] = trials
        return points

    def residuals(trials: np.ndarray) -> np.ndarray:
        error = (simulate(records, filled(trials)) - measured[:, :, None]) * weight[:, :, None]
        flat: np.ndarray = error.transpose(2, 0, 1, 3).reshape(len(trials), -1)
        return flat

    inside = np.clip([begin[name] for name in names], (low + 1e-4) * scale, (high - 1e-4) * scale)
    options: dict[str, Any] = {"x_scale": "jac", "ftol": 1e-4, "xtol": 1e-4, "max_nfev": 40}
    found, cost = fit_simulations(residuals, inside, scale, bounds=(low, high), **options)
    return dict(zip(NAMES, filled(found[None])[0].tolist(), strict=True)), cost


def best_fit(records: Sequence[Record], motor: str, choice: Choice, starts: int = len(STARTS)) -> dict[str, float]:
    """Return the best fit from the first `starts` starts; from more than one, fitted again: sticking can end a fit early."""
    unused = {name: NOMINAL[name] for name in EXCESSES[choice.excess]}
    fits = [fit(records, NOMINAL | MOTORS[motor] | start | unused, choice.names()) for start in STARTS[:starts]]
    best = min(fits, key=lambda pair: pair[1])[0]
    return best if starts == 1 else fit(records, best, choice.names())[0]


def errors(records: Sequence[Record], parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the error of every channel, pooled over recordings."""
    paths = simulate(records, np.array([[parameters[name] for name in NAMES]]))[:, :, 0]
    position = [(paths[0, : len(record.times), index], record.position, record.on) for index, record in enumerate(records)]
    command = [(paths[1, : len(record.times), index], record.load, record.on) for index, record in enumerate(records)]

    def pooled(columns: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], on: bool) -> float:
        return nrmse([model[switch == on] for model, _, switch in columns], [real[switch == on] for _, real, switch in columns])

    found = {"position": pooled(position, True), "command": pooled(command, True)}
    if not all(record.on.all() for record in records):
        found["position, motor off"] = pooled(position, False)
    return found


def prediction_error(halves: Sequence[Sequence[Record]], motor: str, choice: Choice) -> float:
    """Return the error of position and command in each half when fitted to the other."""
    found = [errors(other, best_fit(one, motor, choice, starts=1)) for one, other in (halves, halves[::-1])]
    return float(np.sqrt(np.mean([half[channel] ** 2 for half in found for channel in ("position", "command")])))


def split(halves: Sequence[Sequence[Record]], held_out: Sequence[Record], motor: str) -> dict[str, Any]:
    """Fit the training recordings, two halves, with a set of motor constants and measure both parts."""
    began = time.perf_counter()
    train = [record for half in halves for record in half]
    predictions = {choice: prediction_error(halves, motor, choice) for choice in CHOICES}
    chosen = min(CHOICES, key=predictions.__getitem__)
    beside = min((choice for choice in CHOICES if choice.constants != chosen.constants), key=predictions.__getitem__)
    fitted = best_fit(train, motor, chosen)
    other_stage = "fitted_with_constants" if beside.constants else "fitted_constants_held"
    stages = {"nominal": NOMINAL | MOTORS[motor], "fitted": fitted, other_stage: best_fit(train, motor, beside)}
    channels: dict[str, dict[str, dict[str, float]]] = {}
    for stage, parameters in stages.items():
        for part, records in (("train", train), ("held_out", held_out)):
            for channel, error in errors(records, parameters).items():
                channels.setdefault(channel, {}).setdefault(stage, {})[part] = error
    documented = {name: parameter.documented for name, parameter in PARAMETERS.items()} | MOTORS[motor]
    return {
        "train": [f"{record.trajectory} kp {record.kp:g}" for record in train],
        "held_out": [f"{record.trajectory} kp {record.kp:g}" for record in held_out],
        "metric": f"NRMSE pooled over recordings while the motor is on; rows at {RATE_Hz:g} Hz from the first recorded time, recorded "
        f"values interpolated; each in one free run of the closed loop, from rest at the mean of the first {FIRST_ROWS} measured "
        f"positions; driven by the recorded goal, by straight lines, and the recorded switching of the motor; the P law acts every "
        f"{1e3 / RATE_Hz / STEPS_PER_ROW:g} ms. 'motor off': lift_and_drop from where the motor is switched off, in the same run",
        "official": False,
        "nominal_is": f"the README's motor constants of {motor}, point mass on a massless rod, no friction, ideal supply of {SUPPLY_V:g} V",
        "chosen": f"{'constants fitted' if chosen.constants else 'constants held'}, {chosen.excess}",
        "beside": f"{'constants fitted' if beside.constants else 'constants held'}, {beside.excess}",
        "parameters": {
            name: {"value": float(f"{fitted[name]:.5g}"), "unit": parameter.unit, "documented": documented[name]}
            for name, parameter in PARAMETERS.items()
        },
        "parameters_beside": {name: float(f"{value:.5g}") for name, value in stages[other_stage].items()},
        "channels": channels,
        "seconds": round(time.perf_counter() - began, 1),
    }


def splits() -> dict[str, Any]:
    """Return the README's split and the one by gains, each from both sets of motor constants."""
    records = load_all()
    found: dict[str, Any] = {}
    for motor in MOTORS:
        halves = [[records["sin_time_square", 400]], [records["sin_sin", 200]]]
        held_out = [records["sin_sin", 400], records["up_and_down", 200]]
        found[f"readme {motor}"] = split(halves, held_out, motor)
    for motor in MOTORS:
        halves = [[record for (_, kp), record in records.items() if kp == gain] for gain in (100, 200)]
        held_out = [record for (_, kp), record in records.items() if kp in (400, 800)]
        found[f"gains {motor}"] = split(halves, held_out, motor)
    return found


if __name__ == "__main__":
    run("bam_xl330", __doc__, splits)
