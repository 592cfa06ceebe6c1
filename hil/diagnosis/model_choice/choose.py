"""From recordings to ranked sets of effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.free_runs.runs import FreeRuns
from hil.diagnosis.model_choice.convergence import LONGEST, converged
from hil.diagnosis.model_choice.covariance import away_from
from hil.diagnosis.model_choice.cross_validation import STEADY, cross_validated, slow_view, steady
from hil.diagnosis.model_choice.everyday import everyday_effects
from hil.diagnosis.model_choice.fitting import NOISE_MARGIN, Fitted, fit
from hil.diagnosis.model_choice.free_run_fit import fit_to
from hil.diagnosis.model_choice.noise_matching import matched
from hil.diagnosis.model_choice.search import Library, Ranked, library, search
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.residuals import Residuals
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.retuning.linear_model import LinearModel, linear_at, nominal_offset

ROUNDS = 3
"""Searches: once the best set is known the machine is seen with it, and what is missing beside it shows."""
MATERIAL = 1.1
"""Factor by which what is left must be less with an effect that is not everyday, where noise is not known from repeats: laws are right to a
tenth, and so is what is left of them."""


@dataclass(frozen=True, eq=False)
class Choice:
    """What was seen in recordings, and the sets of effects that explain it.

    Attributes
    ----------
    residuals : Residuals
    levels : Levels
        As strong as makes what the engineer's first fit leaves of the size that they say, where they are assumed.
    view : Levels
        By which the answer was judged: those, or with weaker disturbances where they are assumed.
    plain : Fitted
        Numbers alone.
    linear : LinearModel or FreeRuns
        The machine where it was last seen, in that view: its numbers are those of `best`.
    baseline : Fitted
        With the everyday effects at every driven joint.
    ranked : tuple of Ranked
        The likeliest set first, as far as fast misfits count.
    best : Fitted
        The set that predicts: the likeliest one, where noise is known from repeats.
    sets : tuple of (LinearModel, Fitted)
        Sets that free runs may decide between, that one first.
    of : Library or None
        That the sets were sought in, where it is of this machine.
    """

    residuals: Residuals
    levels: Levels
    view: Levels
    plain: Fitted
    linear: LinearModel | FreeRuns
    baseline: Fitted
    ranked: tuple[Ranked, ...]
    best: Fitted
    sets: tuple[tuple[LinearModel | FreeRuns, Fitted], ...]
    of: Library | None

    @cached_property
    def without_effects(self) -> Fitted | None:
        """The answer's numbers fitted alone; None where the machine cannot run without its effects."""
        return fit_to(self.linear, (), self.best.offset, self.best.dispersion)

    @property
    def is_noise_known(self) -> bool:
        """Whether the noise by which the answer was judged is known from repeats."""
        return self.residuals.noise != "assumed"

    @property
    def materiality(self) -> float:
        """Factor by which what is left must be less with an effect that is not everyday."""
        return 1.0 if self.is_noise_known else MATERIAL


def choose_effects(
    residuals: Residuals,
    free: FreeRuns | None = None,
    report: Callable[[str, float], None] = lambda what, share: None,
    first: Callable[[Fitted], None] = lambda baseline: None,
) -> Choice:
    """Name the effects that a machine's simulation lacks.

    Parameters
    ----------
    residuals : Residuals
    free : FreeRuns, optional
        By which sets are judged.
    report : callable, optional
        Told what is being done, and the share of the whole that is done.
    first : callable, optional
        Told the engineer's first fit as soon as there is one.
    """
    if free is not None:
        return _chosen_freely(residuals, free, report, first)
    trajectories = residuals.trajectories
    report("fitting numbers and friction", 0.1)
    levels, with_friction, baseline = engineers_fit(residuals)
    first(baseline)
    report("fitting numbers alone", 0.25)
    linear, plain = converged(trajectories, levels, nominal_offset(trajectories))
    begun = fit(linear, baseline.settings, baseline.offset, plain.dispersion)
    assert begun is not None
    starts = [(linear, begun), (with_friction, baseline)]
    dispersion = baseline.dispersion
    if baseline.cost(dispersion) + len(baseline.parameters) * math.log(linear.readings) < plain.cost(dispersion):
        starts.reverse()
    of: Library | None
    linear, best, ranked, of = _searched(trajectories, levels, *starts[0], report)
    if not levels.are_assumed and best.squares > (1.0 + NOISE_MARGIN) * linear.readings:  # the search may have ended where it began badly
        other = _searched(trajectories, levels, *starts[1], report)
        if other[1].squares < best.squares:
            linear, best, ranked, of = other
    view = levels
    sets: list[tuple[LinearModel | FreeRuns, Fitted]] = [(linear, best)]
    if levels.are_assumed:
        report("predicting what was left out", 0.75)
        of = None  # of another view: it would fill the memory
        view = slow_view(trajectories, levels)
        sets = [*cross_validated(trajectories, view, best.offset, best.settings, baseline.settings)]
    elif (kept := steady(residuals, best)) is not None:
        sets = [kept]
    last, best = sets[0]
    of = of if of is not None and of.linear is last else None
    return Choice(residuals, levels, view, plain, last, baseline, tuple(ranked), best, tuple(sets), of)


