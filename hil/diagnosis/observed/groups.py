"""Repeats of one experiment: their mean, and what each differs from it by."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.audit.readings import FEWEST_ROWS
from hil.diagnosis.observed.rows import Observed
from hil.errors import RecordingError
from hil.recording import RecordingWarning

SAME = 1e-9
"""Share of a reference's range by which repeats may differ: rounding of a text file."""


@dataclass(frozen=True, eq=False)
class Group:
    """Recordings of one experiment.

    Attributes
    ----------
    mean : Observed
        Of all repeats, row by row; missing where one repeat misses a sample.
    repeats : tuple of Observed
    are_periods : bool
        Whether they are the periods of one recording.
    """

    mean: Observed
    repeats: tuple[Observed, ...]
    are_periods: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Its recordings."""
        return tuple(dict.fromkeys(repeat.name for repeat in self.repeats))


def groups(every: Sequence[Observed], among: Sequence[str] | None = None) -> tuple[Group, ...]:
    """Return recordings, repeats together, with the channels that all of them have, `among` others where given.

    The periods of a recording that is the only one of its experiment are its repeats. A channel that some have, and others have not, is
    told to be left out, by a warning.
    """
    common = [c for c in every[0].channels if all(c in one.channels for one in every)] if every else []
    for channel in dict.fromkeys(c for one in every for c in one.channels if c not in common):
        lacking = next(one.name for one in every if channel not in one.channels)
        warnings.warn(f"{lacking}: no {channel}, which other recordings have; it is left out of all", RecordingWarning, stacklevel=2)
    kept = [channel for channel in common if among is None or channel in among]
    found: list[list[Observed]] = []
    for one in (each.with_channels(kept) for each in every):
        alike = next((group for group in found if are_repeats(group[0], one)), None)
        if alike is None:
            found.append([one])
        else:
            alike.append(one)
    return tuple(_group(group) for group in found)


def _group(repeats: Sequence[Observed]) -> Group:
    periods = _periods(repeats[0]) if len(repeats) == 1 else []
    parts = periods if len(periods) > 1 else repeats
    return Group(_mean(parts), tuple(parts), are_periods=parts is periods)


def _periods(one: Observed) -> list[Observed]:
    """Return the whole periods of a recording after settling; none where it has none, or rows of its own."""
    if not one.recording.experiment.get("period_samples") or one.rows != one.recording.rows:
        return []
    try:
        periods = one.recording.period_slices
    except RecordingError:
        return []
    return [one.part(rows) for rows in periods if rows.stop - rows.start >= FEWEST_ROWS]


def are_repeats(one: Observed, other: Observed) -> bool:
    """Return whether two recordings are of the same experiment: the same references and excitations, some of which move."""
    if one.rows != other.rows or one.channels != other.channels or abs(one.period_s - other.period_s) > SAME * one.period_s:
        return False
    names = [name for name in one.recording.channels if name.startswith(("reference_", "excitation_"))]
    if not one.machine.controllers:
        names = [name for name in one.recording.channels if name.startswith("command_")]
    if not names or names != [name for name in names if name in other.recording]:
        return False
    moves = False
    for name in names:
        first, second = one.recording[name], other.recording[name]
        if len(first) != len(second):
            return False
        reach = float(np.ptp(first))
        if not np.allclose(first, second, rtol=0.0, atol=SAME * max(reach, 1e-12), equal_nan=True):
            return False
        moves = moves or reach > 0.0
    return moves


def _mean(group: Sequence[Observed]) -> Observed:
    if len(group) == 1:
        return group[0]
    targets, currents, readings = (np.mean([getattr(each, name) for each in group], axis=0) for name in ("targets", "currents", "readings"))
    name = ", ".join(dict.fromkeys(each.name for each in group))
    return replace(group[0], name=name, targets=targets, currents=currents, readings=readings)
