"""Where a fit of an effect may start: the effect's own guess, and other values of what decides its shape.

Strengths need no search, they are rescaled by the first free run; speeds, orders, stops and stiffnesses do: a fit started a factor of ten
away from them ends elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.start_frequencies import LIGHTEST, LOWEST_MODE_Hz, highest_mode_Hz, lines, modes
from hil.diagnosis.starting.start_waves import ONE_HARMONIC, WAVES, encoder_orders, position_friction, searched_orders, wave_orders
from hil.diagnosis.starting.typical import Start, Typical
from virtual_bus.effects.effect import SIGN, Effect, Parameter
from virtual_bus.effects.registry import effects, initial_guess
from virtual_bus.effects.residual import Residual

REFINEMENTS = ("kc3", "Fs_minus_Fc", "A2", "e2", "sigma1", "d", "D", "droop", "delta", "b", "Fc_minus")
"""Strengths that refine an effect's first one: a guess of none of them stands."""

CORNERS = (0.06, 0.18)
"""Shares of the drive's largest effort over the spring's stiffness at which another spring begins. The spring winds up by half of that or
less, because the rest accelerates what is before it."""

STOP_DEPTHS = (0.03, 0.12, 0.36)
"""Of the travel, that a stop takes away: a stiff one a little of it, one of rubber a third."""

LOW_PASSES = (0.1, 0.4, 1.05, 2.5, 20.0)
"""Corners of a sensor's low pass, in units of the one that the machine file has: a reading may be faster than the file says, too. Without
one there, of a fifth of the sample rate."""


def starts_of(name: str, at: str, motion: Motion) -> list[np.ndarray]:
    """(parameters,) start values, the most plausible first; none where the place does not move."""
    effect = effects()[name]
    residual = motion.residual(at, coupled=effect.kind.needs == "neighbour")
    try:
        guessed = initial_guess(name, residual)
    except (np.linalg.LinAlgError, ValueError, IndexError, ZeroDivisionError):
        guessed = {parameter.name: 0.0 for parameter in effect.parameters}
    typical = Typical(motion, at, residual)
    first = _first(effect, guessed, typical)
    others = _OTHERS.get(name, _nothing)(first, residual, typical)
    found: list[np.ndarray] = []
    for start in others if effect.kind is SIGN else (*others, first):  # a sign is whole: none has a typical size
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
    residual = motion.residual(at, coupled=effect.kind.needs == "neighbour")
    typical = Typical(motion, at, residual)
    if name in WAVES:
        lowest, highest = searched_orders(name, residual, typical)
        return max(WAVES[name] * max(highest - lowest, 0.0) * float(np.std(residual.position)), 1.0)
    if name == "base_motion":
        return max(ONE_HARMONIC * np.pi / typical.sample_s * float(np.std(residual.time_s)), 1.0)
    if name in ("cable_spring", "pose_dependent_dynamics"):
        return 1.0  # wherever it starts: a load and a spring, or a sine and a cosine, in proportion, which a fit counts as its parameters
    if name == "structural_mode":
        return float(max(starts, np.log(highest_mode_Hz(typical) / LOWEST_MODE_Hz) / (2.0 * LIGHTEST)))
    return float(max(starts, 1))


def is_neutral(effect: Effect, values: np.ndarray) -> bool:
    """Whether an effect of these values does nothing."""
    return all(not p.is_strength or value == p.neutral for p, value in zip(effect.parameters, values, strict=True))


def _first(effect: Effect, guessed: Start, typical: Typical) -> Start:
    """The guess, with typical strengths where it sees nothing: of a refinement none, unless the effect has nothing else."""
    strengths = [p for p in effect.parameters if p.is_strength]
    refinements = [p.name for p in strengths if p.name in REFINEMENTS and guessed[p.name] == 0.0]
    if len(refinements) == len(strengths):
        refinements = []
    return {**guessed, **{p.name: _strength(p, guessed[p.name], typical) for p in strengths if p.name not in refinements}}


def _strength(parameter: Parameter, guessed: float, typical: Typical) -> float:
    """The guess, unless it sees nothing."""
    at_bound = guessed <= parameter.low if parameter.low >= 0.0 else False
    unseen = guessed == parameter.neutral or at_bound or guessed >= parameter.high
    return typical.of(parameter) if unseen else guessed


def _nothing(first: Start, residual: Residual, typical: Typical) -> list[Start]:
    return []


def _several(name: str, values: Callable[[Start, Residual, Typical], Iterable[float]]) -> Callable[[Start, Residual, Typical], list[Start]]:
    """Other values of one parameter."""
    return lambda first, residual, typical: [{**first, name: float(value)} for value in values(first, residual, typical)]


