"""How a hypothesis of an effect begins: forms of its law that are linear in their weights, for what a place of the machine did."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.ndimage

MOST_ORDERS = 200
"""Of a motor's turn: one of 36 slots and 48 poles has 144."""
PERIODS = 64
"""Of a wave within the way that a joint slides, at most."""
BINS = 16
"""A wave that is read off at the middle of so many steps a period loses 0.6 % of its amplitude."""
FINER = 4
"""Orders for each that the travel tells apart."""
TRIED = 4
"""Orders and lines that hypotheses begin from: among the strongest four is the right one, where it explains more than its neighbours."""
SMOOTHED = 61
"""Orders or lines over which what noise makes of them is averaged: smooth to an eighth."""


@dataclass(frozen=True)
class Place:
    """What a place of the machine did in the recordings; of a joint, the sprung joint behind it, or a sensor.

    Attributes
    ----------
    low, high : float
        Range of the joint's position [rad or m]; of the spring's deflection where the effect acts on one.
    speed : float
        Largest speed [rad/s or m/s].
    effort : float
        Rms of the effort on the joint [Nm or N].
    current : float
        Largest target of the drive [its unit].
    ratio : float
        Motor coordinate per joint coordinate.
    stiffness : float
        Of the sprung joint [Nm/rad or N/m].
    inertia : float
        Of all that moves with the joint [kg m^2 or kg].
    period_s, duration_s : float
        Of a row, and of the longest recording.
    is_seen_twice : bool
        Whether another sensor than the motor's encoder reads the joint's motion.
    is_prismatic : bool
        Whether the joint slides.
    position, missing : (N,) arrays
        The joint's position, and how much the recordings ask for a further effort on it.
    noise : (D, N) array
        How much they would ask for one by noise alone, drawn D times; with none, `missing` is in units of that already.
    """

    low: float
    high: float
    speed: float
    effort: float
    current: float
    ratio: float
    stiffness: float
    inertia: float
    period_s: float
    duration_s: float
    is_seen_twice: bool
    is_prismatic: bool
    position: np.ndarray
    missing: np.ndarray
    noise: np.ndarray

    @property
    def travel(self) -> float:
        """Range of positions, at least a billionth."""
        return max(self.high - self.low, 1e-9)

    def orders(self, per_turn: float = 1.0) -> list[float]:
        """Return the orders, in periods per `per_turn`-th of a turn, over which most is missing.

        They lie a quarter of what the joint's travel tells apart from each other: behind a gear they need not be whole. An order is left
        out where the joint does not pass a whole period of it.
        """
        turn = 2.0 * math.pi / per_turn
        least = turn / self.travel
        most = PERIODS * least if self.is_prismatic else MOST_ORDERS  # a joint that slides has no turn that would limit them
        if least >= most:
            return []
        bins = math.ceil(BINS * most / least)  # of the travel: a small part of the highest order's period
        at = np.minimum(((self.position - self.low) / self.travel * bins).astype(np.int64), bins - 1)
        power = self._power(lambda asked: scipy.fft.rfft(np.bincount(np.maximum(at, 0), asked, minlength=bins), FINER * bins))
        orders = np.arange(len(power)) * least / FINER
        inside = (orders >= least) & (orders <= most)
        return _peaks(orders[inside], power[inside])

    def speeds(self) -> list[float]:
        """Return speeds from a fiftieth of the largest one up, a factor of about two apart."""
        return [self.speed / by for by in (50.0, 20.0, 8.0, 3.0)]

    def grid_Hz(self, low: float, count: int = 24) -> list[float]:
        """Return frequencies evenly spaced on a logarithmic scale, from `low` to four tenths of the sample rate."""
        return np.geomspace(max(low, 2.0 / self.duration_s), 0.4 / self.period_s, count).tolist()  # type: ignore[no-any-return]

    def lines_Hz(self) -> list[float]:
        """Return the frequencies of the strongest lines in what is missing, half a cycle of the longest recording apart."""
        frequencies = np.arange(1.0 / self.duration_s, 0.25 / self.period_s, 0.5 / self.duration_s)
        power = self._power(lambda asked: scipy.fft.rfft(asked, 2 * len(asked)))
        grid = np.arange(len(power)) * 0.5 / (len(self.missing) * self.period_s)
        return _peaks(frequencies, np.interp(frequencies, grid, power))

    def _power(self, spectrum: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Return a spectrum's power in what is missing, over what noise makes of it: a matched filter's of waves."""
        power: np.ndarray = np.abs(spectrum(self.missing - self.missing.mean())) ** 2
        if not len(self.noise):
            return power
        noise = np.mean([np.abs(spectrum(each - each.mean())) ** 2 for each in self.noise], axis=0)
        ratio: np.ndarray = power / np.maximum(scipy.ndimage.uniform_filter1d(noise, SMOOTHED, mode="nearest"), 1e-300)
        return ratio


def _peaks(values: np.ndarray, power: np.ndarray) -> list[float]:
    """Return the values at the highest local maxima."""
    padded = np.concatenate([[-1.0], power, [-1.0]])
    tops = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]))
    return values[tops[np.argsort(power[tops])[::-1][:TRIED]]].tolist()  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Law:
    """One form of an effect: parameter sets whose signals are added up with weights.

    Attributes
    ----------
    columns : tuple of mapping of str to float
        Whole parameter sets, one a column.
    parameters : callable
        The effect's parameters at these weights (C,).
    lowest : float
        Of the weights: 0 where the effect has one sign, minus infinity where it has both.
    highest : float
        Of the weights; 1 where a column is the effect itself and no multiple of it exists.
    """

    columns: tuple[Mapping[str, float], ...]
    parameters: Callable[[np.ndarray], dict[str, float]]
    lowest: float = 0.0
    highest: float = math.inf


def one(strength: str, value: float = 1.0, both_signs: bool = False, **shape: float) -> Law:
    """Return the law of one strength, which multiplies its signal."""
    return Law(({strength: value, **shape},), lambda w: {strength: value * float(w[0]), **shape}, -math.inf if both_signs else 0.0)


def fixed(**parameters: float) -> Law:
    """Return the law of one whole parameter set, of which there is no multiple."""
    return Law((parameters,), lambda _: dict(parameters), 0.0, 1.0)


def each(strengths: Sequence[str], value: float | Sequence[float] = 1.0, both_signs: bool = False, **others: float) -> Law:
    """Return the law of several strengths, a column each, the others at their neutral value; a column's strength is `value`."""
    rest = dict.fromkeys(strengths, 0.0)
    values = dict(zip(strengths, np.broadcast_to(value, len(strengths)).tolist(), strict=True))
    columns = tuple({**others, **rest, strength: its} for strength, its in values.items())
    return Law(
        columns,
        lambda w: {**others, **{strength: its * float(weight) for (strength, its), weight in zip(values.items(), w, strict=True)}},
        -math.inf if both_signs else 0.0,
    )


def wave(amplitude: str, phase: str, value: float = 1.0, **others: float) -> Law:
    """Return the law of a sine or cosine of free phase: two columns a quarter of a period apart."""
    columns = ({**others, amplitude: value, phase: 0.0}, {**others, amplitude: value, phase: 0.5 * math.pi})

    def parameters(w: np.ndarray) -> dict[str, float]:
        return {**others, amplitude: value * float(np.hypot(w[0], w[1])), phase: float(np.arctan2(w[1], w[0]))}

    return Law(columns, parameters, -math.inf)


def raised_wave(amplitude: str, phase: str, value: float = 1.0, **others: float) -> Law:
    """Return the law of (1 + cosine of free phase) / 2, which is never negative: three columns a third of a period apart."""
    phases = np.array([0.0, 2.0, 4.0]) * math.pi / 3.0
    columns = tuple({**others, amplitude: value, phase: float(p)} for p in phases)

    def parameters(w: np.ndarray) -> dict[str, float]:
        whole = complex(np.sum(np.asarray(w) * np.exp(1j * phases)))
        return {**others, amplitude: value * abs(whole), phase: float(np.angle(whole))}

    return Law(columns, parameters)
