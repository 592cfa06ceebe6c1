"""Every effect at every place tried once, and the few that a fit is worth.

Each candidate's free run at its start values less the re-tuned one is its response; what re-tuning could imitate is projected out, and the
residual's energy along the rest is its score (a matched filter; Kay 1998, ch. 4). A strength that the filter finds far from the start's is
tried again there, because few effects are linear in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.candidates import Candidate
from hil.diagnosis.free_run import FreeRuns, Trial
from hil.diagnosis.projection import Projection
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import Tuning
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

RESCALED_BEYOND = 1.5
"""A strength that the filter wants changed by more than this factor is tried again."""

LARGEST_RESCALE = 30.0

NONLINEAR_STRENGTH = ("imax", "fc", "b", "q", "sign", "share", "K", "D")
"""Parameters whose effect is not in proportion to them: a factor on the response says nothing about them."""


@dataclass(frozen=True, eq=False)
class Screened:
    """The best start of one candidate.

    `response` (M + F,) is what it adds to the simulation and re-tuning cannot imitate; `score` the share of the residual's energy along it,
    in units of noise: chi-squared with one degree of freedom where there is nothing.
    """

    effect: EffectAt
    values: np.ndarray
    response: np.ndarray
    score: float


def screen(
    runs: FreeRuns, tuning: Tuning, found: Sequence[Candidate], residual: np.ndarray, present: tuple[EffectSetting, ...] = ()
) -> list[Screened]:
    """Try all candidates beside the effects that are `present`; the best first.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Linearised with the present effects.
    found : sequence of Candidate
    residual : (M,) array
        Of the training groups, with the present effects.
    present : tuple of EffectSetting
    """
    projection = Projection.of(tuning)
    left = projection.left_of_residual(residual)
    tries = [(candidate, start) for candidate in found for start in candidate.starts]
    best: dict[EffectAt, Screened] = {}
    for _ in range(2):
        answers = runs.run([Trial(tuning.values, (*present, candidate.setting(values))) for candidate, values in tries])
        again = []
        for (candidate, values), answer in zip(tries, answers, strict=True):
            if answer is None:
                again.append((candidate, _rescaled(candidate.effect, values, 0.2)))
                continue
            response = projection.left(answer - tuning.predicted)
            energy = float(response @ response)
            amplitude = float(response @ left) / energy if energy > 0.0 else 0.0
            score = max(amplitude, 0.0) ** 2 * energy
            known = best.get(candidate.effect)
            if known is None or score > known.score:
                best[candidate.effect] = Screened(candidate.effect, values, response.astype(np.float32), score)
            if amplitude > 0.0 and not 1.0 / RESCALED_BEYOND < amplitude < RESCALED_BEYOND:
                again.append((candidate, _rescaled(candidate.effect, values, amplitude)))
            elif amplitude < 0.0 and (flipped := _flipped(candidate.effect, values, -amplitude)) is not None:
                again.append((candidate, flipped))
        tries = [(candidate, values) for candidate, values in again if values is not None]
    return sorted(best.values(), key=lambda screened: -screened.score)


def _rescaled(effect: EffectAt, values: np.ndarray, factor: float) -> np.ndarray | None:
    """All strengths that enter in proportion, by this factor; None where there is none."""
    parameters = effects()[effect.effect].parameters
    scaled = [p.is_strength and p.name not in NONLINEAR_STRENGTH for p in parameters]
    if not any(scaled):
        return None
    factor = float(np.clip(factor, 1.0 / LARGEST_RESCALE, LARGEST_RESCALE))
    low, high = (np.array([getattr(p, end) for p in parameters]) for end in ("low", "high"))
    return np.clip(np.where(scaled, values * factor, values), low, high)


def _flipped(effect: EffectAt, values: np.ndarray, factor: float) -> np.ndarray | None:
    """The same effect with the opposite sign, where its strengths may have it or a phase gives it."""
    parameters = effects()[effect.effect].parameters
    phases = [k for k, p in enumerate(parameters) if p.unit == "phase" and not p.is_strength]
    signed = [k for k, p in enumerate(parameters) if p.is_strength and p.low < 0.0]
    scaled = _rescaled(effect, values, factor)
    if scaled is None or not (phases or signed):
        return None
    if signed:
        scaled[signed] *= -1.0
    else:
        scaled[phases] = (scaled[phases] + 2.0 * np.pi) % (2.0 * np.pi) - np.pi
    return scaled
