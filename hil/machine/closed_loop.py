"""The linearised closed loop at one pose: stability and margins, timing as in docs/explanation/notation.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg
import scipy.signal

from controllers.settings import AxisController
from hil.machine.machine import Machine
from virtual_bus.linear.plant import LinearPlant
from virtual_bus.linear.sampled import SampledPlant, sampled

LOWEST_Hz = 0.02
POINTS = 500
RESONANCE_WIDTHS = np.concatenate([-np.geomspace(30.0, 0.1, 25), [0.0], np.geomspace(0.1, 30.0, 25)])
"""Where a resonance is sampled, in units of its half width: a 1 % mode between two points of a plain grid would hide a crossing."""

FINEST_TURN_rad = 0.1
"""Phase by which a delay may turn the loop gain between two points: along the chord the margin is then right to 0.1 degrees."""

BEYOND = 0.01
"""By which share of a gain, or how many radians, behind a change stability is looked at: five times what the chord is wrong by."""


@dataclass(frozen=True)
class Margins:
    """Worst margins of one axis's loop, the others closed; infinite where nothing crosses.

    Where the whole loop is not stable they are negative: the least change of this axis's phase (of less than half a turn), or of its gain,
    behind which all closed-loop poles are found inside the unit circle; -inf where none is found.
    """

    phase_deg: float
    phase_at_Hz: float
    gain_dB: float  # the lesser of how much the gain may rise and how much it may fall
    gain_at_Hz: float
    crossover_Hz: float  # lowest frequency at which the loop gain falls through 1


class LinearLoop:
    """A machine at a pose under C_y of every axis.

    Parameters
    ----------
    plant : SampledPlant
        From every axis's command to its position, in the controllers' order.
    controllers : sequence of AxisController
    """

    def __init__(self, plant: SampledPlant, controllers: Sequence[AxisController]) -> None:
        self.plant = plant
        self._sections = [controller.position_sections for controller in controllers]

    def pole_radius(self) -> float:
        """Largest |pole| of the closed loop; below 1 it is stable."""
        return float(np.abs(self._poles(np.ones(len(self._sections)))).max())

    def margins(self) -> tuple[Margins, ...]:
        """Margins of every axis, the other loops closed."""
        rate_Hz = 1.0 / self.plant.period_s
        frequencies = frequency_grid(self.plant.poles, rate_Hz, self.plant.late_s)
        z = np.exp(2j * np.pi * frequencies / rate_Hz)
        controllers = np.stack([_response(sections, z) for sections in self._sections], axis=-1)
        return margins_of_axes(frequencies, self.plant.response(frequencies) * controllers[:, None, :], self._poles)

    def _poles(self, factors: np.ndarray) -> np.ndarray:
        """Return the poles of the loop closed with each axis's gain times its factor, in z."""
        filters = [cascade_state_space(sections) for sections in self._sections]
        n = len(self.plant.a)
        loop = scipy.linalg.block_diag(self.plant.a, *[f[0] for f in filters])
        entering = self.plant.b * factors
        loop = loop.astype(entering.dtype)
        start = n
        for axis, (f, g, h, d) in enumerate(filters):
            own = slice(start, start + len(f))
            loop[own, :n] = -np.outer(g, self.plant.c[axis])
            loop[:n, own] = np.outer(entering[:, axis], h)
            loop[:n, :n] -= d * np.outer(entering[:, axis], self.plant.c[axis])
            start += len(f)
        return np.linalg.eigvals(loop)


def position_loop(machine: Machine, plant: LinearPlant) -> LinearLoop:
    """Return a machine's linearisation under its controllers, which close on the motors' positions."""
    outputs = [f"position_{axis}" for axis in machine.axes]
    return LinearLoop(sampled(plant, 1.0 / machine.sample_rate_Hz, outputs), machine.controllers)


def frequency_grid(poles: np.ndarray, sample_rate_Hz: float, late_s: float) -> np.ndarray:
    """Frequencies [Hz] up to half the sample rate, itself included, dense about the plant's resonances and where a delay turns the phase.

    Parameters
    ----------
    poles : (n,) complex array
        Of the continuous plant [rad/s].
    sample_rate_Hz, late_s : float
        `late_s` is the delay in the loop.
    """
    nyquist = sample_rate_Hz / 2.0
    grid = [np.geomspace(LOWEST_Hz, nyquist, POINTS), np.arange(LOWEST_Hz, nyquist, FINEST_TURN_rad / (2.0 * np.pi * late_s))]
    for pole in poles[poles.imag > 0.0]:
        grid.append((np.abs(pole) - RESONANCE_WIDTHS * abs(pole.real)) / (2.0 * np.pi))
    joined = np.unique(np.concatenate(grid))
    return np.append(joined[(joined >= LOWEST_Hz) & (joined < nyquist)], nyquist)


def margins_of_axes(frequencies_Hz: np.ndarray, gain: np.ndarray, poles: Callable[[np.ndarray], np.ndarray]) -> tuple[Margins, ...]:
    """Margins of every axis, the others closed.

    Parameters
    ----------
    frequencies_Hz : (L,) array
        So fine that the gain turns little between neighbours; the last is half the sample rate, where a gain is real.
    gain : (L, axes, axes) complex array
        Loop gain (negative feedback), a column per axis at which it is cut.
    poles : function
        From complex factors (axes,) on the columns of the gain to the poles of the closed loop, in z.
    """
    difference = np.eye(gain.shape[1]) + gain
    whole = np.linalg.det(difference)
    now = poles(np.ones(gain.shape[1]))
    found = []
    for axis, own in enumerate(np.eye(gain.shape[1])):
        others = np.delete(np.delete(difference, axis, axis=1), axis, axis=2)
        loop = whole / np.linalg.det(others) - 1.0
        loop[-1] = loop[-1].real  # but for rounding, through which a crossing there could be lost
        if (np.abs(now) < 1.0).all():
            found.append(loop_margins(frequencies_Hz, loop))
        else:
            found.append(_lacking(frequencies_Hz, loop, now, poles, own))
    return tuple(found)


def loop_margins(frequencies_Hz: np.ndarray, gain: np.ndarray) -> Margins:
    """Margins of a loop gain L (negative feedback) whose closed loop is stable, at frequencies as of `margins_of_axes`."""
    crossings, real = _at_unit_gain(frequencies_Hz, gain), _at_half_turn(frequencies_Hz, gain)
    phase = min(((abs(angle), frequency) for frequency, angle, _ in crossings), default=(np.inf, np.nan))
    change = min(((abs(size), frequency) for frequency, size in real), default=(np.inf, np.nan))
    return _margins(phase, change, crossings)


def _lacking(
    frequencies_Hz: np.ndarray, gain: np.ndarray, now: np.ndarray, poles: Callable[[np.ndarray], np.ndarray], own: np.ndarray
) -> Margins:
    """Margins of a loop gain whose closed loop has these poles, not all of them stable, and others with factors f^own.

    A turned gain L e^(j a) stands for positive frequencies alone, its conjugate for the others: of its poles those above the real axis
    count. L is real on the real axis, so over less than half a turn no pole crosses that. One that grows there, without swinging, is not
    a matter of phase.
    """
    crossings, real = _at_unit_gain(frequencies_Hz, gain), _at_half_turn(frequencies_Hz, gain)
    grows = bool(((now.imag == 0.0) & (np.abs(now) >= 1.0)).any())
    lead, lag = ([(sign * angle, frequency) for frequency, angle, _ in crossings] for sign in (-1.0, 1.0))
    fall, rise = ([(sign * size, frequency) for frequency, size in real] for sign in (1.0, -1.0))
    phase = (-np.inf, np.nan) if grows else max(_least_change(lead, 1j * own, poles), _least_change(lag, -1j * own, poles))
    change = max(_least_change(fall, -own, poles), _least_change(rise, own, poles))
    return _margins(phase, change, crossings)


def _least_change(
    changes: Sequence[tuple[float, float]], way: np.ndarray, poles: Callable[[np.ndarray], np.ndarray]
) -> tuple[float, float]:
    """Return the negative of the least change [Np or rad] behind which the loop is stable, and where it swings there [Hz].

    `changes` holds those at which the gain comes to lie on -1 somewhere, with the frequencies; `way` (axes,) is their direction in the
    logarithm of the gain.
    """
    ahead = sorted(each for each in changes if each[0] > 0.0)
    for (change, frequency), (following, _) in pairwise([*ahead, (np.inf, np.nan)]):
        found = poles(np.exp(way * (change + min(BEYOND, 0.5 * (following - change)))))
        if (np.abs(found[found.imag >= 0.0]) < 1.0).all():
            return -change, frequency
    return -np.inf, np.nan


def _margins(phase: tuple[float, float], change: tuple[float, float], crossings: Sequence[tuple[float, float, bool]]) -> Margins:
    """Return margins of what was found in rad and Np."""
    crossover = next((frequency for frequency, _, falls in crossings if falls), np.nan)
    return Margins(float(np.degrees(phase[0])), phase[1], float(20.0 / np.log(10.0) * change[0]), change[1], crossover)


def _at_unit_gain(frequencies_Hz: np.ndarray, gain: np.ndarray) -> list[tuple[float, float, bool]]:
    """Return frequency [Hz], phase from half a turn on [rad], and whether the gain falls, wherever |L| = 1, along the chord."""
    size = np.log(np.abs(gain))
    found = []
    for k in np.flatnonzero(np.sign(size[:-1]) != np.sign(size[1:])):
        share = size[k] / (size[k] - size[k + 1])
        at = gain[k] + share * (gain[k + 1] - gain[k])
        frequency = frequencies_Hz[k] + share * (frequencies_Hz[k + 1] - frequencies_Hz[k])
        found.append((float(frequency), float(np.angle(-at)), bool(size[k] > 0.0)))
    return found


def _at_half_turn(frequencies_Hz: np.ndarray, gain: np.ndarray) -> list[tuple[float, float]]:
    """Return frequency [Hz] and logarithm of the size [Np] wherever L is real and negative, along the chord."""
    found = []
    for k in np.flatnonzero(np.sign(gain.imag[:-1]) != np.sign(gain.imag[1:])):
        share = gain.imag[k] / (gain.imag[k] - gain.imag[k + 1])
        at = gain.real[k] + share * (gain.real[k + 1] - gain.real[k])
        if at < 0.0:
            frequency = frequencies_Hz[k] + share * (frequencies_Hz[k + 1] - frequencies_Hz[k])
            found.append((float(frequency), float(np.log(-at))))
    return found


def _response(sections: np.ndarray, z: np.ndarray) -> np.ndarray:
    b0, b1, b2, _, a1, a2 = (column[:, None] for column in sections.T)
    response: np.ndarray = np.prod((b0 + (b1 + b2 / z) / z) / (1.0 + (a1 + a2 / z) / z), axis=0)
    return response


def cascade_state_space(sections: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Cascade as transition (m, m), input (m,), output (m,) and feedthrough."""
    a, b, c, d = scipy.signal.zpk2ss(*scipy.signal.sos2zpk(sections))
    return a, np.asarray(b).reshape(-1), np.asarray(c).reshape(-1), float(np.asarray(d).reshape(-1)[0])
