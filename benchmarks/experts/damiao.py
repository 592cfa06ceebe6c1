"""Baseline of four quasi-direct-drive servos without load, in speed control by their own drives.

The drive's law is torque = kd (speed command - speed). The commands are ramps and constant speeds of both signs. The model is an
inertia with Coulomb and viscous friction under that law. Fitted for each motor, on two of its three runs: kd, inertia, both frictions, a
constant load, the offset of the torque reading, the delay of commands and the time constant of the torque reading; for motor 3 the speed
at which its drive clips the command too. The stage `with_static` adds static friction that falls to Coulomb friction with speed: it
matters to motor 1 only, whose torque at the start of a motion differs from one start to the next.

The error is that of torque and speed in a free run of the closed loop through the whole speed phase, from the commands alone. Torques
from the measured motion, by the same friction (the inverse model), are given as well.

Speeds are in the recording's unit. The position moves by 0.995, 1.99, 1.66 and 1.66 rad per recorded radian (motors 1, 3, 5, 6): for
motors 3, 5 and 6 speeds and speed commands are not what they are named, but all in one ratio. So kd is that ratio times the
configured one, and inertia and viscous friction are in the same unit.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import data_folder, nrmse, run
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

MOTORS = (1, 3, 5, 6)
RUNS = (1, 2, 3)
STEPS_PER_ROW = 6  # of the integrator, 3.5 ms: steps of an eighth of that change the errors by less than 1e-4
DIFFERENCE = 0.02  # of a parameter's scale, for slopes: steps over the grid of sticking and slipping
POSITION_TURN_rad = 25.0  # the position wraps from 12.5 to -12.5
MOVING_rad_s = 0.3  # speeds above it compare the positions' slope with the speeds'
STILL_rad_s = 0.1  # the inverse model leaves out slower rows: at rest friction takes any torque, which the motion does not tell
SMOOTH_ROWS = 21  # rows of the cubic that gives speed and acceleration to the inverse model: 0.4 s of ramps of 2 rad/s²


@dataclass(frozen=True)
class Parameter:
    """A number of the model: its unit, its bounds and the scale of its changes."""

    unit: str
    low: float
    high: float
    scale: float


PARAMETERS = {
    "kd": Parameter("Nm s/rad", 0.05, 5.0, 0.1),
    "inertia": Parameter("kg m2", 1e-4, 0.2, 0.005),
    "coulomb": Parameter("Nm", 0.0, 2.0, 0.05),
    "viscous": Parameter("Nm s/rad", 0.0, 0.5, 0.01),
    "load": Parameter("Nm", -0.3, 0.3, 0.02),
    "torque_offset": Parameter("Nm", -0.3, 0.3, 0.02),
    "delay": Parameter("s", -0.03, 0.08, 0.005),
    "torque_lag": Parameter("s", 5e-4, 0.1, 0.005),
    "clipped_speed": Parameter("rad/s", 4.0, 20.0, 0.3),
    "static_excess": Parameter("Nm", 0.0, 1.0, 0.1),  # static less Coulomb friction
    "static_speed": Parameter("rad/s", 0.02, 3.0, 0.2),  # over which the excess vanishes (Stribeck)
}
NAMES = list(PARAMETERS)
SCALES = np.array([parameter.scale for parameter in PARAMETERS.values()])
LOW = np.array([parameter.low for parameter in PARAMETERS.values()])
HIGH = np.array([parameter.high for parameter in PARAMETERS.values()])
STATIC = ("static_excess", "static_speed")
STATIC_STARTS = ((0.2, 0.2), (0.6, 0.3))  # static friction's excess in parts of Coulomb friction, and its speed [rad/s]
ALWAYS = tuple(name for name in NAMES if name not in (*STATIC, "clipped_speed"))


@dataclass(frozen=True)
class Motor:
    """What is known of a motor beforehand."""

    configured_kd: float
    documented: dict[str, float]
    scan_limit_Nm: float  # at which the ramps of torque end if nothing moves
    noise: tuple[float, float]  # of torque [Nm] and speed [rad/s], rounded residuals: the weights of the two channels
    guess_kd: float  # torque over speed error in the constant speeds
    guess_clip: float


UNCLIPPED = 20.0  # above all commands
KNOWN = {
    1: Motor(1.0, {"coulomb": 0.31, "viscous": 0.087, "inertia": 0.0227}, 0.8, (0.05, 0.05), 1.0, UNCLIPPED),
    3: Motor(0.8, {"coulomb": 0.45, "viscous": 0.109, "inertia": 0.0566, "kd": 1.49, "clipped_speed": 6.3}, 0.6, (0.2, 0.06), 1.6, 6.3),
    5: Motor(0.6, {"coulomb": 0.10, "viscous": 0.006, "inertia": 0.0011}, 0.4, (0.025, 0.035), 1.0, UNCLIPPED),
    6: Motor(0.6, {"coulomb": 0.12, "viscous": 0.007, "inertia": 0.0017}, 0.4, (0.025, 0.035), 1.0, UNCLIPPED),
}


@dataclass(frozen=True)
class Recording:
    """The rows of a run in speed control, and the largest torques that its ramps before reached."""

    time_s: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    torque: np.ndarray
    command: np.ndarray
    breakaway_Nm: tuple[float, float]  # where the ramps ended, upwards and downwards


def read(motor: int, number: int) -> Recording:
    """Return one run of a motor."""
    path = data_folder() / "damiao" / f"motor{motor}_run{number}.csv.gz"
    seconds, position, speed, torque, command_torque, command_speed, in_torque, _ = np.genfromtxt(path, delimiter=",", skip_header=1).T
    rows = slice(int(np.argmax(in_torque == 0)), None)
    breakaway = (float(command_torque.max()), float(-command_torque.min()))
    return Recording(seconds[rows], position[rows], speed[rows], torque[rows], command_speed[rows], breakaway)


def simulate(parameters: np.ndarray, recordings: Sequence[Recording]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return torque readings and speeds (rows, sets) of each run, for many sets of parameters (names, sets) side by side.

    The speed starts as recorded. Commands are interpolated between rows. The speed takes implicit steps of Euler, which solve sticking
    and slipping exactly: the impulse of all other torques less that of friction, or rest.
    """
    kd, J, coulomb, viscous, load, offset, delay, lag, clip, excess, stribeck = parameters
    sets, runs, longest = parameters.shape[1], len(recordings), max(len(one.time_s) for one in recordings)
    steps = np.full((longest - 1, runs, 1), 1e-3)  # rows beyond the end of a shorter run count nowhere
    command = np.zeros((longest - 1, STEPS_PER_ROW, runs, sets))
    for i, one in enumerate(recordings):
        period = np.diff(one.time_s)
        steps[: len(period), i, 0] = period / STEPS_PER_ROW
        at = one.time_s[:-1, None] + period[:, None] * np.arange(1, STEPS_PER_ROW + 1) / STEPS_PER_ROW
        command[: len(period), :, i] = np.interp(at[:, :, None] - delay, one.time_s, one.command)
    command = np.clip(command, -clip, clip)

    speed = np.stack([np.full(sets, one.speed[0]) for one in recordings])
    reading = np.stack([one.torque[0] - offset for one in recordings])
    speeds, readings = [speed], [reading]
    for row in range(longest - 1):
        impulse = steps[row] / J
        slowing = 1 / (1 + impulse * (kd + viscous))
        followed = 1 - np.exp(-steps[row] / lag)
        for wanted in command[row]:
            friction = impulse * (coulomb + excess * np.exp(-((speed / stribeck) ** 2)))
            driven = speed + impulse * (kd * wanted - load)
            speed = np.sign(driven) * np.maximum(np.abs(driven) - friction, 0.0) * slowing
            reading = reading + followed * (kd * (wanted - speed) - reading)
        speeds.append(speed)
        readings.append(reading)
    torque, turned = np.stack(readings) + offset, np.stack(speeds)
    return [(torque[: len(one.time_s), i], turned[: len(one.time_s), i]) for i, one in enumerate(recordings)]


def fit(recordings: Sequence[Recording], guess: np.ndarray, names: Sequence[str], noise: tuple[float, float]) -> tuple[np.ndarray, float]:
    """Return all parameters, those of `names` fitted to torque and speed, and half the sum of squares."""
    free = [NAMES.index(name) for name in names]

    def residuals(scaled: np.ndarray, differences: float) -> np.ndarray:
        sets = np.repeat(guess[:, None], len(free) + 1, axis=1)
        sets[free] = (scaled * SCALES[free])[:, None]
        sets[free, np.arange(1, len(free) + 1)] += differences * SCALES[free]
        if differences == 0.0:
            sets = sets[:, :1]
        parts = []
        for (torque, speed), one in zip(simulate(sets, recordings), recordings, strict=True):
            parts += [(torque - one.torque[:, None]) / noise[0], (speed - one.speed[:, None]) / noise[1]]
        return np.concatenate(parts)

    def slopes(scaled: np.ndarray) -> np.ndarray:
        found = residuals(scaled, DIFFERENCE)
        return np.asarray((found[:, 1:] - found[:, :1]) / DIFFERENCE)

    bounds = (LOW[free] / SCALES[free], HIGH[free] / SCALES[free])
    start = np.clip(guess[free] / SCALES[free], bounds[0] + DIFFERENCE, bounds[1] - DIFFERENCE)
    found = least_squares(lambda scaled: residuals(scaled, 0.0)[:, 0], start, jac=slopes, bounds=bounds, xtol=1e-5, max_nfev=40)
    parameters = guess.copy()
    parameters[free] = found.x * SCALES[free]
    return parameters, float(found.cost)


def stage(**values: float) -> np.ndarray:
    """Return parameters of the given values; without friction, load, offset and delay where not given."""
    neutral = {"kd": 1.0, "inertia": 0.01, "torque_lag": PARAMETERS["torque_lag"].low, "clipped_speed": UNCLIPPED, "static_speed": 0.2}
    return np.array([{**neutral, **values}.get(name, 0.0) for name in NAMES])


def fit_stages(motor: int, recordings: Sequence[Recording]) -> dict[str, np.ndarray]:
    """Return the parameters of all stages for one motor, fitted to `recordings`."""
    known = KNOWN[motor]
    nominal = {"kd": known.configured_kd, "inertia": known.documented["inertia"]}
    guess = {
        **known.documented,
        "kd": known.guess_kd,
        "clipped_speed": known.guess_clip,
        "torque_offset": float(np.mean(np.concatenate([one.torque for one in recordings]))),
        "delay": 0.02,  # one row
        "torque_lag": 0.01,
    }
    names = (*ALWAYS, "clipped_speed") if known.guess_clip < UNCLIPPED else ALWAYS
    fitted, _ = fit(recordings, stage(**guess), names, known.noise)
    starts = [changed(fitted, static_excess=part * fitted[NAMES.index("coulomb")], static_speed=speed) for part, speed in STATIC_STARTS]
    with_static = min((fit(recordings, start, (*names, *STATIC), known.noise) for start in starts), key=lambda found: found[1])[0]
    return {
        "nominal": stage(**nominal),
        "documented": stage(**{**nominal, **known.documented}),
        "fitted": fitted,
        "with_static": with_static,
    }


def changed(parameters: np.ndarray, **values: float) -> np.ndarray:
    """Return the parameters with some changed."""
    other = parameters.copy()
    for name, value in values.items():
        other[NAMES.index(name)] = value
    return other


