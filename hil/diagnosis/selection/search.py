"""The search over sets of effects: laws are added while they predict better what is left out, and left out where they are not missed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.candidates.entries import Entry
from hil.diagnosis.likelihood.fitting import REACH, Fit, Fitting
from hil.diagnosis.likelihood.inverse import Inverse
from hil.diagnosis.likelihood.judge import PARTS
from hil.diagnosis.selection.candidates import Neighbours, added, alone_laws, equation_errors, library
from hil.diagnosis.unknowns.unknowns import Point
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

ROUNDS = 4
"""In which laws are added and left out."""
MOST_ALONE = 4
"""Laws that are tried each alone, where those that promise most together do not keep it."""
MOST_AT_ONCE = 6
"""Laws that are added together."""
TESTED = 3.0
"""Times what an effect must bring: one that promises to be missed by less is left out for a trial."""
SOON = 6
"""Steps after which a fit from the file's numbers has shown what it leads to."""
MATERIAL = 1.1
"""Factor by which errors must become smaller with an effect that is not everyday: laws are right to a tenth, and so is what is left of
them."""
WORTH = 3.0
"""Gain of log likelihood, by what was left out, that each parameter of an effect must bring: one in twenty by chance, where log likelihood
is as it says."""


class Search:
    """Sets of effects beside each other, by what each left out.

    Parameters
    ----------
    fitting : Fitting
    inverse : Inverse
        Along whose motion laws begin.
    say : callable
        Told what was tried.
    """

    def __init__(self, fitting: Fitting, inverse: Inverse, say: Callable[[str], None]) -> None:
        self.fitting, self.inverse, self.say = fitting, inverse, say
        self._folded: dict[int, tuple[Fit, list[Fit], np.ndarray]] = {}  # with its fit, so that an identity is one fit's
        self._material = float(np.sum(fitting.weights)) * math.log(MATERIAL)
        self._tried = 1

    def folded(self, fit: Fit) -> list[Fit]:
        """Return the fits without the windows of each fold, computed once."""
        if id(fit) not in self._folded:
            folded = self.fitting.folded(fit)
            self._folded[id(fit)] = fit, folded, self.fitting.scores(folded)
        return self._folded[id(fit)][1]

    def scores(self, fit: Fit) -> np.ndarray:
        """Return the negative log likelihood of each fold that was left out."""
        self.folded(fit)
        return self._folded[id(fit)][2]

    def score(self, fit: Fit) -> float:
        """Return that of all windows, each left out twice."""
        return float(self.scores(fit).sum()) / 2.0

    def is_better(self, one: Fit, other: Fit, worth: float) -> bool:
        """Return whether a fit predicts better than another, by so much and by more than stretches, and places, differ about it."""
        gains = (self.scores(other) - self.scores(one)).reshape(-1, PARTS)
        return all(each.sum() > max(worth, float(np.sqrt(PARTS) * each.std(ddof=1))) for each in gains)

    def worth(self, settings: Sequence[EffectSetting]) -> float:
        """Return the gain of log likelihood that effects must bring: their parameters' worth; of those that are not everyday, more.

        They were chosen among many, and must be material.
        """
        parameters = sum(not parameter.fixed for each in settings for parameter in effects()[each.name].parameters)
        further = sum(not effects()[each.name].everyday for each in settings)
        price = WORTH * parameters + further * math.log(self._tried)
        return max(price, self._material) if further else price

    def neighbours(self, fit: Fit, laws: Sequence[tuple[Entry, np.ndarray]]) -> Neighbours:
        """Return sets near a fitted one, with all numbers free: one that others stand in for may stand in for an effect."""
        freed = replace(fit, point=replace(fit.point, held=frozenset()), slopes=None)
        return Neighbours(equation_errors(self.fitting, freed, laws), freed.point.room(self.fitting.unknowns, REACH))

    def best(self, starts: Sequence[Fit]) -> Fit:
        """Add laws that predict better what is left out, leave out those that are not missed, until nothing changes.

        It begins from the first set, or from the best of the others where that predicts better, as much as laws must.
        """
        best, *others = starts
        other = min(others, key=self.score, default=best)
        further = [each for each in other.point.settings if (each.name, each.at) not in best.point.names]
        if other is not best and self.is_better(other, best, self.worth(further)):
            best = other
        best = self.without_needless(best)
        for _ in range(ROUNDS):
            longer = self.with_further(best)
            longer = best if longer is best else self.without_needless(longer)
            if longer.point.names == best.point.names or not self.is_better(longer, best, 0.0):
                return best
            best = longer
        return best

    def from_the_file(self, start: Point, baseline: Fit) -> list[Fit]:
        """Return fits with the laws that promise most beside the file's numbers: numbers that are bent to what a law explains hide it.

        Only those are fitted to the end that are soon better than the baseline.
        """
        (here,) = self.fitting.at([self.fitting.based(start)])
        if here is None:
            return []
        everything = library(self.inverse, self.fitting.unknowns.machine(start))
        self._tried = len(everything)
        of = equation_errors(self.fitting, here, everything)
        laws = alone_laws(of, here.point.room(self.fitting.unknowns, REACH), self._material, MOST_ALONE)
        found = []
        for law, weights in laws:
            point = replace(here.point, settings=(*here.point.settings, law.setting(weights)))
            soon = self.fitting.fit(self.fitting.based(point), SOON)
            if soon is not None and soon.cost < baseline.cost and (fit := self.fitting.fit(soon.point)) is not None:
                self.say(f"from the file: {law.effect.name} at {law.at}, score {self.score(fit) - self.score(baseline):.1f}")
                found.append(fit)
        return found

    def with_further(self, fit: Fit) -> Fit:
        """Return the fit with laws that promise most: all that do, or else the best of the first few alone."""
        laws = library(self.inverse, self.fitting.unknowns.machine(fit.point))
        self._tried = len(laws)
        of = equation_errors(self.fitting, fit, laws)
        room = fit.point.room(self.fitting.unknowns, REACH)
        found = added(of, room, self._material, MOST_AT_ONCE)
        self.say("promising: " + ", ".join(f"{law.effect.name}@{law.at} {gain:.1f}" for law, _, gain in found))
        if len(found) > 1 and (longer := self._longer(fit, [(law, weights) for law, weights, _ in found])) is not None:
            return longer
        alone = [self._longer(fit, [each]) for each in alone_laws(of, room, self._material, MOST_ALONE)]
        return min((each for each in alone if each is not None), key=self.score, default=fit)

    def _longer(self, fit: Fit, laws: Sequence[tuple[Entry, np.ndarray]]) -> Fit | None:
        """Return the fit with further laws; None where it does not predict better what is left out, by as much as laws must."""
        settings = (*fit.point.settings, *(law.setting(weights) for law, weights in laws))
        longer = self.fitting.fit(self.fitting.based(replace(fit.point, settings=settings)))
        if longer is None:
            return None
        self.say(f"  with {', '.join(law.effect.name for law, _ in laws)}: score {self.score(longer) - self.score(fit):.1f}")
        return longer if self.is_better(longer, fit, self.worth(longer.point.settings[len(fit.point.settings) :])) else None

    def without_needless(self, fit: Fit) -> Fit:
        """Return the fit without the laws that what is left out does not miss."""
        while fit.point.settings:
            settings = fit.point.settings
            near = self.neighbours(fit, [])
            losses = np.array([near.lost(k) / self.worth([each]) for k, each in enumerate(settings)])
            least = int(np.argmin(losses))
            if losses[least] > TESTED:
                return fit
            sparer = self.fitting.fit(self.fitting.based(replace(fit.point, settings=(*settings[:least], *settings[least + 1 :]))))
            if sparer is None or self.is_better(fit, sparer, self.worth([settings[least]])):
                return fit
            gone = f"{settings[least].name} at {settings[least].at}"
            self.say(f"  without {gone}: foretold {losses[least]:.1f}, score {self.score(sparer) - self.score(fit):.1f}")
            fit = sparer
        return fit
