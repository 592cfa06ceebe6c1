"""Re-tuned inertias that a rigid body can have: no machine file is one otherwise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from virtual_bus.plant.parameters import INERTIA_ENTRIES, PlantParameter

DIAGONAL = tuple(entry for entry, i, j in INERTIA_ENTRIES if i == j)

ROUNDING = 1e-12
"""Of the sum of the second moments: one that is no further below zero is zero."""


INSIDE = 1e-6
"""Of the sum of a body's moments: as far as this from being none a rigid body stays where it is held to be one, clear of rounding."""


@dataclass(frozen=True, eq=False)
class Shortage:
    """A second moment that is below zero: along the direction of the least one it is linear in the moments of inertia.

    Attributes
    ----------
    places : (k,) int array
        Of the body's entries among the parameters.
    slopes : (k,) array
        Of that second moment with them.
    missing : float
        What it is to grow by.
    """

    places: np.ndarray
    slopes: np.ndarray
    missing: float


def rigid(parameters: Sequence[PlantParameter], values: np.ndarray) -> np.ndarray:
    """The same values, the three moments of every body raised alike where they were no rigid body's.

    J is that of a mass distribution where its second moments, tr(J)/2 I - J, are not negative in any direction (Wensing, Kim and Slotine
    2018), which for principal moments is the triangle inequality. t on each moment of J is t/2 on each second moment. Products of inertia
    that a file leaves zero stay zero.

    Parameters
    ----------
    parameters : sequence of PlantParameter
    values : (all parameters,) array
        In the parameters' units; not written to.
    """
    found = values
    for entries in _bodies(parameters):
        second = _second_moments(entries, values)
        least = float(np.linalg.eigvalsh(second)[0])
        if least < -ROUNDING * np.trace(second):
            found = values.copy() if found is values else found
            found[[entries[entry] for entry in DIAGONAL]] -= 2.0 * least
    return found


def shortages(parameters: Sequence[PlantParameter], values: np.ndarray) -> list[Shortage]:
    """Of every body that `rigid` would change: what keeps a search on this side of where it would."""
    found = []
    for entries in _bodies(parameters):
        second = _second_moments(entries, values)
        moments, directions = np.linalg.eigh(second)
        if moments[0] < -ROUNDING * np.trace(second):
            v = directions[:, 0]
            slopes = [0.5 - v[i] ** 2 if i == j else -2.0 * v[i] * v[j] for entry, i, j in INERTIA_ENTRIES if entry in entries]
            places = [entries[entry] for entry, _, _ in INERTIA_ENTRIES if entry in entries]
            found.append(Shortage(np.array(places), np.array(slopes), float(INSIDE * np.trace(second) - moments[0])))
    return found


def _bodies(parameters: Sequence[PlantParameter]) -> Iterator[Mapping[str, int]]:
    """Places of the moments of every body that has three: no point mass, and none that does not turn."""
    places: dict[str, dict[str, int]] = {}
    for place, parameter in enumerate(parameters):
        quantity, _, entry = parameter.quantity.rpartition("_")
        if quantity == "inertia":
            places.setdefault(parameter.owner, {})[entry] = place
    yield from (entries for entries in places.values() if all(entry in entries for entry in DIAGONAL))


def _second_moments(entries: Mapping[str, int], values: np.ndarray) -> np.ndarray:
    inertia = np.zeros((3, 3))
    for entry, i, j in INERTIA_ENTRIES:
        if entry in entries:
            inertia[i, j] = inertia[j, i] = values[entries[entry]]
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia
