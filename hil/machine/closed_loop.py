"""The linearised closed loop at one pose: stability and margins, timing as in docs/explanation/notation.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.signal

from controllers.settings import AxisController
from hil.machine.model import Machine
from virtual_bus.linear.plant import LinearPlant
from virtual_bus.linear.sampled import SampledPlant, sampled

LOWEST_Hz = 0.02
POINTS = 500
RESONANCE_WIDTHS = np.concatenate([-np.geomspace(30.0, 0.1, 25), [0.0], np.geomspace(0.1, 30.0, 25)])
"""Where a resonance is sampled, in units of its half width: a 1 % mode between two points of a plain grid would hide a crossing."""

FINEST_TURN_rad = 0.1
"""Phase by which a delay may turn the loop gain between two points: along the chord the margin is then right to 0.1 degrees."""


@dataclass(frozen=True)
class Margins:
    """Worst margins of one axis's loop, the others closed; infinite where nothing crosses, negative where the loop is not stable."""

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
        filters = [cascade_state_space(sections) for sections in self._sections]
        n = len(self.plant.a)
        loop = scipy.linalg.block_diag(self.plant.a, *[f[0] for f in filters])
        start = n
        for axis, (f, g, h, d) in enumerate(filters):
            own = slice(start, start + len(f))
            loop[own, :n] = -np.outer(g, self.plant.c[axis])
            loop[:n, own] = np.outer(self.plant.b[:, axis], h)
            loop[:n, :n] -= d * np.outer(self.plant.b[:, axis], self.plant.c[axis])
            start += len(f)
        return float(np.abs(np.linalg.eigvals(loop)).max())

    def margins(self) -> tuple[Margins, ...]:
        """Margins of every axis, the other loops closed; of a loop that is not stable they are negative: by so much it fails."""
        rate_Hz = 1.0 / self.plant.period_s
        frequencies = frequency_grid(self.plant.poles, rate_Hz, self.plant.late_s)
        z = np.exp(2j * np.pi * frequencies / rate_Hz)
        plant = self.plant.response(frequencies)
        gain = plant * np.stack([_response(sections, z) for sections in self._sections], axis=-1)[:, None, :]
        difference = np.eye(gain.shape[1]) + gain
        whole = np.linalg.det(difference)
        is_stable = self.pole_radius() < 1.0
        found = []
        for axis in range(gain.shape[1]):
            others = np.delete(np.delete(difference, axis, axis=1), axis, axis=2)
            found.append(loop_margins(frequencies, whole / np.linalg.det(others) - 1.0, is_stable))
        return tuple(found)


def position_loop(machine: Machine, plant: LinearPlant) -> LinearLoop:
    """Return a machine's linearisation under its controllers, which close on the motors' positions."""
    outputs = [f"position_{axis}" for axis in machine.axes]
    return LinearLoop(sampled(plant, 1.0 / machine.sample_rate_Hz, outputs), machine.controllers)


def frequency_grid(poles: np.ndarray, sample_rate_Hz: float, late_s: float = 0.0) -> np.ndarray:
    """Frequencies [Hz] up to half the sample rate, dense about the plant's resonances and where a delay turns the phase fast.

    Parameters
    ----------
    poles : (n,) complex array
        Of the continuous plant [rad/s].
    sample_rate_Hz, late_s : float
        `late_s` is the delay in the loop.
    """
    nyquist = sample_rate_Hz / 2.0
    grid = [np.geomspace(LOWEST_Hz, nyquist, POINTS)]
    if late_s > 0.0:
        grid.append(np.arange(LOWEST_Hz, nyquist, FINEST_TURN_rad / (2.0 * np.pi * late_s)))
    for pole in poles[poles.imag > 0.0]:
        grid.append((np.abs(pole) - RESONANCE_WIDTHS * abs(pole.real)) / (2.0 * np.pi))
    joined = np.unique(np.concatenate(grid))
    return joined[(joined >= LOWEST_Hz) & (joined < nyquist)]


def loop_margins(frequencies_Hz: np.ndarray, gain: np.ndarray, is_stable: bool = True) -> Margins:
    """Margins of a loop gain L (negative feedback) on a frequency grid fine enough that it turns little between neighbours.

    Crossings of |L| = 1 and of the negative real axis are interpolated along the chord. Where the closed loop is not stable, the phase
    margin is that of the crossing which needs the least phase to become right, negative: a crossing downwards must lie before -180
    degrees, one upwards behind it.
    """
    size = np.log(np.abs(gain))
    phase, crossover = (np.inf, np.nan), np.nan
    missing = (-np.inf, np.nan)
    for k in np.flatnonzero(np.sign(size[:-1]) != np.sign(size[1:])):
        share = size[k] / (size[k] - size[k + 1])
        at = gain[k] + share * (gain[k + 1] - gain[k])
        frequency = frequencies_Hz[k] + share * (frequencies_Hz[k + 1] - frequencies_Hz[k])
        falls = size[k] > 0.0
        if falls and np.isnan(crossover):
            crossover = frequency
        angle = np.degrees(np.angle(-at))
        phase = min(phase, (abs(angle), frequency))
        lacks = angle if falls else -angle
        if lacks < 0.0:
            missing = max(missing, (lacks, frequency))
    rise = (np.inf, np.nan)
    for k in np.flatnonzero(np.sign(gain.imag[:-1]) != np.sign(gain.imag[1:])):
        share = gain.imag[k] / (gain.imag[k] - gain.imag[k + 1])
        at = gain.real[k] + share * (gain.real[k + 1] - gain.real[k])
        if at < 0.0:
            frequency = frequencies_Hz[k] + share * (frequencies_Hz[k + 1] - frequencies_Hz[k])
            rise = min(rise, (abs(20.0 * np.log10(-at)), frequency))
    if not is_stable:
        phase = missing if np.isfinite(missing[0]) else phase
        rise = (-rise[0], rise[1])
    return Margins(*(float(value) for value in (*phase, *rise, crossover)))


def _response(sections: np.ndarray, z: np.ndarray) -> np.ndarray:
    b0, b1, b2, _, a1, a2 = (column[:, None] for column in sections.T)
    response: np.ndarray = np.prod((b0 + (b1 + b2 / z) / z) / (1.0 + (a1 + a2 / z) / z), axis=0)
    return response


def cascade_state_space(sections: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Cascade as transition (m, m), input (m,), output (m,) and feedthrough."""
    a, b, c, d = scipy.signal.zpk2ss(*scipy.signal.sos2zpk(sections))
    return a, np.asarray(b).reshape(-1), np.asarray(c).reshape(-1), float(np.asarray(d).reshape(-1)[0])
