"""From recordings to ranked sets of effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hil.diagnosis.named.everyday import everyday_effects
from hil.diagnosis.named.fitting import Fitted, fit
from hil.diagnosis.named.search import Ranked, library, search
from hil.diagnosis.named.settling import settled
from hil.diagnosis.observed.groups import Group, groups
from hil.diagnosis.seen.along import Along
from hil.diagnosis.seen.beside import Levels
from hil.diagnosis.seen.levels import repeat_levels
from hil.diagnosis.tuned.retuning import Tuned, nominal_offset
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Recording


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
    tuned, plain = settled(alongs, levels, nominal_offset(alongs[0]))
    with_friction, baseline = settled(alongs, levels, plain.offset, everyday_effects(alongs[0]))
    if baseline.cost + len(baseline.parameters) * math.log(tuned.readings) < plain.cost:
        tuned = with_friction
    else:
        begun = fit(tuned, baseline.settings, baseline.offset)
        assert begun is not None
        baseline = begun
    return Named(found, levels, tuned, baseline, tuple(search(tuned, library(tuned), baseline)))
