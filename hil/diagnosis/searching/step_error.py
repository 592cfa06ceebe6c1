"""Finer plant steps where their error tells sets apart.

One fine run near the end of re-tuning stands for all (`FreeRuns.correct`), and where an effect is missing that re-tuning cannot imitate
that is another machine's: with a compliance missing that shows in 6333 deviations, its correction leaves 12 155 in units of noise beside
the compliance, which a friction of 180 deviations cannot be told from. Taken beside one of the sets it would be wrong beside its rivals; so
all of them get finer steps, whose error is less by the square of how much finer they are.
"""

from __future__ import annotations

from hil.diagnosis.judging.errors_of_laws import erring
from hil.diagnosis.searching.selection import Selection
from hil.diagnosis.tuning.free_run import FreeRuns, Trial
from hil.diagnosis.tuning.retune import Tuning, corrected

WORTH_REFINING = 5.0
"""Energy, in units of noise, by which the correction is off beside what was found: less than any effect needs. Steps are not refined either
while the correction is off by less than the equations of what was found may err by."""

FINER = 4
"""Times: the second-order error's energy is less by 256."""


def with_finer_steps(runs: FreeRuns, tuning: Tuning, selection: Selection) -> Tuning:
    """The tuning; where plant steps err otherwise beside the effects that were found than where the correction was taken, and by more than
    these effects' equations may, re-tuned once more with finer steps, which all runs have from now on.
    """
    found = selection.contender_of(selection.chosen)
    if found is None:
        return tuning
    left = runs.measured() - tuning.predicted
    removed = float(left @ left + tuning.offset @ tuning.offset) - found.fitted.cost
    off = runs.miscorrected(Trial(tuning.at(found.fitted.offset), found.fitted.settings))
    if off < max(WORTH_REFINING, erring(removed, found.by_numbers[0])):
        return tuning
    runs.refine(FINER)
    return corrected(runs, tuning)
