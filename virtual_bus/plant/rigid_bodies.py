"""Changed inertias that a rigid body can have: no machine file is one otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from virtual_bus.plant.parameters import INERTIA_ENTRIES, PlantParameter

ROUNDING = 1e-10
"""Of a trace: second moments that are less below zero are rounded ones."""
DIAGONAL = tuple(entry for entry, i, j in INERTIA_ENTRIES if i == j)


@dataclass(frozen=True, eq=False)
class RigidBodies:
    """The bodies that have three moments of inertia: no point mass, and none that does not turn.

    Attributes
    ----------
    places : (B, 3, 3) int array
        Where the inertias' entries stand, -1 for zero.
    """

    places: np.ndarray

    def rigid(self, values: np.ndarray) -> np.ndarray:
        """Return the same values, moments of every body raised where they were no rigid body's.

        J is that of a mass distribution where its second moments, tr(J)/2 I - J, are not negative in any direction (Wensing, Kim and
        Slotine 2018), which for principal moments is the triangle inequality. What is missing along the least direction v is added to the
        moments across it: that about v, which recordings of a turning body show, stays. Products of inertia that a file leaves zero stay
        zero; where that is not enough, all three moments rise alike.
        """
        if not len(self.places):
            return values
        inertias = np.where(self.places < 0, 0.0, values[self.places])
        traces = np.trace(inertias, axis1=1, axis2=2)
        least = np.linalg.eigvalsh(0.5 * traces[:, None, None] * np.eye(3) - inertias)[:, 0]
        found = values.copy()
        for places in self.places[least < -ROUNDING * traces]:
            for is_alike in (False, True):
                inertia = np.where(places < 0, 0.0, found[places])
                trace = float(np.trace(inertia))
                moments, directions = np.linalg.eigh(0.5 * trace * np.eye(3) - inertia)
                if moments[0] >= -ROUNDING * trace:
                    break
                across = 2.0 * np.eye(3) if is_alike else np.eye(3) - np.outer(directions[:, 0], directions[:, 0])
                has = np.triu(places >= 0)
                found[places[has]] -= moments[0] * across[has]
        return found


def rigid_bodies(parameters: Sequence[PlantParameter]) -> RigidBodies:
    """Return the bodies whose moments of inertia are among the parameters."""
    places: dict[str, dict[str, int]] = {}
    for place, parameter in enumerate(parameters):
        quantity, _, entry = parameter.quantity.rpartition("_")
        if quantity == "inertia":
            places.setdefault(parameter.owner, {})[entry] = place
    whole = [own for own in places.values() if all(entry in own for entry in DIAGONAL)]
    matrices = np.full((len(whole), 3, 3), -1)
    for matrix, own in zip(matrices, whole, strict=True):
        for entry, i, j in INERTIA_ENTRIES:
            matrix[i, j] = matrix[j, i] = own.get(entry, -1)
    return RigidBodies(matrices)
