"""Sets that were found with one of their effects exchanged for another that answers alike: without a free run, where a fit may start.

Of several effects a search finds one after the other, each beside those before it. What imitates one of them only beside the others was
never fitted there: alone it may have been far behind. Of the found set's response along one effect, with re-tuning and all that the others'
parameters do taken out, another candidate takes its squared cosine; what is left of it decides whether the two can be told apart.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from hil.diagnosis.fitting.information import is_in_proportion
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.screening import Screened, scaled
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching.pairs import Start
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.places import part_at
from virtual_bus.effects.registry import effects
from virtual_bus.settings import PlantSettings

MOST_EXCHANGED = 3
"""Sets that are fitted: each costs a fit and its polishing."""

MOST_NEIGHBOURS = 2
"""Neighbours that are fitted in place of each effect."""

LEAST_ALIKE = 0.5
"""Squared cosine below which another shape of the candidate will not make it the same either."""


def exchanged(
    tuning: Tuning, found: Fitted, singles: Sequence[Fitted], screened: Sequence[Screened], there: Collection[set[EffectAt]]
) -> list[Start]:
    """Starts of the sets, the most alike first; none of a single effect, whose rivals were all fitted.

    Parameters
    ----------
    tuning : Tuning
        Without effects.
    found : Fitted
    singles : sequence of Fitted
        Effects that were fitted alone.
    screened : sequence of Screened
        The others, tried alone.
    there : collection of sets
        That were fitted already.

    Notes
    -----
    On Silverbox (`benchmarks/real_recordings.py`) a spring that hardens leaves, alone, twelve times what a cable leaves: a cable has a
    place of its own and takes the load's part. The load is found beside the cable, and without an exchange the hardening would never be
    fitted beside the load.
    """
    if len(found.effects) < 2:
        return []
    projection = Projection.of(tuning)
    columns = projection.left(found.jacobian.T)
    fitted = {fit.effects[0] for fit in singles if len(fit.effects) == 1}
    bank = [(fit.effects[0], fit.values[0], projection.left(fit.predicted - tuning.predicted)) for fit in singles if len(fit.effects) == 1]
    bank += [(one.effect, one.values, one.response.astype(float)) for one in screened if one.effect not in fitted]
    each = []
    for number, effect in enumerate(found.effects):
        others = np.array([e != number for e, _ in found.free])
        basis = np.linalg.qr(columns[others].T)[0]
        own = _beyond(basis, _strengths(found, number) @ columns)
        energy = float(own @ own)
        for name, values, response in bank:
            rest = tuple(other for other in found.effects if other != effect)
            answer = _beyond(basis, response)
            size = float(answer @ answer)
            if name in found.effects or {*rest, name} in there or min(size, energy) <= 0.0:
                continue
            along = float(own @ answer)
            start = scaled(name, values, along / size)
            if along**2 > LEAST_ALIKE * size * energy and start is not None:
                kept = tuple(own for other, own in zip(found.effects, found.values, strict=True) if other != effect)
                each.append((along**2 / (size * energy), ((*rest, name), (*kept, start))))
    return [start for _, start in sorted(each, key=lambda one: -one[0])[:MOST_EXCHANGED]]


def neighbours_instead(
    found: Fitted, number: int, bank: Sequence[tuple[EffectAt, np.ndarray]], there: Collection[set[EffectAt]], settings: PlantSettings
) -> list[Start]:
    """Starts of the set with a neighbour of one of its effects at the same part in place of that: what is mistaken for a name is fitted
    before the name stands, wherever a filter had it.

    Parameters
    ----------
    found : Fitted
    number : int
        Of the effect.
    bank : sequence of (EffectAt, (parameters,) array)
        Where other effects may start, the most promising first.
    there : collection of sets
        That were fitted already.
    settings : PlantSettings

    Notes
    -----
    One such pair is a friction that warms and a hysteresis: alone presliding bristles end at a bound and are no name, and without an
    exchange they would never be fitted beside the warming.
    """
    own, starts = found.effects[number], []
    kept = [k for k in range(len(found.effects)) if k != number]
    rest, values = tuple(found.effects[k] for k in kept), tuple(found.values[k] for k in kept)
    for effect, start in bank:
        is_near = effect.effect in effects()[own.effect].neighbours or own.effect in effects()[effect.effect].neighbours
        is_new = effect not in found.effects and {*rest, effect} not in there
        if is_near and is_new and part_at(effect.at, settings) == part_at(own.at, settings):
            starts.append(((*rest, effect), (*values, start)))
    return starts[:MOST_NEIGHBOURS]


def bank_of(fits: Sequence[Fitted], screened: Sequence[Screened]) -> list[tuple[EffectAt, np.ndarray]]:
    """Effects with parameters that fits of them alone came to, the best first, or of the others, in their order, a filter wants."""
    bank = [(fit.effects[0], fit.values[0]) for fit in sorted(fits, key=lambda fit: fit.cost) if len(fit.effects) == 1]
    known = {effect for effect, _ in bank}
    return bank + [(one.effect, one.values) for one in screened if one.score > 0.0 and one.effect not in known]


def neighbours_of_all(
    found: Fitted,
    before: Sequence[EffectAt],
    banks: tuple[Sequence[tuple[EffectAt, np.ndarray]], Sequence[tuple[EffectAt, np.ndarray]]],
    there: Collection[set[EffectAt]],
    settings: PlantSettings,
) -> list[Start]:
    """Starts of a set with neighbours in place of each of its effects.

    Parameters
    ----------
    found : Fitted
    before : sequence of EffectAt
        What the last one was added to, if anything was.
    banks : pair of sequences of (EffectAt, (parameters,) array)
        Where other effects start beside those, and where they start alone.
    there : collection of sets
        That were fitted already.
    settings : PlantSettings
    """
    beside, alone = banks
    starts: list[Start] = []
    for number, effect in enumerate(found.effects):
        was_added = bool(before) and set(found.effects) - {effect} == set(before)
        fitted = [*there, *(set(names) for names, _ in starts)]
        starts += neighbours_instead(found, number, beside if was_added else alone, fitted, settings)
    return starts


def another_for_each(
    tuning: Tuning,
    found: Fitted,
    before: Sequence[EffectAt],
    alike: tuple[Sequence[Fitted], Sequence[Screened]],
    banks: tuple[Sequence[tuple[EffectAt, np.ndarray]], Sequence[tuple[EffectAt, np.ndarray]]],
    there: Collection[set[EffectAt]],
    settings: PlantSettings,
) -> list[Start]:
    """Starts of a set with one of its effects exchanged, for what answers alike (`exchanged`) and for its neighbours.

    `alike` are effects that were fitted alone and others that were tried alone; the rest is as `neighbours_of_all` has it.
    """
    starts = exchanged(tuning, found, *alike, there)
    return starts + neighbours_of_all(found, before, banks, [*there, *(set(names) for names, _ in starts)], settings)


def _strengths(found: Fitted, number: int) -> np.ndarray:
    """(F,) steps of the free parameters by which the effect of this number grows from nothing, as far as it is in proportion to them."""
    steps = np.zeros(len(found.free))
    for column, (e, k) in enumerate(found.free):
        if e == number and is_in_proportion(effects()[found.effects[e].effect].parameters[k]):
            steps[column] = found.values[e][k]
    return steps


def _beyond(basis: np.ndarray, response: np.ndarray) -> np.ndarray:
    return response - basis @ (basis.T @ response)
