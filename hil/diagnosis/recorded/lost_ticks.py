"""Ticks that a run skipped, put back as rows: repeats of one experiment stay repeats, whichever ticks each of them lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.recorded.repeated import are_equal_inputs
from hil.recording import Channel, Recording
from hil.recording.ticks import PLANNED, on_every_tick


def with_every_tick(
    recordings: Mapping[str, Recording], kept: Mapping[str, np.ndarray] | None = None, inputs: tuple[str, ...] = PLANNED
) -> dict[str, Recording]:
    """A row for every tick; what was measured is missing there.

    The plan of a tick that one run lost is that of the same tick in another run of the same plan: interpolated, it would differ in the last
    digits, and be another experiment. What all of them lost is filled as `on_every_tick` does, once for all of them.

    Parameters
    ----------
    recordings : mapping of str to Recording
    kept : mapping of str to (K,) array, optional
        Ticks that have a row of their own, of recordings in which lost ones have been filled already.
    inputs : tuple of str
        How the names of what was planned begin, and drives a simulation: of a machine without a controller commands, too.
    """
    filled = kept or {}
    whole = {label: on_every_tick(recording) for label, recording in recordings.items()}
    if not filled and all(whole[label] is recording for label, recording in recordings.items()):
        return whole
    groups: list[list[_Run]] = []
    for label, recording in recordings.items():
        own = np.isin(np.arange(whole[label].rows), filled.get(label, recording.ticks))
        run = _Run(label, whole[label], own, inputs)
        for group in groups:
            if all(run.may_repeat(other) for other in group):
                group.append(run)
                break
        else:
            groups.append([run])
    return {run.label: _with_plan(run.whole, _plan(group)) for group in groups for run in group}


@dataclass(frozen=True, eq=False)
class _Run:
    label: str
    whole: Recording
    kept: np.ndarray  # (N,) whether the tick has a row of its own
    inputs: tuple[str, ...]  # how their names begin

    @property
    def planned(self) -> dict[str, np.ndarray]:
        """Without an observer's damping, which answers to each run's own noise."""
        channels = self.whole.channels.items()
        return {name: channel.values for name, channel in channels if name.startswith(self.inputs) and not name.startswith("damping_")}

    def may_repeat(self, other: _Run) -> bool:
        """Whether both have the same plan wherever both kept a row: but for a last one, which a clock a hair early costs."""
        rows = min(len(self.kept), len(other.kept))
        if max(len(self.kept), len(other.kept)) > rows + 1 or self.planned.keys() != other.planned.keys():
            return False
        both = self.kept[:rows] & other.kept[:rows]
        return all(are_equal_inputs(values[:rows][both], other.planned[name][:rows][both]) for name, values in self.planned.items())


def _plan(group: list[_Run]) -> dict[str, np.ndarray]:
    longest = max(group, key=lambda run: len(run.kept))
    plan = {name: values.copy() for name, values in longest.planned.items()}
    for run in group:
        for name, values in run.planned.items():
            plan[name][: len(values)][run.kept] = values[run.kept]
    return plan


def _with_plan(recording: Recording, plan: Mapping[str, np.ndarray]) -> Recording:
    planned = {name: Channel(recording.channel(name).unit, values[: recording.rows]) for name, values in plan.items()}
    return Recording({**recording.channels, **planned}, recording.metadata)
