"""Whether the right name's equation is exact, judged by what the best set leaves.

An equation that errs leaves something: of an energy whose mean is `form_error` of what is removed, and which is of one function of unknown
size (chi-squared of one degree of freedom), no more than what nobody tells from noise. Where the best set leaves that little in training
and held out, all is as it was beforehand where little is removed, and the more is removed the surer no equation erred. What is left above
noise for certain says nothing: the noise may be stronger there than its model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from hil.diagnosis.judging.errors_of_laws import LEAST_ERROR
from hil.diagnosis.residuals.excess import certain_excess

SAYS_ALL = 0.5
"""Of what nobody tells from noise: up to so much left says all that it can of exactness, from there on less, and at the whole nothing."""


class Part(NamedTuple):
    """Training or held-out recordings."""

    left: float  # |residual|^2 beside the best set
    before: float  # without effects
    noise: float  # expected of a perfect simulation; 0 where there are no recordings
    by_numbers: float = 0.0  # energy removed by numbers alone, in the best set or one of the file's numbers that is not told from it
    by_signs: float = 0.0  # so much of it whole signs, which err by nothing
    is_known: bool = True  # the noise, by repeats: where it is taken to be what the closest set leaves, that set leaves it whatever errs


def exactness(parts: Sequence[Part], beforehand: float, form_error: float) -> float:
    """Probability that equations are exact, from that beforehand, once it is known what the best set leaves.

    Training and held-out recordings are of one law: what is rarer in one of them counts, and not both.
    """
    known = [part for part in parts if part.noise > 0.0]
    most = max((_excess(part) for part in known), default=0.0)
    says = min(max((1.0 - most) / (1.0 - SAYS_ALL), 0.0), 1.0)
    rare = 1.0
    for part in known:
        errs = form_error * (part.before - part.noise - part.by_numbers)
        if errs > 0.0 and part.is_known:
            rare = min(rare, math.erf(math.sqrt(0.5 * certain_excess(part.noise) / errs)))
    return beforehand / (beforehand + (1.0 - beforehand) * rare**says)


def _excess(part: Part) -> float:
    """What is left above the noise, as a share of what nobody tells from noise."""
    return (part.left - part.noise) / certain_excess(part.noise)


def level_left(part: Part) -> float:
    """The noise's level beside exact equations: what the best set leaves over the noise, or LEAST_ERROR of what it removed, if that is
    more.
    """
    left = part.left / part.noise if part.noise > 0.0 else 1.0
    return max(left, 1.0 + LEAST_ERROR * max(part.before - part.left - part.by_signs, 0.0))
