"""Which sets of effects are worth weighing: the best candidates singly, then added to the best set as long as each is there for certain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.candidates import Candidate
from hil.diagnosis.free_run import FreeRuns, Trial
from hil.diagnosis.gate import Gate, held_out_deviations, needed_gain, placebo_gain, strength_scatter
from hil.diagnosis.projection import Projection
from hil.diagnosis.refit import Fitted, refit
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import Tuning
from hil.diagnosis.screening import Screened, screen

REFITTED = 8
"""Candidates refitted after the first screening."""

REFITTED_BESIDE = 5
"""Candidates refitted beside effects that were found already."""

MOST_EFFECTS = 3
WORTH_A_FIT = 0.02
"""Of the best score: candidates below are not refitted."""

Report = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Selection:
    """Sets of effects that were fitted, and the chosen one.

    Attributes
    ----------
    chosen : Fitted or None
        The largest set whose effects all pass the gate; None where not even one does.
    gates : tuple of Gate
        Of each step of the chosen set, and of the step that ended it, last.
    hypotheses : tuple of Fitted
        Sets as large as the chosen one that were fitted, the chosen one among them.
    screened : tuple of Screened
        The first screening.
    """

    chosen: Fitted | None
    gates: tuple[Gate, ...]
    hypotheses: tuple[Fitted, ...]
    screened: tuple[Screened, ...]


def select(
    runs: FreeRuns,
    tuning: Tuning,
    noise_energy: float,
    candidates_of: Callable[[Fitted | None], Sequence[Candidate]],
    report: Report,
) -> Selection:
    """Add effects one at a time.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    noise_energy : float
        Expected |residual|^2 of a perfect simulation.
    candidates_of : callable
        Candidates with start values, given the effects found so far.
    report : callable
        Told what is being done, and how far the whole is.
    """
    measured = runs.measured()
    chosen: Fitted | None = None
    gates: list[Gate] = []
    hypotheses: tuple[Fitted, ...] = ()
    first: list[Screened] = []
    present = tuning
    for size in range(MOST_EFFECTS):
        report("screening" if size == 0 else f"screening beside {size}", 0.25 + 0.2 * size)
        settings = chosen.settings if chosen is not None else ()
        taken = set(chosen.effects) if chosen is not None else set()
        found = [candidate for candidate in candidates_of(chosen) if candidate.effect not in taken]
        residual = measured - present.predicted
        screened = screen(runs, present, found, residual, settings)
        if size == 0:
            first = screened
        if not screened:
            break
        most = REFITTED if size == 0 else REFITTED_BESIDE
        worth = [s for s in screened[:most] if s.score > WORTH_A_FIT * screened[0].score]
        report("fitting", 0.35 + 0.2 * size)
        starts = [_beside(chosen, s) for s in worth]
        fits = [fit for fit in refit(runs, present, measured, starts) if fit is not None]
        if not fits:
            break
        fits.sort(key=lambda fit: fit.cost + fit.freedom * np.log(len(measured)))
        gate = _gate(runs, present, chosen, fits[0], screened, residual, noise_energy, len(found))
        gates.append(gate)
        if not gate.passed:
            break
        chosen, hypotheses = fits[0], tuple(fits)
        present = replace(tuning, offset=chosen.offset, values=tuning.at(chosen.offset), predicted=chosen.predicted)
    return Selection(chosen, tuple(gates), hypotheses, tuple(first))


def _beside(chosen: Fitted | None, added: Screened) -> tuple[tuple[EffectAt, ...], tuple[np.ndarray, ...]]:
    if chosen is None:
        return (added.effect,), (added.values,)
    return (*chosen.effects, added.effect), (*chosen.values, added.values)


def _gate(
    runs: FreeRuns,
    present: Tuning,
    before: Fitted | None,
    after: Fitted,
    screened: Sequence[Screened],
    residual: np.ndarray,
    noise_energy: float,
    tried: int,
) -> Gate:
    cost = float(residual @ residual + present.offset @ present.offset)
    gain = cost - after.cost
    projection = Projection.of(present)
    settings = before.settings if before is not None else ()
    without, extended = Trial(present.values, settings), Trial(present.at(after.offset), after.settings)
    explainable = max(cost - noise_energy, gain, 1e-9)
    return Gate(
        gain=gain,
        needed=needed_gain(tried, after.freedom - (before.freedom if before is not None else 0)),
        scatter=strength_scatter(runs, projection, after.predicted - present.predicted),
        held_out_deviations=held_out_deviations(runs, without, extended),
        placebo_gain=placebo_gain(runs, present, screened, residual),
        share=gain / explainable,
    )
