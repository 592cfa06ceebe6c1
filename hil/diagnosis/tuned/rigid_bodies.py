"""Re-tuned inertias that a rigid body can have: no machine file is one otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from virtual_bus.plant.parameters import INERTIA_ENTRIES, PlantParameter

DIAGONAL = tuple(entry for entry, i, j in INERTIA_ENTRIES if i == j)
ROUNDING = 1e-12
"""Of the sum of the second moments: one that is no further below zero is zero."""


@dataclass(frozen=True, eq=False)
class RigidBodies:
    """The bodies that have three moments of inertia: no point mass, and none that does not turn.

    Attributes
    ----------
    diagonals : (B, 3) int array
        Where the moments stand among the parameters.
    places : (B, 3, 3) int array
        Where the inertias' entries stand, -1 for zero.
    """

    diagonals: np.ndarray
    places: np.ndarray

    def rigid(self, values: np.ndarray) -> np.ndarray:
        """Return the same values, the three moments of every body raised alike where they were no rigid body's.

        J is that of a mass distribution where its second moments, tr(J)/2 I - J, are not negative in any direction (Wensing, Kim and
        Slotine 2018), which for principal moments is the triangle inequality. t on each moment of J is t/2 on each second moment.
        """
        if not len(self.places):
            return values
        inertia = np.where(self.places < 0, 0.0, values[self.places])
        traces = np.trace(inertia, axis1=1, axis2=2)
        least = np.linalg.eigvalsh(0.5 * traces[:, None, None] * np.eye(3) - inertia)[:, 0]
        short = least < -ROUNDING * traces
        if not short.any():
            return values
        found = values.copy()
        found[self.diagonals[short]] -= 2.0 * least[short, None]
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
    return RigidBodies(np.array([[own[entry] for entry in DIAGONAL] for own in whole], dtype=int).reshape(-1, 3), matrices)
