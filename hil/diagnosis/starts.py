"""Where a fit of an effect may start: the effect's own guess, and other values of what decides its shape.

Strengths need no search, they are rescaled by the first free run; speeds, orders, stops and stiffnesses do: a fit started a factor of ten
away from them ends elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import product

import numpy as np
import scipy.ndimage

from hil.diagnosis.motion import Motion, highest_seen_Hz
from virtual_bus.effects.effect import COUPLING, Effect, Parameter
from virtual_bus.effects.places import joint_at, undriven_joint_at
from virtual_bus.effects.registry import effects, initial_guess
from virtual_bus.effects.residual import Residual, harmonics

FIRST_SHARE = 0.1
"""Strength of a first try where a guess sees nothing, as a share of what the machine shows of its kind."""

REFINEMENTS = ("kc3", "Fs_minus_Fc", "A2", "e2", "sigma1", "d", "D", "droop", "delta", "b", "Fc_minus")
"""Strengths that refine an effect's first one: a guess of none of them stands."""

ORDERS_PER_TRAVEL = 4.0
"""Orders over position are looked for in steps of this part of a cycle per travel."""

ORDERS_AROUND = 10.0
"""Cycles per travel around an order whose median power is what noise has there: a wave is two wide."""

MOST_ORDERS = 8000
HIGHEST_ORDER_Hz = 20.0
"""Orders that pass faster than this at the usual speed are not looked for: the loop and the drive do not let them through."""

ONE_HARMONIC = 0.5
TWO_HARMONICS = 0.75 * np.sqrt(2.5)
"""Gamma((s+1)/2) / (Gamma(s/2) sqrt(pi)) for two and for four amplitudes, the latter times the rms of 1 and 2 (see `shapes_of`)."""

_WAVES = {
    "cogging": TWO_HARMONICS,
    "torque_ripple": TWO_HARMONICS,
    "transmission_error": TWO_HARMONICS,
    "position_dependent_friction": ONE_HARMONIC,
    "encoder_eccentricity": ONE_HARMONIC,
}

TURNING_WITH_THE_MOTOR = ("cogging", "torque_ripple", "transmission_error")
"""Waves that come several times a turn of the motor. Friction over position may change slowly, and an encoder's first error does so once a
turn, whatever part of it is driven."""

PERIODS_PER_TRAVEL = (0.6, 1.0, 1.5)
"""Of friction over position."""

CORNERS = (0.06, 0.18)
"""Shares of the drive's largest effort over the spring's stiffness at which another spring begins. The spring winds up by half of that or
less, because the rest accelerates what is before it."""

STOP_DEPTHS = (0.03, 0.12, 0.36)
"""Of the travel, that a stop takes away: a stiff one a little of it, one of rubber a third."""

LOW_PASSES = (0.1, 0.4, 1.05, 2.5, 20.0)
"""Corners of a sensor's low pass, in units of the one that the machine file has: a reading may be faster than the file says, too. Without
one there, of a fifth of the sample rate."""


LIGHT = 0.03
"""Damping ratio of a mode that a fit starts with, and steps between the logarithms of frequencies that are looked at."""

LOWEST_MODE_Hz, HIGHEST_MODE_Hz = 1.5, 30.0
"""Between which modes are looked for."""

LINES_AROUND = 41
"""Of a spectrum, whose median power is what noise has there."""


def starts_of(name: str, at: str, motion: Motion) -> list[np.ndarray]:
    """(parameters,) start values, the most plausible first; none where the place does not move."""
    effect = effects()[name]
    residual = motion.residual(at, coupled=effect.kind is COUPLING)
    try:
        guessed = initial_guess(name, residual)
    except (np.linalg.LinAlgError, ValueError, IndexError, ZeroDivisionError):
        guessed = {parameter.name: 0.0 for parameter in effect.parameters}
    typical = _Typical(motion, at, residual)
    first = _first(effect, guessed, typical)
    others = _OTHERS.get(name, _nothing)(first, residual, typical)
    found: list[np.ndarray] = []
    for start in (*others, first):
        values = np.array([np.clip(start[p.name], p.low, p.high) for p in effect.parameters])
        if np.isfinite(values).all() and not is_neutral(effect, values) and not any(np.array_equal(values, other) for other in found):
            found.append(values)
    return found


