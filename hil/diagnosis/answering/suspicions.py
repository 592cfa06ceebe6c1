"""What looks like a wrong unit, a wrong sign or a gross delay: pointed out, not corrected.

A channel that is wired the wrong way round or lags is a finding of its own. Friction holds a motion back, too: where the answer's
simulation comes in time, that is said with the delay.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.diagnosis.residuals.mismatch import Mismatch

ALIKE = 0.9
"""Correlation from which a channel is the simulation's, but for sign or scale."""

SCALES = {180.0 / np.pi: "degrees for radians", 1000.0: "thousandths", 2.0 * np.pi: "turns for radians", 9.80665: "g for m/s^2"}
SCALE_TOLERANCE = 0.1
LARGEST_LAG_s = 0.1
LEAST_LAG_ROWS = 2
CLEARLY = 0.7
"""A lag is pointed out when it lowers the rms difference below this share."""


def suspicions(found: Mismatch, answered: Mismatch | None = None) -> tuple[str, ...]:
    """What looks like a wrong unit, a wrong sign or a gross delay: a sentence each.

    Parameters
    ----------
    found : Mismatch
        Beside the nominal simulation.
    answered : Mismatch, optional
        The same recordings beside the answer's simulation, of an answer that says what the machine is.
    """
    said = []
    for column, name in enumerate(found.channels):
        measured = np.concatenate([_centred(group.mean[:, column]) for group in found.groups])
        simulated = np.concatenate([_centred(group.simulated[:, column]) for group in found.groups])
        power, own = float(simulated @ simulated), float(measured @ measured)
        if power <= 0.0 or own <= 0.0:
            continue
        correlation = float(measured @ simulated) / np.sqrt(power * own)
        slope = float(measured @ simulated) / power
        if correlation < -ALIKE:
            said.append(f"{name} runs against its simulation (correlation {correlation:.2f}): is its sign right?")
        for scale, meaning in SCALES.items():
            for factor in (scale, 1.0 / scale):
                if abs(correlation) > ALIKE and abs(abs(slope) / factor - 1.0) < SCALE_TOLERANCE:
                    said.append(f"{name} is {abs(slope):.3g} times its simulation: {meaning}?")
        lag = _lag_rows(found, column)
        if lag:
            order = "later" if lag > 0 else "earlier"
            in_time = answered is not None and _is_in_time(answered, column)
            beside = ", and in time beside the answer's" if in_time else ""
            said.append(f"{name} comes {abs(lag) / found.noise.rate_Hz * 1e3:.3g} ms {order} than its simulation{beside}")
    return tuple(said)


def _lag_rows(found: Mismatch, column: int) -> int:
    """Rows by which a channel is later than its simulation, where that explains the difference clearly better; 0 otherwise, and where a
    shift by more than is looked for might explain it as well.
    """
    errors = _errors_by_shift(found, column)
    if not errors:
        return 0
    best = _best(errors)
    is_inside = LEAST_LAG_ROWS <= abs(best) < max(errors)
    return best if is_inside and errors[best] < CLEARLY**2 * errors[0] else 0


def _is_in_time(answered: Mismatch, column: int) -> bool:
    """Whether no shift by LEAST_LAG_ROWS or more is better than none or a smaller one, by however little."""
    if not all(np.isfinite(group.simulated[:, column]).all() for group in answered.groups):
        return False
    errors = _errors_by_shift(answered, column)
    return bool(errors) and abs(_best(errors)) < LEAST_LAG_ROWS


def _best(errors: Mapping[int, float]) -> int:
    return min(errors, key=lambda lag: (errors[lag], abs(lag)))


def _errors_by_shift(found: Mismatch, column: int) -> dict[int, float]:
    """Sum of squares over all groups when the simulation is shifted by so many rows; none of too few rows, in all or a second."""
    most = round(LARGEST_LAG_s * found.noise.rate_Hz)
    pairs = [(_centred(group.mean[:, column]), _centred(group.simulated[:, column])) for group in found.groups]
    if most == 0 or any(len(measured) <= 4 * most for measured, _ in pairs):
        return {}
    return {
        lag: sum(float(np.sum((m[most:-most] - s[most - lag : len(s) - most - lag]) ** 2)) for m, s in pairs)
        for lag in range(-most, most + 1)
    }


def _centred(values: np.ndarray) -> np.ndarray:
    return np.asarray(values - values.mean())
