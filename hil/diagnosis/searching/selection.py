"""Which sets of effects are worth weighing: the best candidates singly, then added to the best set as long as each is there for certain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.screening import Screened
from hil.diagnosis.judging.form_error import form_error
from hil.diagnosis.judging.gate import Gate
from hil.diagnosis.judging.held_out import HeldOut
from hil.diagnosis.judging.judgement import Contender, Judgement
from hil.diagnosis.judging.onset import onset
from hil.diagnosis.ranking.naming import ranking
from hil.diagnosis.ranking.weighing import closer_than, evidence_of
from hil.diagnosis.searching.pairs import Start, without_one
from hil.diagnosis.searching.step import Report, Steps
from hil.diagnosis.searching.ways import Way, another_first, continued, from_another, joined
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning


@dataclass(frozen=True, eq=False)
class Selection:
    """Sets of effects that were fitted, and the chosen one.

    Attributes
    ----------
    chosen : Fitted or None
        The largest set whose effects all pass the gate; None where not even one does.
    gates : tuple of Gate
        Of each step of the chosen set, and of the step that ended it, last.
    contenders : tuple of Contender
        Sets that compete for the name, the chosen one among them; where nothing was chosen, the effects that came closest.
    screened : tuple of Screened
        The first screening.
    closest : Fitted or None
        The set that comes closest to the training recordings, whether or not it passed.
    further : float
        Of all effects tried beside the chosen set, how many gain by chance in training as much as the best of them did beyond what the
        set's equations may err by: what is left is more than noise and errors where it is small, though no effect passed the gate.
    formless : tuple of Contender
        Sets that would have passed but for their form: what they imitate has no name.
    unsure : tuple of Contender
        The chosen set with one effect more, which training shows and which did not pass the gate.
    smaller : tuple of Fitted
        All sets that were fitted on the way.
    """

    chosen: Fitted | None
    gates: tuple[Gate, ...]
    contenders: tuple[Contender, ...]
    screened: tuple[Screened, ...]
    closest: Fitted | None
    further: float = np.inf
    formless: tuple[Contender, ...] = ()
    unsure: tuple[Contender, ...] = ()
    smaller: tuple[Fitted, ...] = ()

    def gained_by_least(self, chosen: Fitted | None) -> float:
        """Fall of |residual|^2 by that effect of a set without which it loses least, over the best fit without it: what its last step
        gained, where none is known. Nothing, where a part was fitted closer. Infinite of no set.
        """
        found = self.contender_of(chosen)
        if found is None:
            return np.inf
        own = set(found.fitted.effects)
        costs = [part.cost for part in self.smaller if set(part.effects) < own and len(part.effects) == len(own) - 1]
        return max(min(found.gate.gain, *(cost - found.fitted.cost for cost in costs)), 0.0) if costs else found.gate.gain

    def contender_of(self, fitted: Fitted | None) -> Contender | None:
        """The contender of a set, of its closer fit where another way came to it as well."""
        if fitted is None:
            return None
        same = [one for one in self.contenders if set(one.fitted.effects) == set(fitted.effects)]
        return next((one for one in same if one.fitted is fitted), same[0] if same else None)

    def moved(self, to: Callable[[Sequence[Contender]], Sequence[Contender]]) -> Selection:
        """With all sets that are weighed, moved side by side."""
        sets = to((*self.contenders, *self.formless, *self.unsure))
        first, second = len(self.contenders), len(self.contenders) + len(self.formless)
        return replace(self, contenders=tuple(sets[:first]), formless=tuple(sets[first:second]), unsure=tuple(sets[second:]))


def select(
    runs: FreeRuns,
    tuning: Tuning,
    held_out: HeldOut | None,
    noise_energy: float,
    candidates_of: Callable[[Fitted | None], Sequence[Candidate]],
    report: Report,
    *,
    another_way: bool = True,
) -> Selection:
    """Add effects one at a time, once more from another first one that was not told apart, where further ones were found, and once more
    from the likeliest set where it leaves less than the one at the end: further effects are looked for beside what is named.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    held_out : HeldOut or None
    noise_energy : float
        Expected |residual|^2 of a perfect simulation.
    candidates_of : callable
        Candidates with start values, given the effects found so far.
    report : callable
        Told what is being done, and how far the whole is.
    another_way : bool
        Whether effects are added from another first one, or from the likeliest set, at all.
    """
    judgement = Judgement(runs, tuning, held_out, noise_energy, partial(form_error, runs), lambda name: onset(runs, name, tuning))
    steps = Steps(runs, tuning, judgement, noise_energy, candidates_of, report)
    first = steps.step(Way(judgement.nothing))
    way = steps.to_the_end(first)
    rival = another_first(first.contenders, way.stand.effects, first.stand, judgement.nothing, noise_energy)
    if another_way and rival is not None:
        other = steps.to_the_end(replace(first, stand=judgement.after(rival), gates=(rival.gate,), smaller=way.smaller))
        way = joined(way, other, judgement.nothing.cost, noise_energy)
    weigh = partial(evidence_of, runs, tuning, held_out, tried=len(way.screened), found=True)
    entries = len(tuning.predicted), 0 if held_out is None else len(held_out.measured)
    closer = closer_than(way.stand, way.contenders, entries, lambda some: ranking(weigh(some))[0].fitted)
    if another_way and closer is not None:
        way = continued(way, steps.to_the_end(from_another(way, closer, judgement.after(closer))))
    competing = [set(one.fitted.effects) for one in way.contenders]
    unsure = tuple(one for one in way.unsure if set(one.fitted.effects) not in competing)  # a rival of the first step may be one
    smaller = (*way.smaller, *(parts_not_fitted(steps, way) if another_way else ()))
    return Selection(way.stand.fitted, way.gates, way.contenders, way.screened, way.closest, way.further, way.formless, unsure, smaller)


def parts_not_fitted(steps: Steps, way: Way) -> list[Fitted]:
    """What the search ended with, and the set that gains most, without each of their effects, where they were not fitted so: whether a name
    shows by enough is asked of all its effects.
    """
    if way.stand.fitted is None:
        return []
    most = max(way.contenders, key=lambda one: one.gained + one.gained_held_out)
    starts: list[Start] = []
    for named in {id(one): one for one in (way.stand.fitted, most.fitted)}.values():
        fitted = [*(set(part.effects) for part in way.smaller), *(set(names) for names, _ in starts)]
        starts += [start for start in without_one(named) if set(start[0]) not in fitted]
    return steps.polished(steps.fits_from(starts))
