"""Encoder quantisation: a lattice coarser than the machine file's."""

from __future__ import annotations

import numpy as np

from virtual_bus.effects.effect import LATTICE, Effect, Parameter
from virtual_bus.effects.law import Law, Place
from virtual_bus.effects.readings import Readings, Shown, coarser_lattice

EFFECT = Effect(
    name="encoder_quantization",
    plain="The encoder counts in coarser steps than its data sheet says.",
    kind=LATTICE,
    parameters=(Parameter("q", unit="rad", low=0.0, high=0.1, description="step of the lattice, at the joint"),),
    equation="y = q floor(y / q + 1/2)",
    convention="the reading is the nearest multiple of q, halves upwards, then on the encoder's own lattice",
    neighbours=("coulomb_friction",),
    source="Widrow and Kollár 2008, Sec. 1.1",
    family="encoder",
    is_exact=True,
    left_out="rounding has no slope",
)


def resolution(q: float) -> float:
    """Return the step of the lattice [rad or m]."""
    return q


def in_readings(readings: Readings) -> Shown | None:
    """Return the lattice that the readings are on, where it is coarser than the known one."""
    found = coarser_lattice(readings)
    if found is None:
        return None
    size, unsure, steps = found
    values = {"q": (size, size - unsure, size + unsure)}
    nothing = tuple(np.zeros(len(each), dtype=bool) for each in readings.values)
    return Shown(values, size, nothing, f"no two readings are closer than {size / readings.step:.4g} steps; {steps} such steps were seen")


def laws(place: Place) -> list[Law]:
    """Return no form: a lattice is seen in the readings themselves."""
    return []
