"""Re-tuned inertias that a rigid body can have: no machine file is one otherwise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from virtual_bus.plant.parameters import INERTIA_ENTRIES, PlantParameter

ROUNDING = 1e-12
"""Of the largest moment: a second moment that is no further below zero is zero."""


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
    places: dict[str, dict[str, int]] = {}
    for place, parameter in enumerate(parameters):
        quantity, _, entry = parameter.quantity.rpartition("_")
        if quantity == "inertia":
            places.setdefault(parameter.owner, {})[entry] = place
    found = values
    for entries in places.values():
        diagonal = [entries[entry] for entry, i, j in INERTIA_ENTRIES if i == j and entry in entries]
        if len(diagonal) < 3:  # a point mass, or one that does not turn
            continue
        inertia = np.zeros((3, 3))
        for entry, i, j in INERTIA_ENTRIES:
            if entry in entries:
                inertia[i, j] = inertia[j, i] = values[entries[entry]]
        second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        least = float(np.linalg.eigvalsh(second)[0])
        if least < -ROUNDING * inertia.diagonal().max():
            found = values.copy() if found is values else found
            found[diagonal] -= 2.0 * least
    return found
