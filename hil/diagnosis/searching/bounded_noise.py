"""Noise without repeats: bounded by what the closest known physics leaves of the residual.

The residual of the nominal machine is mismatch and noise together, and where the mismatch is spread over frequency no bound taken from it
sees past it. So the known effects are fitted first, whether or not they would pass, and the bound is taken from what the closest of them
leaves, as a regression's variance is taken from its residual. Where nothing is missing, no effect takes much away and the bound stays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.residuals.noise import assumed_noise
from hil.diagnosis.searching.selection import Selection, select
from hil.diagnosis.searching.step_error import with_finer_steps
from hil.diagnosis.searching.without_effects import without_effects
from hil.diagnosis.starting.candidates import Candidate, candidates
from hil.diagnosis.starting.filtered_starts import with_filtered_starts
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.through_the_loop import ThroughTheLoop
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import Tuning, retune

ROUNDS = 2
"""A lower bound lets smaller effects be fitted, which lower it again."""

WORTH_A_ROUND = 0.9
"""Factor on every channel's bound above which a further round changes nothing."""


def candidates_for(runs: FreeRuns, tuning: Tuning) -> Callable[[Fitted | None], Sequence[Candidate]]:
    """Candidates with start values from the longest training groups, given the effects found so far."""
    train = runs.sets[TRAIN]
    is_assumed = train.noise.kind == "assumed"
    assumed = dict(zip(train.channels, train.noise.std.tolist(), strict=True)) if is_assumed else {}
    positions = np.concatenate([group.position for group in train.groups])
    visited = {axis: (float(q.min()), float(q.max())) for axis, q in zip(train.axes, positions.T, strict=True)}
    loop = ThroughTheLoop(runs, TRAIN, tuning)

    def found_beside(found: Fitted | None) -> Sequence[Candidate]:
        values = tuning.values if found is None else tuning.at(found.offset)
        rows = runs.rows(Trial(values, () if found is None else found.settings))
        assert rows is not None
        groups = [replace(group, simulated=simulated) for group, simulated in zip(train.groups, rows, strict=True)]
        motions = [Motion(train.machine, values, group, train.channels, assumed=assumed, visited=visited) for group in groups]
        longest = max(len(simulated) for simulated in rows)
        first, *others = [motion for motion in motions if len(motion.group.simulated) == longest]
        present = () if found is None else found.effects
        tried = candidates(replace(first, others=tuple(others)), train.channels, present, runs.at_once)
        return with_filtered_starts(loop, tried, motions, runs.measured() - runs.joined(rows))

    return found_beside


def _one_way(runs: FreeRuns, tuning: Tuning) -> Selection:
    """Effects added one at a time on one way, which is enough for a bound, and half the time."""
    entries = float(len(tuning.predicted))
    return select(runs, tuning, None, entries, candidates_for(runs, tuning), lambda what, share: None, another_way=False)


def with_bounded_noise(train: Mismatch, jobs: int, report: Callable[[str, float], None]) -> Mismatch:
    """The same recordings with the bound on their noise; unchanged where repeats or periods gave it.

    Parameters
    ----------
    train : Mismatch
    jobs : int
    report : callable
        Told what is being done, and how far the whole is.
    """
    if train.noise.kind != "assumed":
        return train
    for _ in range(ROUNDS):
        report("bounding the noise", 0.01)
        with FreeRuns({TRAIN: train}, train.noise, jobs) as runs:
            tuning = retune(runs)
            selection = _one_way(runs, tuning)
            for begun_anew in (without_effects, with_finer_steps):
                again = begun_anew(runs, tuning, selection)
                if again is not tuning:
                    tuning, selection = again, _one_way(runs, again)
            closest = selection.closest
            trial = Trial(tuning.values) if closest is None else Trial(tuning.at(closest.offset), closest.settings)
            rows = runs.rows(trial)
        if rows is None:
            return train
        residuals = [group.mean - simulated for group, simulated in zip(train.groups, rows, strict=True)]
        noise = assumed_noise(residuals, train.channels, train.machine)
        settled = np.all(noise.std > WORTH_A_ROUND * train.noise.std)
        if np.any(noise.std < train.noise.std):
            train = replace(train, noise=noise)
        if settled:
            break
    return train
