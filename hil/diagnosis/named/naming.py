"""From recordings to ranked sets of effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hil.diagnosis.named.assumed import assumed_levels, coarsest, matched
from hil.diagnosis.named.everyday import everyday_effects
from hil.diagnosis.named.fitting import Fitted, fit
from hil.diagnosis.named.proving import proved
from hil.diagnosis.named.search import Ranked, library, search
from hil.diagnosis.named.settling import settled
from hil.diagnosis.observed.groups import Group, groups
from hil.diagnosis.seen.along import Along
from hil.diagnosis.seen.beside import Levels
from hil.diagnosis.seen.levels import repeat_levels
from hil.diagnosis.tuned.retuning import Tuned, nominal_offset
from hil.machine import Machine
from hil.recording import Recording

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
    groups : tuple of Group
    levels : Levels
    tuned : Tuned
        The machine where it was last seen: its numbers are those of `best`.
    baseline : Fitted
        With the everyday effects at every driven joint.
    ranked : tuple of Ranked
        The likeliest set first, as far as fast misfits count.
    best : Fitted
        The set that predicts: the likeliest one, where noise is known from repeats.
    """

    groups: tuple[Group, ...]
    levels: Levels
    tuned: Tuned
    baseline: Fitted
    ranked: tuple[Ranked, ...]
    best: Fitted


def name(machine: Machine, recordings: Mapping[str, Recording]) -> Named:
    """Name the effects that a machine's simulation lacks.

    Raises
    ------
    RecordingError
        Recordings that cannot be used.
    """
    found = groups(machine, recordings)
    alongs = [Along(group.mean) for group in found]
    levels = repeat_levels(found, alongs)
    materiality = 1.0
    if levels is None:
        materiality = MATERIAL
        by = coarsest(alongs)
        alongs = [Along(along.observed.coarser(by)) for along in alongs] if by > 1 else alongs
        levels = assumed_levels(alongs)
    with_friction, baseline = settled(alongs, levels, nominal_offset(alongs), everyday_effects(alongs[0]))
    if levels.are_assumed:
        levels = matched(levels, with_friction, baseline)
        with_friction, baseline = settled(alongs, levels, baseline.offset, baseline.settings)
    tuned, plain = settled(alongs, levels, nominal_offset(alongs))
    dispersion = baseline.dispersion
    if baseline.cost(dispersion) + len(baseline.parameters) * math.log(tuned.readings) < plain.cost(dispersion):
        tuned, best = with_friction, baseline
    else:
        begun = fit(tuned, baseline.settings, baseline.offset, plain.dispersion)
        assert begun is not None
        best = begun
    ranked: list[Ranked] = []
    for _ in range(ROUNDS):
        ranked = search(tuned, library(tuned), best, materiality)
        if ranked[0].fitted.names == best.names:
            break
        tuned, best = settled(alongs, levels, ranked[0].fitted.offset, ranked[0].fitted.settings)
    best = ranked[0].fitted
    if levels.are_assumed:
        further = tuple(each for each in baseline.settings if (each.name, each.at) not in best.names)
        tuned, best = proved(alongs, levels, best.offset, (*best.settings, *further))
    return Named(found, levels, tuned, baseline, tuple(ranked), best)
