"""Ticks that a run skipped, put back as rows: repeats of one experiment stay repeats, whichever ticks each of them lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hil.recording import Channel, Recording
from hil.recording.ticks import PLANNED, on_every_tick


def with_every_tick(recordings: Mapping[str, Recording]) -> dict[str, Recording]:
    """A row for every tick; what was measured is missing there.

    The plan of a tick that one run lost is that of the same tick in another run of the same plan: interpolated, it would differ in the last
    digits, and be another experiment. What all of them lost is filled as `on_every_tick` does, once for all of them.
    """
    whole = {label: on_every_tick(recording) for label, recording in recordings.items()}
    if all(whole[label] is recording for label, recording in recordings.items()):
        return whole
    groups: list[list[_Run]] = []
    for label, recording in recordings.items():
        run = _Run(label, whole[label], np.isin(np.arange(whole[label].rows), recording.ticks))
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
    kept: np.ndarray  # (N,) ticks that have a row of their own

    @property
    def planned(self) -> dict[str, np.ndarray]:
        """Without an observer's damping, which answers to each run's own noise."""
        channels = self.whole.channels.items()
        return {name: channel.values for name, channel in channels if name.startswith(PLANNED) and not name.startswith("damping_")}

    def may_repeat(self, other: _Run) -> bool:
        """Whether both have the same plan wherever both kept a row."""
        if self.whole.rows != other.whole.rows or self.planned.keys() != other.planned.keys():
            return False
        both = self.kept & other.kept
        return all(np.array_equal(values[both], other.planned[name][both], equal_nan=True) for name, values in self.planned.items())


def _plan(group: list[_Run]) -> dict[str, np.ndarray]:
    plan = {name: values.copy() for name, values in group[0].planned.items()}
    for run in group:
        for name, values in run.planned.items():
            plan[name][run.kept] = values[run.kept]
    return plan


def _with_plan(recording: Recording, plan: Mapping[str, np.ndarray]) -> Recording:
    channels = {name: Channel(channel.unit, plan.get(name, channel.values)) for name, channel in recording.channels.items()}
    return Recording(channels, recording.metadata)
