"""Exact responses of a shaped path to sinusoids that begin at t = 0 from rest, without an integrator's error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics


@dataclass(frozen=True)
class Sinusoids:
    """The sum of amplitude sin(frequency t + phase) from t = 0 on, and 0 before."""

    amplitudes: np.ndarray
    frequencies_rad_s: np.ndarray
    phases_rad: np.ndarray

    def at(self, times_s: np.ndarray) -> np.ndarray:
        """Return the values (N,) at these times."""
        angles = np.outer(times_s, self.frequencies_rad_s) + self.phases_rad
        return np.where(times_s >= 0.0, np.sin(angles) @ self.amplitudes, 0.0)


def sinusoids(amplitudes: Sequence[float], frequencies_rad_s: Sequence[float], phases_rad: Sequence[float] | None = None) -> Sinusoids:
    """Make a reference as in (7.21)."""
    phases = np.zeros(len(amplitudes)) if phases_rad is None else np.asarray(phases_rad, dtype=float)
    return Sinusoids(np.asarray(amplitudes, dtype=float), np.asarray(frequencies_rad_s, dtype=float), phases)


def shaped_response(dynamics: Dynamics, shaper: DelayFilter, reference: Sinusoids, times_s: np.ndarray) -> np.ndarray:
    """Return the output (N,) of a continuous plant behind a shaper, from rest.

    Every tap adds the plant's own response to the reference, delayed and scaled: x(t) = (iw I - A)^-1 (exp(iwt) I - exp(At)) B for each
    sinusoid, in the coordinates of the plant's modes.

    Raises
    ------
    DesignError
        The plant is sampled, or has repeated poles.
    """
    plain = _response(dynamics, reference, times_s, shaper.delays_s, shaper.gains if shaper.tail is None else _without_last(shaper.gains))
    if shaper.tail is None:
        return plain
    last = _response(dynamics.after(shaper.tail), reference, times_s, shaper.delays_s[-1:], shaper.gains[-1:])
    whole: np.ndarray = plain + last
    return whole


def shaped_reference(shaper: DelayFilter, reference: Sinusoids, times_s: np.ndarray) -> np.ndarray:
    """Return the input (N,) of the plant."""
    straight = Dynamics(np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0)
    return shaped_response(straight, shaper, reference, times_s)


def _without_last(gains: np.ndarray) -> np.ndarray:
    return np.append(gains[:-1], 0.0)


def _response(dynamics: Dynamics, reference: Sinusoids, times_s: np.ndarray, delays_s: np.ndarray, gains: np.ndarray) -> np.ndarray:
    if dynamics.sample_period_s is not None:
        raise DesignError("exact responses are of continuous plants")
    poles, right = np.linalg.eig(dynamics.a) if len(dynamics.a) else (np.zeros(0), np.zeros((0, 0)))
    residues = (dynamics.c @ right) * np.linalg.solve(right, dynamics.b.astype(complex)) if len(poles) else np.zeros(0)
    if not np.isfinite(residues).all():
        raise DesignError("the plant has repeated poles: its response is no sum of exponentials")
    output = np.zeros(len(times_s))
    for amplitude, frequency, phase in zip(reference.amplitudes, reference.frequencies_rad_s, reference.phases_rad, strict=True):
        entering, s = amplitude * np.exp(1j * phase), 1j * frequency
        steady = entering * (dynamics.d + np.sum(residues / (s - poles)))
        own = entering * residues / (s - poles)
        for delay, gain in zip(delays_s, gains, strict=True):
            if gain == 0.0:
                continue
            since = times_s - delay
            begun = np.maximum(since, 0.0)
            response = steady * np.exp(s * begun) - np.exp(np.outer(begun, poles)) @ own
            # the imaginary part of a response to exp(iwt) is the one to sin(wt) only for a real system: take both halves of the sine
            mirrored = np.conj(entering) * (dynamics.d + np.sum(residues / (-s - poles))) * np.exp(-s * begun)
            mirrored = mirrored - np.exp(np.outer(begun, poles)) @ (np.conj(entering) * residues / (-s - poles))
            output += np.where(since >= 0.0, gain * ((response - mirrored) / 2j).real, 0.0)
    return output
