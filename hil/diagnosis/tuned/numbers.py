"""The numbers of a machine file that recordings may correct, and how far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from virtual_bus.plant.compiled import CompiledPlant

PRIOR = 0.1
"""Standard deviation of a nominal number, as a share of it."""
TOLERANCE = 1.5
"""Hard bound of a correction, in standard deviations: beyond 15 % it is no tuning, but physics that the file has not."""
CLOCKED_PRIOR = 0.02
"""Of corners that a sensor's clock makes: data sheets say 1 to 3 %."""
CLOCKED = ("accelerometer_bandwidth", "gyro_bandwidth")
TUNED = ("mass", "center_of_mass", "inertia", "stiffness", "damping", "armature", "constant", *CLOCKED)


@dataclass(frozen=True, eq=False)
class Numbers:
    """Numbers in coordinates of their prior's standard deviation, zero at the machine file's value.

    Attributes
    ----------
    plant : CompiledPlant
    indices : (P,) int array
        Among the plant's parameters.
    scale : (P,) array
        One unit of the coordinates, in the parameters' units.
    """

    plant: CompiledPlant
    indices: np.ndarray
    scale: np.ndarray

    @property
    def names(self) -> list[str]:
        """Return owner and quantity of each."""
        return [f"{self.plant.parameters[i].owner}.{self.plant.parameters[i].quantity}" for i in self.indices]

    def values(self, offset: np.ndarray) -> np.ndarray:
        """Return the plant's parameters at these coordinates (P,)."""
        values = self.plant.nominal
        values[self.indices] += offset * self.scale
        return values


def numbers_of(plant: CompiledPlant) -> Numbers:
    """Return the numbers that are not zero in the file."""
    chosen = [
        (i, parameter.value * (CLOCKED_PRIOR if parameter.quantity in CLOCKED else PRIOR))
        for i, parameter in enumerate(plant.parameters)
        if parameter.value != 0.0 and parameter.quantity.startswith(TUNED)
    ]
    indices, scale = zip(*chosen, strict=True) if chosen else ((), ())
    return Numbers(plant, np.array(indices, dtype=np.int64), np.abs(np.array(scale, dtype=float)))