def engineers_fit(residuals: Residuals) -> tuple[Levels, LinearModel, Fitted]:
    """Return numbers and everyday effects at every driven joint fitted together, the machine with them, and the levels of what scatters."""
    trajectories, levels = residuals.trajectories, residuals.levels
    with_friction, baseline = converged(trajectories, levels, nominal_offset(trajectories), everyday_effects(trajectories[0]))
    if levels.are_assumed:
        levels = matched(levels, with_friction, baseline)
        with_friction, baseline = converged(trajectories, levels, baseline.offset, baseline.settings)
    return levels, with_friction, baseline


def _chosen_freely(residuals: Residuals, free: FreeRuns, report: Callable[[str, float], None], first: Callable[[Fitted], None]) -> Choice:
    """Name what a simulation lacks by free runs of the closed loop."""
    report("fitting numbers alone", 0.1)
    plain = fit_to(free, ())
    assert plain is not None
    free = free.about(residuals.trajectories, (plain.offset, ()), plain.columns)
    report("fitting numbers and friction", 0.2)
    baseline = fit_to(free, everyday_effects(residuals.trajectories[0]), plain.offset, plain.dispersion, plain) or plain
    first(baseline)
    is_better = baseline.cost(plain.dispersion) + len(baseline.parameters) * math.log(free.readings) < plain.cost(plain.dispersion)
    best, of = (baseline if is_better else plain), None
    for turn in range(ROUNDS):
        report("searching", 0.3 + 0.6 * turn / ROUNDS)
        everything = replace(free, are_shown=np.ones_like(free.are_shown))
        best = fit_to(everything, best.settings, best.offset, best.dispersion) or best
        free = free.about(residuals.trajectories, (best.offset, best.settings), best.columns)
        of = library(free, best, of)
        ranked = search(free, of, best if turn else baseline)
        is_converged = ranked[0].fitted.names == best.names
        best = ranked[0].fitted
        if is_converged:
            break
    if (kept := steady(residuals, best, free)) is not None:
        _, best = kept
    best = _agreed(residuals, free, best)
    return Choice(residuals, residuals.levels, residuals.levels, plain, free, baseline, tuple(ranked), best, ((free, best),), of)


def _agreed(residuals: Residuals, free: FreeRuns, best: Fitted) -> Fitted:
    """Return the fit without effects that the recorded motion speaks against: there none is STEADY deviations likelier than their strength.

    What is wrong in free runs is not wrong along the motion, and the other way round.
    """
    while best.settings:
        linear = linear_at(residuals.trajectories, residuals.levels, best.offset, best.settings)
        there = fit(linear, best.settings, best.offset, longest=LONGEST)
        if there is None:
            return best
        strengths = [setting.parameters for setting in best.settings]
        against = [away_from(there, number, strengths[number]) - away_from(there, number) for number in range(len(strengths))]
        worst = int(np.argmax(against))
        if against[worst] < STEADY**2:
            return best
        kept = (*best.settings[:worst], *best.settings[worst + 1 :])
        sparer = fit_to(free, kept, best.offset, best.dispersion)
        if sparer is None:
            return best
        best = sparer
    return best


def _searched(
    trajectories: Sequence[Trajectory], levels: Levels, linear: LinearModel, best: Fitted, report: Callable[[str, float], None]
) -> tuple[LinearModel, Fitted, list[Ranked], Library]:
    """Return the machine, the fit and all sets where the search from a machine and a fit ends, and what it was among."""
    for turn in range(ROUNDS):
        report("searching", 0.35 + 0.4 * turn / ROUNDS)
        of = library(linear, best)
        ranked = search(linear, of, best, MATERIAL if levels.are_assumed else 1.0)
        is_converged = ranked[0].fitted.names == best.names
        best = ranked[0].fitted
        if is_converged:
            break
        linear, best = converged(trajectories, levels, best.offset, best.settings)
    return linear, best, ranked, of
