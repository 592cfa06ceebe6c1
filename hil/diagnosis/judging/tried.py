"""What a search has tried: how many sets, each in how many shapes, could have gained as much by chance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import Candidate
from virtual_bus.effects.registry import effects

SEARCHED_TERM = {"encoder_eccentricity": "b"}
"""Strength of the term of a law whose order was searched, of laws that have a term of a known order too."""


class Tried:
    """Candidates that were tried, with the number of shapes that were searched for each, and for those of the steps before."""

    def __init__(self, candidates: Sequence[Candidate], *earlier: Tried | None) -> None:
        before = [tried for tried in earlier if tried is not None]
        self.count = len(candidates)
        self.first: int = before[0].first if before else self.count
        self.shapes: Mapping[EffectAt, float] = {
            **{effect: shapes for tried in before for effect, shapes in tried.shapes.items()},
            **{candidate.effect: candidate.shapes for candidate in candidates},
        }

    def sets(self, added: Sequence[EffectAt]) -> float:
        """Sets of so many effects among the candidates, each in all its shapes."""
        return math.comb(max(self.count, len(added)), len(added)) * math.exp(self._shapes(added))

    def searched(self, effects: Sequence[EffectAt]) -> float:
        """What a set costs in log evidence beyond a single effect of one shape: the logarithm of how many shapes it had, and of how many
        sets of its size there were to choose from for each single effect.
        """
        return self._shapes(effects) + math.log(math.comb(max(self.first, len(effects)), len(effects)) / self.first)

    def searched_for(self, fitted: Fitted) -> float:
        """The same of a fitted set. A term that was searched, beside one of its law that was not, costs no more than the training
        recordings would lose without it: what it was fitted to nothing for is the law without that term, which nobody searched. That loss
        is an upper bound: in log evidence at a temperature of 1 (the ranking divides by its own, which is larger where equations err), and
        of the term's whole response, with what the machine's numbers and the law's other term would imitate of it.
        """
        return self.searched(fitted.effects) - sum(self._not_needed(fitted, number) for number in range(len(fitted.effects)))

    def _not_needed(self, fitted: Fitted, number: int) -> float:
        """Of what the search of an effect's shape costs, how much more that is than what its term does."""
        effect = fitted.effects[number]
        if effect.effect not in SEARCHED_TERM:
            return 0.0
        term = [parameter.name for parameter in effects()[effect.effect].parameters].index(SEARCHED_TERM[effect.effect])
        does = fitted.values[number][term] * fitted.jacobian[:, fitted.free.index((number, term))]
        return max(math.log(self.shapes[effect]) - 0.5 * float(does @ does), 0.0)

    def _shapes(self, effects: Sequence[EffectAt]) -> float:
        return sum(math.log(self.shapes[effect]) for effect in effects)