def shapes_of(name: str, at: str, motion: Motion, starts: int) -> float:
    """How many shapes that can be told from each other are searched between an effect's starts and its fit.

    The largest energy that chance puts along s amplitudes of a wave cos(w x + p) with w anywhere in a range exceeds u with probability
    V P(chi^2 > u), chi^2 with s + 1 degrees of freedom (its search counts as one), V = range(w) rms(x) Gamma((s+1)/2) / (Gamma(s/2)
    sqrt(pi)) times the rms of the harmonics' numbers: the expected number of upcrossings (Davies 1987) as a volume (Hotelling's and Weyl's
    tubes; Adler and Taylor 2007, ch. 10). It is n cycles over the travel or the time, give or take. Of lightly damped modes as many are
    told apart as half-power bandwidths, 2 zeta of a frequency each, stand beside each other. Other effects count their starts.
    """
    effect = effects()[name]
    residual = motion.residual(at, coupled=effect.kind is COUPLING)
    typical = _Typical(motion, at, residual)
    if name in _WAVES:
        lowest, highest = _range_of_orders(residual, typical)
        return max(_WAVES[name] * max(highest - lowest, 0.0) * float(np.std(residual.position)), 1.0)
    if name == "base_motion":
        return max(ONE_HARMONIC * np.pi / typical.sample_s * float(np.std(residual.time_s)), 1.0)
    if name == "cable_spring":
        return 1.0  # wherever it starts: a load and a spring, both in proportion, which a fit counts as its parameters
    if name == "structural_mode":
        return float(max(starts, np.log(_highest_mode_Hz(typical) / LOWEST_MODE_Hz) / (2.0 * LIGHT)))
    return float(max(starts, 1))


def is_neutral(effect: Effect, values: np.ndarray) -> bool:
    """Whether an effect of these values does nothing."""
    return all(not p.is_strength or value == p.neutral for p, value in zip(effect.parameters, values, strict=True))


Start = dict[str, float]


class _Typical:
    """What size things have at a place."""

    def __init__(self, motion: Motion, at: str, residual: Residual) -> None:
        self.motion, self.at = motion, at
        self.sample_s = 1.0 / motion.machine.sample_rate_Hz
        self.duration_s = float(residual.time_s[-1] - residual.time_s[0])
        self.travel = max(float(np.ptp(residual.position)), 1e-6)
        self.speed = max(float(np.abs(residual.speed).max()), 1e-6)
        self.acceleration = max(float(np.sqrt(np.mean(residual.acceleration**2))), 1e-6)
        drive = FIRST_SHARE * float(np.sqrt(np.mean(residual.drive_effort**2)))
        self.effort = max(2.0 * float(np.sqrt(np.mean(residual.effort**2))), drive, 1e-9)
        self.stiffness = residual.stiffness
        self.deflection = max(float(np.abs(residual.other_position).max()), 1e-12) if residual.stiffness > 0.0 else self.travel
        self.current = max(float(np.abs(residual.current).max()), 1e-6)
        settings = motion.machine.plant
        self.mass = next((body.mass_kg for body in settings.tree.bodies if body.name == at), 1.0)
        self.inertia = self._inertia()
        self.swing = self.travel if undriven_joint_at(at, settings) is None else 2.0 * self.deflection
        own = next((imu.accelerometer_bandwidth_Hz or imu.gyro_bandwidth_Hz for imu in settings.imus if imu.name == at), 0.0)
        self.low_pass_Hz = own or 0.2 / self.sample_s

    def _inertia(self) -> float:
        """Of the joint a place belongs to, about the mean pose."""
        plant = self.motion.plant
        try:
            joint = plant.settings.tree.joint_index(joint_at(self.at, plant.settings))
        except (StopIteration, AssertionError):
            joint = list(plant.joint_of_axis().values())[self.motion.axis_of(self.at)]
        return float(self.motion.inertia[joint])

    def of(self, parameter: Parameter) -> float:
        """A first strength of this unit."""
        return {
            "Nm": self.effort,
            "Nm/rad": self.effort / self.travel,
            "Nm s/rad": self.effort / self.speed,
            "Nm s2/rad2": self.effort / self.speed**2,
            "Nm/rad3": self.effort / self.deflection**3,
            "kg m2": FIRST_SHARE * self.inertia,
            "kg": FIRST_SHARE * self.mass,
            "rad": FIRST_SHARE * self.deflection if self.stiffness > 0.0 else 1e-3 * self.travel,
            "rad/Nm": FIRST_SHARE / self.stiffness if self.stiffness > 0.0 else 0.0,
            "rad/s": 1e-2,
            "m/s2": 2e-2,
            "s": self.sample_s,
            "Hz": 0.1 / self.sample_s,
            "A": 0.9 * self.current,
            "phase": 0.01,
        }.get(parameter.unit, 0.02)


