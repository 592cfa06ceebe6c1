"""Placebos: the candidates' own responses run backwards in time, which have their size and spectrum but no cause.

A placebo may look like an effect: of a long slow motion a response run backwards keeps what it has in common with itself and with others.
So an effect and a placebo are also compared by how much |residual|^2 rises when one of the two is taken out of a fit of both. One that
gains by its likeness to the effect alone gains nothing beside it: beside an eccentric encoder wheel that gains 6.1e4 and that another
motion confirms by 98 deviations, another's response run backwards may gain 4.1e4 of the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.diagnosis.fitting.screening import Screened
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning

PLACEBO_FACTOR = 1.5
"""The effect must gain this many times what a placebo gains, in training, where that was searched, or held out, where nothing is."""

SAME_BACKWARDS = 0.5
"""A response whose cosine with itself backwards is larger has no placebo of this kind (a constant has no direction in time)."""

KEPT = 8
"""Placebos that are compared with an effect: those that gain most."""

ALIKE = 0.999
"""Squared cosine from which on an effect and a placebo are one response: neither gains anything beside the other."""


class Beside(NamedTuple):
    """What a placebo gains beside an effect, and the effect beside that placebo."""

    placebo: float
    effect: float


@dataclass(frozen=True, eq=False)
class Rivals:
    """Placebos beside what was found.

    Attributes
    ----------
    responses : (K, M + F) array
        Of unit length, the part that no re-tuning imitates.
    along : (K,) array
        How far the residual goes along each: the root of what it gains.
    """

    responses: np.ndarray
    along: np.ndarray

    @property
    def largest(self) -> float:
        """Gain of a placebo by itself."""
        return float(np.max(self.along**2, initial=0.0))

    def beside(self, change: np.ndarray, gain: float) -> Beside | None:
        """What an effect and the placebo that comes nearest to refusing it gain beside each other; None without placebos or a gain.

        Parameters
        ----------
        change : (M + F,) array
            Of the simulation by the effect, the part that no re-tuning imitates.
        gain : float
            Fall of |residual|^2 by it.
        """
        length = float(np.sqrt(change @ change))
        if not len(self.along) or length == 0.0 or gain <= 0.0:
            return None
        own = np.sqrt(gain)
        common = self.responses @ change / length
        left = 1.0 - np.minimum(common**2, ALIKE)
        apart = common**2 < ALIKE
        placebo = np.where(apart, (self.along - common * own) ** 2 / left, 0.0)
        effect = np.where(apart, (own - common * self.along) ** 2 / left, 0.0)
        rival = int(np.argmax(PLACEBO_FACTOR * placebo - effect))
        return Beside(float(placebo[rival]), float(effect[rival]))


@dataclass(frozen=True, eq=False)
class Placebos:
    """Responses (K, M) run backwards: those that gain most where an effect is looked for."""

    responses: np.ndarray

    def at(self, tuning: Tuning, residual: np.ndarray) -> Rivals:
        """Beside this tuning, which leaves this (M,) residual."""
        if not len(self.responses):
            return Rivals(np.zeros((0, 0)), np.zeros(0))
        projection = Projection.of(tuning)
        placebos = projection.left(self.responses)
        placebos /= np.maximum(np.linalg.norm(placebos, axis=1), 1e-30)[:, None]
        return Rivals(placebos, placebos @ projection.left_of_residual(residual))


NO_PLACEBOS = Placebos(np.zeros((0, 0)))


def placebos_of(runs: FreeRuns, tuning: Tuning, screened: Sequence[Screened], residual: np.ndarray) -> Placebos:
    """Of the candidates, where this (M,) residual is left."""
    projection = Projection.of(tuning)
    left = projection.left_of_residual(residual)
    count = len(residual)
    kept: list[tuple[float, np.ndarray]] = []
    for candidate in screened:
        response = candidate.response[:count].astype(float)
        reverse = backwards(runs, response)
        placebo = projection.left(reverse)
        energy = float(placebo @ placebo)
        if energy < 1e-6 or abs(float(response @ reverse)) > SAME_BACKWARDS * float(response @ response):
            continue
        kept.append((float(placebo @ left) ** 2 / energy, reverse))
        kept = sorted(kept, key=lambda each: -each[0])[:KEPT]
    return Placebos(np.stack([response for _, response in kept])) if kept else NO_PLACEBOS


def backwards(runs: FreeRuns, whitened: np.ndarray) -> np.ndarray:
    """(M,) whitened training records, each run backwards: of the same spectrum."""
    groups = runs.sets[TRAIN].groups
    ends = np.cumsum([runs.noise.size(len(group.time_s)) for group in groups])[:-1]
    return np.concatenate([runs.noise.backwards(part) for part in np.split(whitened, ends)])
