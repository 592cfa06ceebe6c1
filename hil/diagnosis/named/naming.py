"""From recordings to ranked sets of effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.free_runs.runs import FreeRuns
from hil.diagnosis.named.covariance import away_from
from hil.diagnosis.named.everyday import everyday_effects
from hil.diagnosis.named.fitting import LEVEL, Fitted, fit
from hil.diagnosis.named.freely import fit_to
from hil.diagnosis.named.matching import matched
from hil.diagnosis.named.proving import STEADY, proved, slow_view, steady
from hil.diagnosis.named.search import Library, Ranked, library, search
from hil.diagnosis.named.settling import LONGEST, settled
from hil.diagnosis.seen.along import Along
from hil.diagnosis.seen.beside import Levels
from hil.diagnosis.seen.see import Seen
from hil.diagnosis.tuned.retuning import Tuned, nominal_offset, tuned_at

ROUNDS = 3
"""Searches: once the best set is known the machine is seen with it, and what is missing beside it shows."""
MATERIAL = 1.1
"""Factor by which what is left must be less with an effect that is not everyday, where noise is not known from repeats: laws are right to a
tenth, and so is what is left of them."""


@dataclass(frozen=True, eq=False)
class Named:
    """What was seen in recordings, and the sets of effects that explain it.

    Attributes
    ----------
    seen : Seen
    levels : Levels
        As strong as makes what the engineer's first fit leaves of the size that they say, where they are assumed.
    view : Levels
        By which the answer was judged: those, or with weaker disturbances where they are assumed.
    plain : Fitted
        Numbers alone.
    tuned : Tuned or FreeRuns
        The machine where it was last seen, in that view: its numbers are those of `best`.
    baseline : Fitted
        With the everyday effects at every driven joint.
    ranked : tuple of Ranked
        The likeliest set first, as far as fast misfits count.
    best : Fitted
        The set that predicts: the likeliest one, where noise is known from repeats.
    sets : tuple of (Tuned, Fitted)
        Sets that free runs may decide between, that one first.
    of : Library or None
        That the sets were sought in, where it is of this machine.
    """

    seen: Seen
    levels: Levels
    view: Levels
    plain: Fitted
    tuned: Tuned | FreeRuns
    baseline: Fitted
    ranked: tuple[Ranked, ...]
    best: Fitted
    sets: tuple[tuple[Tuned | FreeRuns, Fitted], ...]
    of: Library | None

    @property
    def is_noise_known(self) -> bool:
        """Whether the noise by which the answer was judged is known from repeats."""
        return self.seen.noise != "assumed"

    @property
    def materiality(self) -> float:
        """Factor by which what is left must be less with an effect that is not everyday."""
        return 1.0 if self.is_noise_known else MATERIAL


def name(
    seen: Seen,
    free: FreeRuns | None = None,
    report: Callable[[str, float], None] = lambda what, share: None,
    first: Callable[[Fitted], None] = lambda baseline: None,
) -> Named:
    """Name the effects that a machine's simulation lacks.

    Parameters
    ----------
    seen : Seen
    free : FreeRuns, optional
        By which sets are judged.
    report : callable, optional
        Told what is being done, and the share of the whole that is done.
    first : callable, optional
        Told the engineer's first fit as soon as there is one.
    """
    if free is not None:
        return _named_freely(seen, free, report, first)
    alongs = seen.alongs
    report("fitting numbers and friction", 0.1)
    levels, with_friction, baseline = engineers_fit(seen)
    first(baseline)
    report("fitting numbers alone", 0.25)
    tuned, plain = settled(alongs, levels, nominal_offset(alongs))
    begun = fit(tuned, baseline.settings, baseline.offset, plain.dispersion)
    assert begun is not None
    starts = [(tuned, begun), (with_friction, baseline)]
    dispersion = baseline.dispersion
    if baseline.cost(dispersion) + len(baseline.parameters) * math.log(tuned.readings) < plain.cost(dispersion):
        starts.reverse()
    of: Library | None
    tuned, best, ranked, of = _sought(alongs, levels, *starts[0], report)
    if not levels.are_assumed and best.squares > (1.0 + LEVEL) * tuned.readings:  # the search may have ended where it began badly
        other = _sought(alongs, levels, *starts[1], report)
        if other[1].squares < best.squares:
            tuned, best, ranked, of = other
    view = levels
    sets: list[tuple[Tuned | FreeRuns, Fitted]] = [(tuned, best)]
    if levels.are_assumed:
        report("predicting what was left out", 0.75)
        of = None  # of another view: it would fill the memory
        view = slow_view(alongs, levels)
        sets = [*proved(alongs, view, best.offset, best.settings, baseline.settings)]
    elif (kept := steady(seen, best)) is not None:
        sets = [kept]
    last, best = sets[0]
    of = of if of is not None and of.tuned is last else None
    return Named(seen, levels, view, plain, last, baseline, tuple(ranked), best, tuple(sets), of)


def engineers_fit(seen: Seen) -> tuple[Levels, Tuned, Fitted]:
    """Return numbers and everyday effects at every driven joint fitted together, the machine with them, and the levels of what scatters."""
    alongs, levels = seen.alongs, seen.levels
    with_friction, baseline = settled(alongs, levels, nominal_offset(alongs), everyday_effects(alongs[0]))
    if levels.are_assumed:
        levels = matched(levels, with_friction, baseline)
        with_friction, baseline = settled(alongs, levels, baseline.offset, baseline.settings)
    return levels, with_friction, baseline


def _named_freely(seen: Seen, free: FreeRuns, report: Callable[[str, float], None], first: Callable[[Fitted], None]) -> Named:
    """Name what a simulation lacks by free runs of the closed loop."""
    report("fitting numbers alone", 0.1)
    plain = fit_to(free, ())
    assert plain is not None
    free = free.about(seen.alongs, (plain.offset, ()), plain.columns)
    report("fitting numbers and friction", 0.2)
    baseline = fit_to(free, everyday_effects(seen.alongs[0]), plain.offset, plain.dispersion, plain) or plain
    first(baseline)
    is_better = baseline.cost(plain.dispersion) + len(baseline.parameters) * math.log(free.readings) < plain.cost(plain.dispersion)
    best, of = (baseline if is_better else plain), None
    for turn in range(ROUNDS):
        report("searching", 0.3 + 0.6 * turn / ROUNDS)
        everything = replace(free, are_shown=np.ones_like(free.are_shown))
        best = fit_to(everything, best.settings, best.offset, best.dispersion) or best
        free = free.about(seen.alongs, (best.offset, best.settings), best.columns)
        of = library(free, best, of)
        ranked = search(free, of, best if turn else baseline)
        is_settled = ranked[0].fitted.names == best.names
        best = ranked[0].fitted
        if is_settled:
            break
    if (kept := steady(seen, best, free)) is not None:
        _, best = kept
    best = _agreed(seen, free, best)
    return Named(seen, seen.levels, seen.levels, plain, free, baseline, tuple(ranked), best, ((free, best),), of)


def _agreed(seen: Seen, free: FreeRuns, best: Fitted) -> Fitted:
    """Return the fit without effects that the recorded motion speaks against: there none is STEADY deviations likelier than their strength.

    What is wrong in free runs is not wrong along the motion, and the other way round.
    """
    while best.settings:
        tuned = tuned_at(seen.alongs, seen.levels, best.offset, best.settings)
        along = fit(tuned, best.settings, best.offset, longest=LONGEST)
        if along is None:
            return best
        strengths = [setting.parameters for setting in best.settings]
        against = [away_from(along, number, strengths[number]) - away_from(along, number) for number in range(len(strengths))]
        worst = int(np.argmax(against))
        if against[worst] < STEADY**2:
            return best
        kept = (*best.settings[:worst], *best.settings[worst + 1 :])
        sparer = fit_to(free, kept, best.offset, best.dispersion)
        if sparer is None:
            return best
        best = sparer
    return best


def _sought(
    alongs: Sequence[Along], levels: Levels, tuned: Tuned, best: Fitted, report: Callable[[str, float], None]
) -> tuple[Tuned, Fitted, list[Ranked], Library]:
    """Return the machine, the fit and all sets where the search from a machine and a fit ends, and what it was among."""
    for turn in range(ROUNDS):
        report("searching", 0.35 + 0.4 * turn / ROUNDS)
        of = library(tuned, best)
        ranked = search(tuned, of, best, MATERIAL if levels.are_assumed else 1.0)
        is_settled = ranked[0].fitted.names == best.names
        best = ranked[0].fitted
        if is_settled:
            break
        tuned, best = settled(alongs, levels, best.offset, best.settings)
    return tuned, best, ranked, of
