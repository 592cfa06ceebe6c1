"""The numbers of a machine file that recordings may correct, and how far."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.rigid_bodies import RigidBodies, rigid_bodies

PRIOR = 0.1
"""Standard deviation of a nominal number, as a share of it."""
TOLERANCE = 1.5
"""Hard bound of a correction, in standard deviations: beyond 15 % it is no tuning, but physics that the file has not. Where the file states
a tolerance, that is the bound."""
CLOCKED_PRIOR = 0.02
"""Of corners that a sensor's clock makes: data sheets say 1 to 3 %."""
CLOCKED = ("accelerometer_bandwidth", "gyro_bandwidth")
MOST_FREED = 10.0
"""Bound of a rotor's inertia that the file leaves out, in units of what moves with its joint: behind a gear of a hundred a rotor is heavier
than a wrist. Tolerance of a number that is freed, as a multiple of it: a figure in another unit, or of another part."""
LEAST = 1.0 / MOST_FREED
"""Share of a mass or a moment of inertia that stays, whatever tolerance is stated: without any, nothing could be told from an effort."""
INERTIAL = ("mass", "inertia_xx", "inertia_yy", "inertia_zz")
NOT_NEGATIVE = ("stiffness", "damping", "armature", "brake_effort", "constant", *CLOCKED)
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
    low, high : (P,) arrays
        How far they may go, in the same units.
    """

    plant: CompiledPlant
    indices: np.ndarray
    scale: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def names(self) -> list[str]:
        """Return owner and quantity of each."""
        return [f"{self.plant.parameters[i].owner}.{self.plant.parameters[i].quantity}" for i in self.indices]

    def holding(self, quantity: str) -> Numbers:
        """Return the same with a quantity that stays at the file's values."""
        held = np.array([self.plant.parameters[i].quantity.startswith(quantity) for i in self.indices], dtype=bool)
        return replace(self, low=np.where(held, 0.0, self.low), high=np.where(held, 0.0, self.high))

    def values(self, offset: np.ndarray) -> np.ndarray:
        """Return the plant's parameters at these coordinates (P,), inertias raised to those of rigid bodies."""
        values = self.plant.nominal
        values[self.indices] += offset * self.scale
        return self._bodies.rigid(values)

    @cached_property
    def _bodies(self) -> RigidBodies:
        return rigid_bodies(self.plant.parameters)


def numbers_of(plant: CompiledPlant) -> Numbers:
    """Return the numbers that may be corrected: those of the file, inertias of rotors that it leaves out, and what has a tolerance."""
    indices, scales, low, high = [], [], [], []
    names = [joint.name for joint in plant.settings.tree.joints]
    driven = {drive.joint for drive in plant.settings.drives}
    moved = plant.inertias(plant.model(), np.zeros(len(names)))
    for i, parameter in enumerate(plant.parameters):
        if parameter.tolerance is not None:
            scales.append(parameter.tolerance / TOLERANCE)
            share = 1.0 - LEAST if parameter.quantity in INERTIAL else 1.0
            may_be_negative = parameter.quantity not in (*INERTIAL, *NOT_NEGATIVE)
            low.append(-TOLERANCE if may_be_negative else max(-TOLERANCE, -share * parameter.value / scales[-1]))
            high.append(TOLERANCE)
        elif not parameter.quantity.startswith(TUNED):
            continue
        elif parameter.value != 0.0:
            scales.append(abs(parameter.value) * (CLOCKED_PRIOR if parameter.quantity in CLOCKED else PRIOR))
            low.append(-TOLERANCE)
            high.append(TOLERANCE)
        elif parameter.quantity.startswith("armature") and parameter.owner in driven:
            scales.append(PRIOR * float(moved[names.index(parameter.owner)]))
            low.append(0.0)
            high.append(MOST_FREED / PRIOR)
        else:
            continue
        indices.append(i)
    return Numbers(plant, np.array(indices, dtype=np.int64), *(np.array(each, dtype=float) for each in (scales, low, high)))
