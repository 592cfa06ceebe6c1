"""Whether the right name's equation is exact, judged by what the best set leaves.

An equation that errs leaves something: of an energy whose mean is `form_error` of what is removed, and which is of one function of unknown
size (chi-squared of one degree of freedom), no more than what nobody tells from noise. Where the best set leaves that little in training
and held out, all is as it was beforehand where little is removed, and the more is removed the surer no equation erred.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from hil.diagnosis.gate import certain_excess

LEAST_ERROR = 3e-6
"""Share of the energy removed by which an equation errs however exact it is: 0.17 % of its response, in ways that none of its error
functions spans. Beside a drive's lag of 3390 deviations a clock's offset gained 41.8, beside a clipped current of 16 360 one gained 731,
with nothing else there (5527, 5197, spent); beside a gear's error that was not found, of 18.7 deviations, a viscous friction of 27 840 was
an asymmetric one by 477 (5758, spent)."""


class Part(NamedTuple):
    """Training or held-out recordings."""

    left: float  # |residual|^2 beside the best set
    before: float  # without effects
    noise: float  # expected of a perfect simulation; 0 where there are no recordings
    by_numbers: float = 0.0  # energy that effects removed of which numbers alone are unknown


def exactness(parts: Sequence[Part], beforehand: float, form_error: float) -> float:
    """Probability that equations are exact, from that beforehand, once it is known what the best set leaves.

    Training and held-out recordings are of one law: what is rarer in one of them counts, and not both.
    """
    known = [part for part in parts if part.noise > 0.0]
    if any(part.left - part.noise > certain_excess(part.noise) for part in known):
        return beforehand
    rare = 1.0
    for part in known:
        errs = form_error * (part.before - part.noise - part.by_numbers)
        if errs > 0.0:
            rare = min(rare, math.erf(math.sqrt(0.5 * certain_excess(part.noise) / errs)))
    return beforehand / (beforehand + (1.0 - beforehand) * rare)


def level_left(part: Part) -> float:
    """The noise's level beside exact equations: what the best set leaves over the noise, or LEAST_ERROR of what it removed, if that is
    more.
    """
    left = part.left / part.noise if part.noise > 0.0 else 1.0
    return max(left, 1.0 + LEAST_ERROR * max(part.before - part.left, 0.0))
