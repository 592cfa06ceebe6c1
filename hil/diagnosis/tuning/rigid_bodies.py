"""Re-tuned inertias that a rigid body can have: no machine file is one otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from virtual_bus.plant.parameters import INERTIA_ENTRIES, PlantParameter
from virtual_bus.plant.same import Same

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
    bodies = _bodies_of(parameters)
    second = bodies.second_moments(values)
    least = np.linalg.eigvalsh(second)[:, 0]
    found = values
    for body in np.flatnonzero(_is_below_zero(least, second)):
        found = values.copy() if found is values else found
        found[[bodies.entries[body][entry] for entry in DIAGONAL]] -= 2.0 * float(least[body])
    return found


def shortages(parameters: Sequence[PlantParameter], values: np.ndarray) -> list[Shortage]:
    """Of every body that `rigid` would change: what keeps a search on this side of where it would."""
    bodies = _bodies_of(parameters)
    second = bodies.second_moments(values)
    moments, directions = np.linalg.eigh(second)
    found = []
    for body in np.flatnonzero(_is_below_zero(moments[:, 0], second)):
        entries, v = bodies.entries[body], directions[body, :, 0]
        slopes = [0.5 - v[i] ** 2 if i == j else -2.0 * v[i] * v[j] for entry, i, j in INERTIA_ENTRIES if entry in entries]
        places = [entries[entry] for entry, _, _ in INERTIA_ENTRIES if entry in entries]
        missing = float(INSIDE * np.trace(second[body]) - moments[body, 0])
        found.append(Shortage(np.array(places), np.array(slopes), missing))
    return found


def some_are_short(parameters: Sequence[PlantParameter], values: np.ndarray) -> np.ndarray:
    """(K,) whether there are `shortages` with each of these values (K, all parameters)."""
    second = _bodies_of(parameters).second_moments(values)
    return np.any(_is_below_zero(np.linalg.eigh(second)[0][..., 0], second), axis=-1)


def _is_below_zero(least: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.asarray(least < -ROUNDING * np.trace(second, axis1=-2, axis2=-1))


@dataclass(frozen=True, eq=False)
class _Bodies:
    """Bodies that have three moments of inertia: no point mass, and none that does not turn.

    `entries` says where each one's moments stand among the parameters, `places` (B, 3, 3) where its matrix's stand, -1 for zero.
    """

    entries: tuple[Mapping[str, int], ...]
    places: np.ndarray

    def second_moments(self, values: np.ndarray) -> np.ndarray:
        """(..., B, 3, 3), of values (..., all parameters)."""
        inertia = np.where(self.places < 0, 0.0, values[..., self.places])
        return 0.5 * np.trace(inertia, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - inertia


def _bodies_of(parameters: Sequence[PlantParameter]) -> _Bodies:
    return _bodies(Same(parameters))


@lru_cache(maxsize=16)
def _bodies(parameters: Same[Sequence[PlantParameter]]) -> _Bodies:
    places: dict[str, dict[str, int]] = {}
    for place, parameter in enumerate(parameters.it):
        quantity, _, entry = parameter.quantity.rpartition("_")
        if quantity == "inertia":
            places.setdefault(parameter.owner, {})[entry] = place
    entries = tuple(own for own in places.values() if all(entry in own for entry in DIAGONAL))
    matrices = np.full((len(entries), 3, 3), -1)
    for matrix, own in zip(matrices, entries, strict=True):
        for entry, i, j in INERTIA_ENTRIES:
            matrix[i, j] = matrix[j, i] = own.get(entry, -1)
    return _Bodies(entries, matrices)