def errors(parameters: np.ndarray, recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the NRMSE of torque and speed in the closed loop, pooled over the runs."""
    found = simulate(parameters[:, None], recordings)
    return (
        nrmse([torque for torque, _ in found], [one.torque[:, None] for one in recordings]),
        nrmse([speed for _, speed in found], [one.speed[:, None] for one in recordings]),
    )


def inverse_rows(one: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return what inertia, Coulomb friction, viscous friction and an offset are multiplied by (rows, 4), and the torques, in motion."""
    period = float(np.median(np.diff(one.time_s)))
    even = np.arange(one.time_s[0], one.time_s[-1], period)
    of_speed = np.interp(even, one.time_s, one.speed)
    smooth, rate = (savgol_filter(of_speed, SMOOTH_ROWS, 3, deriv=order, delta=period) for order in (0, 1))
    speed, acceleration = np.interp(one.time_s, even, smooth), np.interp(one.time_s, even, rate)
    moving = np.abs(speed) > STILL_rad_s
    return np.stack([acceleration, np.sign(speed), speed, np.ones_like(speed)], axis=1)[moving], one.torque[moving]


def inverse_errors(train: Sequence[Recording], held_out: Sequence[Recording]) -> dict[str, float]:
    """Return the NRMSE of torque by the inverse model in both parts."""
    parts = {name: [inverse_rows(one) for one in part] for name, part in (("train", train), ("held_out", held_out))}
    terms, torques = (np.concatenate([rows[i] for rows in parts["train"]]) for i in (0, 1))
    found = np.linalg.lstsq(terms, torques)[0]
    return {name: round(nrmse([rows @ found for rows, _ in part], [torque for _, torque in part]), 4) for name, part in parts.items()}


def position_ratio(recordings: Sequence[Recording]) -> float:
    """Return how far the position moves per recorded radian: the median over all rows in motion."""
    ratios = []
    for one in recordings:
        moved = np.diff(one.position)
        moved = (moved + POSITION_TURN_rad / 2) % POSITION_TURN_rad - POSITION_TURN_rad / 2
        mean = (one.speed[1:] + one.speed[:-1]) / 2
        usable = np.abs(mean) > MOVING_rad_s
        ratios.append((moved / np.diff(one.time_s))[usable] / mean[usable])
    return float(np.median(np.concatenate(ratios)))


def entry(value: float, unit: str, documented: float | None) -> dict[str, Any]:
    """Return a parameter for the result file."""
    return {"value": float(f"{value:.4g}"), "unit": unit, "documented": documented}


def named(motor: int, stages: dict[str, np.ndarray], recordings: Sequence[Recording]) -> dict[str, Any]:
    """Return what was fitted for one motor, with units and documented values."""
    known = KNOWN[motor]
    documented = {"kd": known.configured_kd, **known.documented}
    names = (*ALWAYS, "clipped_speed") if known.guess_clip < UNCLIPPED else ALWAYS
    found = {name: entry(stages["fitted"][NAMES.index(name)], PARAMETERS[name].unit, documented.get(name)) for name in names}
    ramps = np.mean([one.breakaway_Nm for one in recordings])
    found["static_in_ramps"] = entry(float(ramps), "Nm", None)
    found["position_ratio"] = entry(position_ratio(recordings), "rad/rad", None)
    return {f"motor_{motor}_{name}": value for name, value in found.items()}


METRIC = (
    "NRMSE of torque and speed in a free run of the closed loop over the whole speed phase (about 41 s), at all recorded rows (about "
    "48 Hz, uneven). Driven by the speed commands alone, linearly interpolated between rows and delayed as fitted. First speed: as "
    "recorded in the phase's first row; first torque reading: as recorded."
)


def split(held_out: int, official: bool) -> dict[str, Any]:
    """Fit two runs of every motor and measure all."""
    began = time.perf_counter()
    parameters: dict[str, Any] = {}
    channels: dict[str, Any] = {}
    inverse: dict[str, Any] = {}
    for motor in MOTORS:
        train = [read(motor, number) for number in RUNS if number != held_out]
        test = [read(motor, held_out)]
        stages = fit_stages(motor, train)
        parameters |= named(motor, stages, train)
        found = {name: (errors(stage, train), errors(stage, test)) for name, stage in stages.items()}
        for i, channel in enumerate(("torque", "speed")):
            channels[f"motor_{motor}_{channel}"] = {
                name: {"train": round(a[i], 4), "held_out": round(b[i], 4)} for name, (a, b) in found.items()
            }
        inverse[f"motor_{motor}_torque"] = inverse_errors(train, test)
    return {
        "train": [f"run {number} of motors 1, 3, 5, 6" for number in RUNS if number != held_out],
        "held_out": [f"run {held_out} of motors 1, 3, 5, 6"],
        "metric": METRIC,
        "official": official,
        "nominal_is": "configured kd, documented inertia, no friction, load, offset or delay, nothing fitted; 'documented' adds the "
        "documented friction (and motor 3's kd and clip), unfitted; 'with_static' adds static friction to 'fitted'",
        "parameters": parameters,
        "channels": channels,
        "other_metrics": {
            "inverse model in motion: torque from the measured speed, smoothed by cubics over 21 rows, above 0.1 rad/s": inverse
        },
        "seconds": round(time.perf_counter() - began, 1),
    }


def splits() -> dict[str, Any]:
    """Return all splits."""
    return {f"run {number} held out": split(number, official=number == 3) for number in (3, 2, 1)}


if __name__ == "__main__":
    run("damiao", __doc__, splits)
