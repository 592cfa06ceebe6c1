"""From recordings to ranked sets of effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hil.diagnosis.named.everyday import everyday_fit, known_of
from hil.diagnosis.named.fitting import Fitted
from hil.diagnosis.named.search import Ranked, library, search
from hil.diagnosis.observed.groups import Group, groups
from hil.diagnosis.seen.along import Along
from hil.diagnosis.seen.beside import Levels
from hil.diagnosis.seen.levels import repeat_levels
from hil.diagnosis.tuned.retuning import Tuned, retune, tuned_at
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Recording

TIMES = 2
"""That the recordings are seen anew with the friction found so far: how a joint moved near a reversal follows from it, and it from that."""


@dataclass(frozen=True, eq=False)
class Named:
    """What was seen in recordings, and the sets of effects that explain it.

    Attributes
    ----------
    groups : tuple of Group
    levels : Levels
    tuned : Tuned
        The machine without effects.
    baseline : Fitted
        With the everyday effects at every driven joint.
    ranked : tuple of Ranked
        The likeliest set first.
    """

    groups: tuple[Group, ...]
    levels: Levels
    tuned: Tuned
    baseline: Fitted
    ranked: tuple[Ranked, ...]


def name(machine: Machine, recordings: Mapping[str, Recording]) -> Named:
    """Name the effects that a machine's simulation lacks.

    Raises
    ------
    RecordingError
        Recordings that cannot be used, or no repeats.
    """
    found = groups(machine, recordings)
    alongs = [Along(group.mean) for group in found]
    levels = repeat_levels(found, alongs)
    if levels is None:
        raise RecordingError("no two recordings are of one experiment: record each one three times, so that they show their noise")
    tuned = retune(alongs, levels)
    baseline = everyday_fit(tuned)
    for _ in range(TIMES):
        tuned = tuned_at(alongs, levels, baseline.offset, known_of(tuned, baseline))
        baseline = everyday_fit(tuned)
    return Named(found, levels, tuned, baseline, tuple(search(tuned, library(tuned), baseline)))
