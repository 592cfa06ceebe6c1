"""What an answer of free runs stands on: what each effect brings, and which law might act in its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.candidates.entries import Entry
from hil.diagnosis.likelihood.fitting import Fit
from hil.diagnosis.likelihood.judge import PARTS
from hil.diagnosis.model_choice.search import NOT_TOLD_APART
from hil.diagnosis.selection.candidates import EquationErrors, Neighbours, library
from hil.diagnosis.selection.search import TESTED, Search
from virtual_bus.settings import EffectSetting

MOST = 3
"""Other laws that are fitted in place of an effect."""


@dataclass(frozen=True, eq=False)
class Rival:
    """A machine that has not one effect of the answer's.

    Attributes
    ----------
    settings : tuple of EffectSetting
    without : int
        Which effect.
    has_another : bool
        Whether its last effect stands in its place.
    behind : float
        How far it is behind the answer, in twice the log likelihood of what was left out; negative where it predicts better.
    parameters : int
    fit : Fit or None
        None where it is foretold to be far behind, and was not fitted.
    """

    settings: tuple[EffectSetting, ...]
    without: int
    has_another: bool
    behind: float
    parameters: int
    fit: Fit | None = None


def behind(search: Search, one: Fit, answer: Fit) -> float:
    """Return how far a fit is behind the answer: by stretches or by places that were left out, whichever tells less."""
    gains = (search.scores(one) - search.scores(answer)).reshape(-1, PARTS).sum(axis=1)
    return 2.0 * float(min(gains, key=abs))


def around(search: Search, answer: Fit) -> Neighbours:
    """Return an answer with the laws of all effects at all places beside it, or in place of its own."""
    return search.neighbours(answer, library(search.inverse, search.fitting.unknowns.machine(answer.point)))


def rivals(search: Search, answer: Fit, near: Neighbours) -> tuple[tuple[int, ...], tuple[Rival, ...]]:
    """Return which effects of an answer are missed without them, and rivals that lack one of these.

    What is foretold to be far behind is not fitted.
    """
    accepted, found = [], []
    for number, setting in enumerate(answer.point.settings):
        kept = tuple(each for k, each in enumerate(answer.point.settings) if k != number)
        worth = search.worth([setting])
        foretold = 2.0 * near.lost(number)
        sparer: Fit | None = None
        if foretold < 2.0 * TESTED * worth:
            sparer = search.fitting.fit(search.fitting.based(replace(answer.point, settings=kept)))
            if sparer is not None and not search.is_better(answer, sparer, worth):
                continue
        accepted.append(number)
        lost = foretold if sparer is None else behind(search, sparer, answer)
        parameters = len(answer.point.parameters) - sum(k == number for k, _ in answer.point.parameters)
        found.append(Rival(kept, number, False, lost, parameters, sparer))
        for law, weights, lag in near.others(number)[:MOST]:
            if (law.effect.name, law.at) == (setting.name, setting.at):
                continue
            its = (*kept, law.setting(weights))
            fit = None
            if 2.0 * lag < TESTED * NOT_TOLD_APART:
                fit = search.fitting.fit(search.fitting.based(replace(answer.point, settings=its)))
            if fit is not None:
                found.append(Rival(fit.point.settings, number, True, behind(search, fit, answer), len(fit.point.parameters), fit))
            elif 2.0 * lag >= TESTED * NOT_TOLD_APART:
                found.append(Rival(its, number, True, 2.0 * lag, parameters + len(weights)))
    return tuple(accepted), tuple(sorted(found, key=lambda each: each.behind))


def shown(of: EquationErrors) -> list[tuple[Entry, np.ndarray]]:
    """Return what log likelihood gains with a law beside an answer: squares (w, w) of its weights, without what other numbers would do."""
    squares = of.squares.sum(axis=0)
    own = squares[: of.own, : of.own] + np.diag(np.full(of.own, 1e-300))
    found = []
    for law, part in zip(of.laws, of.parts, strict=True):
        across = squares[: of.own, part]
        left = squares[part, part] - across.T @ np.linalg.lstsq(own, across, rcond=1e-9)[0]
        units = of.sizes[part.start - of.own : part.stop - of.own]
        found.append((law, left / np.outer(units, units)))
    return found


def parameters_of(fit: Fit) -> Sequence[str]:
    """Return what is fitted, for its columns."""
    settings = fit.point.settings
    return [f"{settings[k].name} at {settings[k].at}: {parameter.name}" for k, parameter in fit.point.parameters]