def _first(effect: Effect, guessed: Start, typical: _Typical) -> Start:
    """The guess, with typical strengths where it sees nothing: of a refinement none, unless the effect has nothing else."""
    strengths = [p for p in effect.parameters if p.is_strength]
    refinements = [p.name for p in strengths if p.name in REFINEMENTS and guessed[p.name] == 0.0]
    if len(refinements) == len(strengths):
        refinements = []
    return {**guessed, **{p.name: _strength(p, guessed[p.name], typical) for p in strengths if p.name not in refinements}}


def _strength(parameter: Parameter, guessed: float, typical: _Typical) -> float:
    """The guess, unless it sees nothing."""
    at_bound = guessed <= parameter.low if parameter.low >= 0.0 else False
    unseen = guessed == parameter.neutral or at_bound or guessed >= parameter.high
    return typical.of(parameter) if unseen else guessed


def _nothing(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
    return []


def _several(
    name: str, values: Callable[[Start, Residual, _Typical], Iterable[float]]
) -> Callable[[Start, Residual, _Typical], list[Start]]:
    """Other values of one parameter."""
    return lambda first, residual, typical: [{**first, name: float(value)} for value in values(first, residual, typical)]


def _orders(
    order: str,
    amplitudes: tuple[str, str],
    phases: tuple[str, str],
    per: Callable[[Residual], np.ndarray],
    scale: Callable[[Residual], float],
) -> Callable[[Start, Residual, _Typical], list[Start]]:
    """The strongest orders over position of what is missing, whole or not."""

    def find(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
        found = []
        ratio = scale(residual)
        strongest = _strongest_orders(residual, per(residual), typical, 2)
        waves = {value: harmonics(value * residual.position, per(residual)) for value in strongest}
        for value, ((a1, p1), (a2, p2)) in waves.items():
            halves = [other for other in strongest if abs(value - 2.0 * other) < 2.0 * np.pi / typical.travel]
            if any(waves[half][0][0] > a1 for half in halves):
                continue  # the second harmonic of the other one, which starts with both
            found.append({**first, order: value / ratio, amplitudes[0]: a1, phases[0]: p1, amplitudes[1]: a2, phases[1]: p2})
        return found

    return find


def _range_of_orders(residual: Residual, typical: _Typical) -> tuple[float, float]:
    """Radians per radian (or metre) of the joint between which orders are looked for."""
    usual_speed = max(float(np.sqrt(np.mean(residual.speed**2))), 1e-6)
    return 2.0 * np.pi / typical.travel * 0.75, 2.0 * np.pi * highest_seen_Hz(HIGHEST_ORDER_Hz, 1.0 / typical.sample_s) / usual_speed


def _strongest_orders(residual: Residual, values: np.ndarray, typical: _Typical, count: int) -> list[float]:
    """Cycles per radian (or metre) times 2 pi of the joint that explain most, beside a smooth motion's own effort.

    As many (`count`) that stand out most of the orders around them, and as many of the largest power: what is missing is an effort, and
    noise of positions grows in it with the square of frequency, so the largest power is that of noise at high orders.
    """
    lowest, highest = _range_of_orders(residual, typical)
    step = 2.0 * np.pi / typical.travel / ORDERS_PER_TRAVEL
    orders = np.arange(lowest, max(highest, lowest + step), step)[:MOST_ORDERS]
    every = max(1, len(values) // 3000)
    q, v = residual.position[::every], values[::every]
    smooth = [np.ones_like(q), q, q**2, residual.speed[::every], np.sign(residual.speed[::every]), residual.acceleration[::every]]
    basis, _ = np.linalg.qr(np.column_stack(smooth))
    v = v - basis @ (basis.T @ v)
    power = np.array([abs(np.exp(-1j * order * q) @ v) for order in orders])
    around = scipy.ndimage.median_filter(power**2, round(ORDERS_AROUND * ORDERS_PER_TRAVEL), mode="nearest")
    found: list[float] = []
    for measure in (power**2 / np.maximum(around, 1e-300), power):
        chosen: list[float] = []
        for k in np.argsort(-measure):
            if all(abs(orders[k] - other) > 3.0 * step for other in chosen):
                chosen.append(float(orders[k]))
            if len(chosen) == count:
                break
        found += [order for order in chosen if all(abs(order - other) > 3.0 * step for other in found)]
    return found


def _position_friction(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
    moving = residual.moves
    against = -np.sign(residual.speed) * residual.effort * moving
    found = []
    for value in _strongest_orders(residual, against, typical, 2):
        (amplitude, phase), _ = harmonics(value * residual.position[moving], against[moving])
        found.append({**first, "Fc": 2.0 * amplitude, "k": value, "phi": phase})
    # where nothing stands out of the noise
    for periods, phase in product(PERIODS_PER_TRAVEL, (0.0, 2.0 * np.pi / 3.0, -2.0 * np.pi / 3.0)):
        found.append({**first, "k": 2.0 * np.pi * periods / typical.travel, "phi": phase})
    return found


def _encoder_orders(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
    found = []
    for value in _strongest_orders(residual, residual.difference, typical, 1):
        (b, _), _ = harmonics(value * residual.position, residual.difference)
        found.append({**first, "b": b, "Nl": value})
    return [*found, {**first, "a": max(first["a"], 1e-4 * typical.travel), "b": 0.0}]


def _stops(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
    q = residual.position
    found = []
    for side, end in ((1.0, q.max()), (-1.0, q.min())):
        for depth in STOP_DEPTHS:
            position = end - side * depth * typical.travel
            pushed = side * (q - position) > 0.0
            push = max(-side * float(residual.effort[pushed].mean()), 0.2 * typical.effort) if pushed.any() else typical.effort
            stiffness = 2.0 * push / (depth * typical.travel)
            found.append({**first, "K": stiffness, "at_position": float(position), "side": side})
    return found


def _slack(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
    """A cable that is slack at the ends of what was visited and in the middle, where re-tuned numbers hide the line a guess looks for; and
    one that pulls at the ends alone: beside a spring of the machine file's re-tuning leaves no more than that of it.
    """
    low, high = float(residual.position.min()), float(residual.position.max())
    middle, half = 0.5 * (low + high), 0.5 * typical.travel
    return [
        *({**first, "theta0": at} for at in (low, middle, high)),
        {**first, "kc": 0.0, "kc3": typical.effort / half**3, "theta0": middle},
    ]


def _springs(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
    """Hardening and softening throughout, and springs that another one comes to, stiff within a tenth of the deflection."""
    found = [{**first, "k3": share * typical.stiffness / typical.deflection**2} for share in (0.3, -0.1)]
    for share in CORNERS:
        bend = (10.0 / typical.deflection) ** 2
        found.append({**first, "k3": bend * typical.stiffness / 3.0, "bend": bend, "corner": share * typical.deflection})
    return found


def _lines(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
    """The two strongest lines of the missing effort."""
    frequencies = np.fft.rfftfreq(len(residual.time_s), typical.sample_s)
    window = np.hanning(len(residual.time_s))
    found: list[Start] = []
    spectrum = np.abs(np.fft.rfft((residual.effort - residual.effort.mean()) * window))
    spectrum[:2] = 0.0
    for _ in range(2):
        k = int(np.argmax(spectrum))
        f = float(frequencies[k])
        ((amplitude, phase),) = harmonics(2.0 * np.pi * f * residual.time_s, residual.effort, (1,))
        found.append({**first, "A": max(amplitude, 0.05 * typical.effort), "f": f, "phi": _wrapped(phase + 0.5 * np.pi)})
        spectrum[max(0, k - 4) : k + 5] = 0.0
    return found


def _warming(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
    """Friction that has fallen to a third when it is warm, soon and late: a guess sees nothing cold where re-tuned dampers took it."""
    cold = max(first["Fv0"], typical.effort / typical.speed)
    power = cold * max(float(np.mean(residual.speed**2)), 1e-12)
    warm = {"Fv0": cold, "a": 0.05, "R": 1.0 / (0.05 * power)}
    return [{**start, "tau": share * typical.duration_s} for start in (first, warm) for share in (0.1, 1.0)]


def _modes(first: Start, residual: Residual, typical: _Typical) -> list[Start]:
    """Where the missing effort is large against the motion, and a grid over the band."""
    frequencies = np.fft.rfftfreq(len(residual.time_s), typical.sample_s)
    window = np.hanning(len(residual.time_s))
    effort = np.abs(np.fft.rfft(residual.effort * window)) ** 2
    motion = np.abs(np.fft.rfft(residual.acceleration * window)) ** 2
    kernel = np.ones(9) / 9.0
    effort, motion = np.convolve(effort, kernel, "same"), np.convolve(motion, kernel, "same")
    band = (frequencies > 2.0) & (frequencies < _highest_mode_Hz(typical))
    ratio = np.where(band, effort / np.maximum(motion + 1e-3 * motion.max(), 1e-12 * effort.max() + 1e-300), 0.0)
    peak = float(frequencies[int(np.argmax(ratio))])
    inertia = FIRST_SHARE * typical.inertia
    grid = [*_resonances(residual, typical, 2), round(peak, 2), 5.0, 9.0, 15.0, 24.0]
    return [{"J": inertia, "f": f, "zeta": LIGHT} for f in dict.fromkeys(grid)]


def _highest_mode_Hz(typical: _Typical) -> float:
    return min(HIGHEST_MODE_Hz, 0.3 / typical.sample_s)


def _resonances(residual: Residual, typical: _Typical, count: int) -> list[float]:
    """Frequencies [Hz] at which a lightly damped mass that hangs on the joint takes most out of the missing effort.

    Beside a mass, a damper and a spring, every line weighs as much as its effort stands out of the lines around it.
    """
    frequencies = np.fft.rfftfreq(len(residual.time_s), typical.sample_s)
    highest = _highest_mode_Hz(typical)
    band = (frequencies > 0.5) & (frequencies < 1.3 * highest)
    window = np.hanning(len(residual.time_s))
    moved = [residual.acceleration, residual.speed, residual.position - residual.position.mean()]
    effort, acceleration, *others = (np.fft.rfft((values - values.mean()) * window)[band] for values in (residual.effort, *moved))
    s = 2j * np.pi * frequencies[band]
    around = scipy.ndimage.median_filter(np.abs(effort) ** 2, LINES_AROUND, mode="nearest")
    weight = 1.0 / np.sqrt(np.maximum(around, 1e-300))

    def column(line: np.ndarray) -> np.ndarray:
        return np.concatenate([(weight * line).real, (weight * line).imag])

    basis, _ = np.linalg.qr(np.column_stack([column(line) for line in (acceleration, *others)]))
    wanted = column(effort)
    wanted = wanted - basis @ (basis.T @ wanted)
    tried = np.exp(np.arange(np.log(LOWEST_MODE_Hz), np.log(highest), LIGHT))
    gains = np.zeros(len(tried))
    for k, w in enumerate(2.0 * np.pi * tried):
        pull = column(-acceleration * (w * w + 2.0 * LIGHT * w * s) / (s * s + 2.0 * LIGHT * w * s + w * w))
        pull = pull - basis @ (basis.T @ pull)
        gains[k] = max(float(pull @ wanted), 0.0) ** 2 / max(float(pull @ pull), 1e-300)
    found: list[float] = []
    for k in np.argsort(-gains):
        if gains[k] > 0.0 and all(abs(np.log(tried[k] / other)) > 4.0 * LIGHT for other in found):
            found.append(round(float(tried[k]), 3))
        if len(found) == count:
            break
    return found


def _wrapped(phase: float) -> float:
    return float((phase + np.pi) % (2.0 * np.pi) - np.pi)


def _ratio(residual: Residual) -> float:
    return residual.ratio


def _effort(residual: Residual) -> np.ndarray:
    return residual.effort


def _effort_per_drive(residual: Residual) -> np.ndarray:
    level = 0.1 * float(np.abs(residual.drive_effort).max(initial=1e-9))
    drive = residual.drive_effort
    return residual.effort * drive / (drive**2 + level**2)


def _deflection(residual: Residual) -> np.ndarray:
    return residual.difference


_OTHERS: dict[str, Callable[[Start, Residual, _Typical], list[Start]]] = {
    "stribeck_friction": _several("vs", lambda f, r, t: [0.02 * t.speed, 0.1 * t.speed, 0.3 * t.speed]),
    "presliding_hysteresis": _several("sigma0", lambda f, r, t: [f["Fc"] / t.travel * k for k in (10.0, 100.0, 1000.0)]),
    "bouc_wen_hysteresis": lambda f, r, t: [
        {**f, "k": t.effort / (share * t.swing), "z_max": share * t.swing} for share in (0.02, 0.1, 0.5)
    ],
    "cogging": _orders("Np", ("A1", "A2"), ("phi1", "phi2"), _effort, _ratio),
    "torque_ripple": _orders("Np", ("A1", "A2"), ("phi1", "phi2"), _effort_per_drive, _ratio),
    "transmission_error": _orders("k", ("e1", "e2"), ("phi1", "phi2"), _deflection, _ratio),
    "position_dependent_friction": _position_friction,
    "encoder_eccentricity": _encoder_orders,
    "end_stop": _stops,
    "cable_spring": _slack,
    "base_motion": _lines,
    "structural_mode": _modes,
    "backlash": lambda f, r, t: [{"b": share * t.deflection, "flank": share * t.deflection} for share in (0.0015, 0.006, 0.025, 0.1, 0.4)],
    "nonlinear_stiffness": _springs,
    "current_saturation": _several("imax", lambda f, r, t: [0.9 * t.current, 0.7 * t.current]),
    "drive_bandwidth": _several("fc", lambda f, r, t: [0.04 / t.sample_s, 0.15 / t.sample_s, 1.5 / t.sample_s]),
    "delay": _several("Td", lambda f, r, t: [0.5 * t.sample_s, 2.0 * t.sample_s]),
    "clock_offset": _several("t0", lambda f, r, t: [0.5 * t.sample_s, 2.0 * t.sample_s]),
    "imu_bandwidth": lambda f, r, t: [{"fc": share * t.low_pass_Hz, "shape": 0.25} for share in LOW_PASSES],
    "rectified_sensor": lambda f, r, t: [{"share": 1.0, "sign": 1.0}, {"share": 1.0, "sign": -1.0}, {"share": 0.0, "sign": -1.0}],
    "temperature_dependent_friction": _warming,
}
