"""How sure a name is: the evidence of every set of effects that was fitted, against each other, against nothing and against the unknown.

log evidence = -1/2 (|residual|^2 on training and held-out) / T - 1/2 k log(1 + g), k fitted parameters, g the energy the best set removes
over T: a parameter that is known to one part in sqrt(g) of itself costs the logarithm of that (MacKay 2003, ch. 28). A real effect never
has exactly the catalogue's equation: T > 1 grows with what even the best set leaves and with a fixed share of what it removes, so that two
names are told apart only where they differ by more than an equation's form usually errs. The unknown is charged with UNKNOWN_FREEDOM
parameters and leaves nothing above noise.

Whether equations err is not known: sets are weighed with T and, as sets that hold exactly, with T = 1, and both count, so that a name
stands alone only where both agree. What even the best set leaves above noise for certain, as a share of what there was to explain, is the
weight of something without a name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.gate import certain_excess
from hil.diagnosis.refit import Fitted

FORM_ERROR = 0.004
"""Share of the removed energy by which a right name's equation may err before it counts against the name."""

LEFT_WEIGHT = 0.02
"""The same for the energy the best set leaves above noise: where much is left, small differences between sets mean little."""

EXACT = 0.3
"""Probability that the right name's equation errs by nothing that these recordings show."""

UNKNOWN_FREEDOM = 8
"""Parameters that something without a name is charged with: it could explain whatever is above noise."""

CONFIDENT = 0.9
"""Confidence from which a name stands alone."""

CAP_ASSUMED = 0.9
"""Largest confidence without repeats: the noise, and with it every scale here, is assumed."""

CAP_UNCONFIRMED = 0.5
"""Largest confidence of a set that did not pass the gate."""

PLAUSIBLE = 0.04
"""A set at least this likely belongs to what cannot be told apart from the first."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """One hypothesis with its misfit on both parts. `fitted` None: nothing but the machine file's numbers."""

    fitted: Fitted | None
    train: float  # |residual|^2 + |offset|^2
    held_out: float  # |residual|^2; 0 without held-out recordings
    freedom: int
    confidence: float = 0.0

    @property
    def misfit(self) -> float:
        return self.train + self.held_out


def weighed(hypotheses: Sequence[Weighed], base: Weighed, noise: float, cap: float = 1.0) -> list[Weighed]:
    """Hypotheses with their confidence, the likeliest first.

    Parameters
    ----------
    hypotheses : sequence of Weighed
        Every set that passed its own fit.
    base : Weighed
        Without effects.
    noise : float
        Expected |residual|^2 of a perfect simulation.
    cap : float
        Largest confidence.
    """
    *shares, _ = _shares(hypotheses, base, noise, None)
    return _ranked(hypotheses, shares, cap)


def weighed_with_nothing(hypotheses: Sequence[Weighed], base: Weighed, noise: float, tried: int, cap: float = 1.0) -> list[Weighed]:
    """The same where no set passed the gate: nothing is one of the hypotheses, and each set is one of so many that were tried.

    Beforehand, nothing is as likely as all of them together; the best of many gains by chance what one alone does not.
    """
    shares = _shares(hypotheses, base, noise, float(np.log(max(tried, 1))))
    return _ranked([*hypotheses, base], shares, cap)


def _shares(hypotheses: Sequence[Weighed], base: Weighed, noise: float, prior: float | None) -> list[float]:
    """Of every set and, last, of nothing, which has a log prior before any of them; None: something is there for certain."""
    best = min(h.misfit for h in hypotheses)
    removed = base.misfit - best
    temper = temperature(removed, best - noise)
    price = price_of_a_parameter(removed, temper)
    unknown = -0.5 * min(noise, best) / temper - price * UNKNOWN_FREEDOM
    tempered = _normalised([*_evidence(hypotheses, base, temper, price, prior), unknown])[:-1]
    exact = _normalised(_evidence(hypotheses, base, 1.0, price_of_a_parameter(removed, 1.0), prior))
    return [float(share) for share in (1.0 - EXACT) * tempered + EXACT * exact]


def _evidence(hypotheses: Sequence[Weighed], base: Weighed, temper: float, price: float, prior: float | None) -> list[float]:
    nothing = -np.inf if prior is None else -0.5 * base.misfit / temper + prior
    return [*(-0.5 * h.misfit / temper - price * h.freedom for h in hypotheses), nothing]


def _normalised(evidence: Sequence[float]) -> np.ndarray:
    weights = np.exp(np.array(evidence) - max(evidence))
    return weights / weights.sum()


def unnamed_share(before: float, after: float, noise: float) -> float:
    """What a set of effects leaves above noise for certain, as a share of what was above noise before."""
    return float(np.clip((after - noise - certain_excess(noise)) / max(before - noise, 1e-9), 0.0, 1.0))


def _ranked(hypotheses: Sequence[Weighed], shares: Sequence[float], cap: float) -> list[Weighed]:
    found = [replace(h, confidence=min(share, cap)) for h, share in zip(hypotheses, shares, strict=True)]
    return sorted(found, key=lambda h: -h.confidence)


def price_of_a_parameter(removed: float, temper: float) -> float:
    """What a fitted parameter costs in log evidence."""
    return 0.5 * float(np.log1p(max(removed, 0.0) / temper))


def temperature(removed: float, left: float) -> float:
    """T, from the energies that the best set removes and leaves above noise."""
    return 1.0 + FORM_ERROR * max(removed, 0.0) + LEFT_WEIGHT * max(left, 0.0)