def _stops(first: Start, residual: Residual, typical: Typical) -> list[Start]:
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


def _slack(first: Start, residual: Residual, typical: Typical) -> list[Start]:
    """A cable that is slack at the ends of what was visited and in the middle, where re-tuned numbers hide the line a guess looks for; and
    one that pulls at the ends alone: beside a spring of the machine file's re-tuning leaves no more than that of it.
    """
    low, high = float(residual.position.min()), float(residual.position.max())
    middle, half = 0.5 * (low + high), 0.5 * typical.travel
    return [
        *({**first, "theta0": at} for at in (low, middle, high)),
        {**first, "kc": 0.0, "kc3": typical.effort / half**3, "theta0": middle},
    ]


def _springs(first: Start, residual: Residual, typical: Typical) -> list[Start]:
    """Hardening and softening throughout, and springs that another one comes to, stiff within a tenth of the deflection."""
    found = [{**first, "k3": share * typical.stiffness / typical.deflection**2} for share in (0.3, -0.1)]
    for share in CORNERS:
        bend = (10.0 / typical.deflection) ** 2
        found.append({**first, "k3": bend * typical.stiffness / 3.0, "bend": bend, "corner": share * typical.deflection})
    return found


def _warming(first: Start, residual: Residual, typical: Typical) -> list[Start]:
    """Friction that has fallen to a third when it is warm, soon and late: a guess sees nothing cold where re-tuned dampers took it."""
    cold = max(first["Fv0"], typical.effort / typical.speed)
    power = cold * max(float(np.mean(residual.speed**2)), 1e-12)
    warm = {"Fv0": cold, "a": 0.05, "R": 1.0 / (0.05 * power)}
    return [{**start, "tau": share * typical.duration_s} for start in (first, warm) for share in (0.1, 1.0)]


def _quarters(first: Start, residual: Residual, typical: Typical) -> list[Start]:
    """The other three quarters of a turn: beside what was found, what is missing at a joint shows no inertia of a thousandth."""
    return [{**first, "phi": float((first["phi"] + turn + np.pi) % (2.0 * np.pi) - np.pi)} for turn in (0.5 * np.pi, np.pi, 1.5 * np.pi)]


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


_OTHERS: dict[str, Callable[[Start, Residual, Typical], list[Start]]] = {
    "stribeck_friction": _several("vs", lambda f, r, t: [0.02 * t.speed, 0.1 * t.speed, 0.3 * t.speed]),
    "presliding_hysteresis": _several("sigma0", lambda f, r, t: [f["Fc"] / t.travel * k for k in (10.0, 100.0, 1000.0)]),
    "bouc_wen_hysteresis": lambda f, r, t: [
        {**f, "k": t.effort / (share * t.swing), "z_max": share * t.swing} for share in (0.02, 0.1, 0.5)
    ],
    "cogging": wave_orders("Np", ("A1", "A2"), ("phi1", "phi2"), _effort, _ratio),
    "torque_ripple": wave_orders("Np", ("A1", "A2"), ("phi1", "phi2"), _effort_per_drive, _ratio),
    "transmission_error": wave_orders("k", ("e1", "e2"), ("phi1", "phi2"), _deflection, _ratio),
    "position_dependent_friction": position_friction,
    "encoder_eccentricity": encoder_orders,
    "end_stop": _stops,
    "cable_spring": _slack,
    "base_motion": lines,
    "structural_mode": modes,
    "pose_dependent_dynamics": _quarters,
    "backlash": lambda f, r, t: [{"b": share * t.deflection, "flank": share * t.deflection} for share in (0.0015, 0.006, 0.025, 0.1, 0.4)],
    "nonlinear_stiffness": _springs,
    "current_saturation": _several("imax", lambda f, r, t: [0.9 * t.current, 0.7 * t.current]),
    "drive_bandwidth": _several("fc", lambda f, r, t: [0.04 / t.sample_s, 0.15 / t.sample_s, 1.5 / t.sample_s]),
    "delay": _several("Td", lambda f, r, t: [0.5 * t.sample_s, 2.0 * t.sample_s]),
    "clock_offset": _several("t0", lambda f, r, t: [0.5 * t.sample_s, 2.0 * t.sample_s]),
    "imu_bandwidth": lambda f, r, t: [{"fc": share * t.low_pass_Hz, "shape": 0.25} for share in LOW_PASSES],
    "rectified_sensor": lambda f, r, t: [{"share": 0.0, "sign": -1.0}, {"share": 1.0, "sign": 1.0}, {"share": 1.0, "sign": -1.0}],
    "temperature_dependent_friction": _warming,
}
