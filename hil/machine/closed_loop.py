"""The linearised closed loop at one pose: stability and margins, timing as in docs/explanation/notation.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.signal

from controllers.settings import AxisController

LOWEST_Hz = 0.02
POINTS = 500
RESONANCE_WIDTHS = np.concatenate([-np.geomspace(30.0, 0.1, 25), [0.0], np.geomspace(0.1, 30.0, 25)])
"""Where a resonance is sampled, in units of its half width: a 1 % mode between two points of a plain grid would hide a crossing."""


@dataclass(frozen=True)
class Margins:
    """Worst margins of one axis's loop, the others closed; infinite where nothing crosses."""

    phase_deg: float
    phase_at_Hz: float
    gain_dB: float  # the lesser of how much the gain may rise and how much it may fall
    gain_at_Hz: float
    crossover_Hz: float  # lowest frequency at which the loop gain falls through 1


class LinearLoop:
    """Plant, one sample of delay and C_y of every axis.

    Parameters
    ----------
    a, b, c : arrays (n, n), (n, axes), (axes, n)
        Continuous plant from command to position.
    controllers : sequence of AxisController
    sample_rate_Hz : float
    """

    def __init__(self, a: np.ndarray, b: np.ndarray, c: np.ndarray, controllers: Sequence[AxisController], sample_rate_Hz: float) -> None:
        self._rate_Hz = sample_rate_Hz
        self._sections = [controller.position_sections for controller in controllers]
        self._poles = np.linalg.eigvals(a)
        no_feedthrough = np.zeros((len(c), b.shape[1]))
        self._a, self._b, self._c, _, _ = scipy.signal.cont2discrete((a, b, c, no_feedthrough), 1.0 / sample_rate_Hz)

    def pole_radius(self) -> float:
        """Largest |pole| of the closed loop; below 1 it is stable."""
        filters = [cascade_state_space(sections) for sections in self._sections]
        n, axes = len(self._a), len(filters)
        loop = scipy.linalg.block_diag(self._a, np.zeros((axes, axes)), *[f[0] for f in filters])
        loop[:n, n : n + axes] = self._b  # the drives hold the last sample's command
        start = n + axes
        for axis, (f, g, h, d) in enumerate(filters):
            own = slice(start, start + len(f))
            loop[own, :n] = -np.outer(g, self._c[axis])
            loop[n + axis, own] = h
            loop[n + axis, :n] = -d * self._c[axis]
            start += len(f)
        return float(np.abs(np.linalg.eigvals(loop)).max())

    def margins(self) -> tuple[Margins, ...]:
        """Margins of every axis, the other loops closed."""
        frequencies = frequency_grid(self._poles, self._rate_Hz)
        z = np.exp(2j * np.pi * frequencies / self._rate_Hz)
        identity = np.eye(len(self._a))
        plant = self._c @ np.linalg.solve(z[:, None, None] * identity - self._a, np.broadcast_to(self._b, (len(z), *self._b.shape)))
        gain = plant / z[:, None, None] * np.stack([_response(sections, z) for sections in self._sections], axis=-1)[:, None, :]
        difference = np.eye(gain.shape[1]) + gain
        whole = np.linalg.det(difference)
        found = []
        for axis in range(gain.shape[1]):
            others = np.delete(np.delete(difference, axis, axis=1), axis, axis=2)
            found.append(loop_margins(frequencies, whole / np.linalg.det(others) - 1.0))
        return tuple(found)


def frequency_grid(poles: np.ndarray, sample_rate_Hz: float) -> np.ndarray:
    """Frequencies [Hz] up to half the sample rate, dense about the plant's resonances: `poles` (n,) of the continuous plant."""
    nyquist = sample_rate_Hz / 2.0
    grid = [np.geomspace(LOWEST_Hz, nyquist, POINTS)]
    for pole in poles[poles.imag > 0.0]:
        grid.append((np.abs(pole) - RESONANCE_WIDTHS * abs(pole.real)) / (2.0 * np.pi))
    joined = np.unique(np.concatenate(grid))
    return joined[(joined >= LOWEST_Hz) & (joined < nyquist)]


def loop_margins(frequencies_Hz: np.ndarray, gain: np.ndarray) -> Margins:
    """Margins of a loop gain L (negative feedback) on a frequency grid fine enough that it turns little between neighbours.

    Crossings of |L| = 1 and of the negative real axis are interpolated along the chord.
    """
    size = np.log(np.abs(gain))
    phase, crossover = (np.inf, np.nan), np.nan
    for k in np.flatnonzero(np.sign(size[:-1]) != np.sign(size[1:])):
        share = size[k] / (size[k] - size[k + 1])
        at = gain[k] + share * (gain[k + 1] - gain[k])
        frequency = frequencies_Hz[k] + share * (frequencies_Hz[k + 1] - frequencies_Hz[k])
        if size[k] > 0.0 and np.isnan(crossover):
            crossover = frequency
        phase = min(phase, (abs(np.degrees(np.angle(-at))), frequency))
    rise = (np.inf, np.nan)
    for k in np.flatnonzero(np.sign(gain.imag[:-1]) != np.sign(gain.imag[1:])):
        share = gain.imag[k] / (gain.imag[k] - gain.imag[k + 1])
        at = gain.real[k] + share * (gain.real[k + 1] - gain.real[k])
        if at < 0.0:
            frequency = frequencies_Hz[k] + share * (frequencies_Hz[k + 1] - frequencies_Hz[k])
            rise = min(rise, (abs(20.0 * np.log10(-at)), frequency))
    return Margins(*(float(value) for value in (*phase, *rise, crossover)))


def _response(sections: np.ndarray, z: np.ndarray) -> np.ndarray:
    b0, b1, b2, _, a1, a2 = (column[:, None] for column in sections.T)
    response: np.ndarray = np.prod((b0 + (b1 + b2 / z) / z) / (1.0 + (a1 + a2 / z) / z), axis=0)
    return response


def cascade_state_space(sections: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Cascade as transition (m, m), input (m,), output (m,) and feedthrough."""
    a, b, c, d = scipy.signal.zpk2ss(*scipy.signal.sos2zpk(sections))
    return a, np.asarray(b).reshape(-1), np.asarray(c).reshape(-1), float(np.asarray(d).reshape(-1)[0])
