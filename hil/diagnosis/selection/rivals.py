"""What an answer of free runs stands on: what each effect brings, and which law might act in its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.candidates.entries import Entry
from hil.diagnosis.likelihood.fitting import REACH, Fit
from hil.diagnosis.likelihood.judge import BLOCKS
from hil.diagnosis.selection.candidates import Beside, alone_laws, beside, library
from hil.diagnosis.selection.search import Search

MOST = 3
"""Other laws that are fitted in place of an effect."""


@dataclass(frozen=True, eq=False)
class Rival:
    """A machine that has not one effect of the answer's.

    Attributes
    ----------
    fit : Fit
    without : int
        Which effect.
    has_another : bool
        Whether its last effect stands in its place.
    behind : float
        How far it is behind the answer, in twice the log likelihood of what was left out; negative where it predicts better.
    """

    fit: Fit
    without: int
    has_another: bool
    behind: float


def behind(search: Search, one: Fit, answer: Fit) -> float:
    """Return how far a fit is behind the answer: by stretches or by places that were left out, whichever tells less."""
    gains = (search.scores(one) - search.scores(answer)).reshape(-1, BLOCKS).sum(axis=1)
    return 2.0 * float(min(gains, key=abs))


def rivals(search: Search, answer: Fit) -> tuple[tuple[int, ...], tuple[Rival, ...]]:
    """Return which effects of an answer are missed without them, and those of its rivals that lack one of these."""
    named, found = [], []
    for number, setting in enumerate(answer.point.settings):
        settings = tuple(each for k, each in enumerate(answer.point.settings) if k != number)
        sparer = search.fitting.fit(search.fitting.based(replace(answer.point, settings=settings)))
        if sparer is None:
            named.append(number)
            continue
        if not search.is_better(answer, sparer, search.worth([setting])):
            continue
        named.append(number)
        found.append(Rival(sparer, number, False, behind(search, sparer, answer)))
        laws = library(search.inverse, search.fitting.unknowns.machine(sparer.point))
        of = beside(search.fitting, sparer, laws)
        for law, weights in alone_laws(of, sparer.point.room(search.fitting.unknowns, REACH), 0.0, MOST + 1):
            if (law.effect.name, law.at) == (setting.name, setting.at):
                continue
            point = replace(sparer.point, settings=(*settings, law.setting(weights)))
            other = search.fitting.fit(search.fitting.based(point))
            if other is not None:
                found.append(Rival(other, number, True, behind(search, other, answer)))
    return tuple(named), tuple(sorted(found, key=lambda each: each.behind))


def shown(of: Beside) -> list[tuple[Entry, np.ndarray]]:
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
