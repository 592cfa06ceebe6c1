"""Units of the machine file: a key ends in its unit (`range_deg`, `stiffness_Nm_rad`), and everything is SI once it is read.

A unit belongs to exactly one dimension; a quantity lists the dimensions it may have, since one key serves revolute and prismatic joints.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_DEG = math.pi / 180.0

# dimension -> unit as written at the end of a key -> factor to SI (or to the drive's own unit for efforts)
UNITS: dict[str, dict[str, float]] = {
    "angle": {"rad": 1.0, "deg": _DEG, "mrad": 1e-3},
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "angular_speed": {"rad_s": 1.0, "deg_s": _DEG},
    "speed": {"m_s": 1.0, "mm_s": 1e-3},
    "angular_acceleration": {"rad_s2": 1.0, "deg_s2": _DEG},
    "acceleration": {"m_s2": 1.0, "mm_s2": 1e-3},
    "angular_jerk": {"rad_s3": 1.0, "deg_s3": _DEG},
    "jerk": {"m_s3": 1.0, "mm_s3": 1e-3},
    "mass": {"kg": 1.0, "g": 1e-3},
    "inertia": {"kg_m2": 1.0, "kg_cm2": 1e-4, "g_cm2": 1e-7},
    "rotational_stiffness": {"Nm_rad": 1.0, "Nm_deg": 1.0 / _DEG},
    "stiffness": {"N_m": 1.0, "N_mm": 1e3},
    "rotational_damping": {"Nm_s_rad": 1.0},
    "damping": {"N_s_m": 1.0},
    "torque": {"Nm": 1.0, "mNm": 1e-3},
    "force": {"N": 1.0, "kN": 1e3},
    "current": {"A": 1.0, "mA": 1e-3},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "share": {"permille": 1e-3, "percent": 1e-2},
    "time": {"s": 1.0, "ms": 1e-3},
    "frequency": {"Hz": 1.0, "kHz": 1e3},
    "temperature": {"degC": 1.0},
    "temperature_step": {"K": 1.0},
    "temperature_rate": {"K_s": 1.0},
    "heating": {"K_per_A2": 1.0, "K_per_V2": 1.0, "K_per_Nm2": 1.0, "K_per_N2": 1.0},
}

EFFORT_DIMENSIONS = ("current", "voltage", "torque", "force")
_MOTIONS = {"angle": "length", "angular_speed": "speed", "angular_acceleration": "acceleration", "angular_jerk": "jerk"}
_LOADS = {"rotational_stiffness": "stiffness", "rotational_damping": "damping", "torque": "force"}
ANGULAR = frozenset(_MOTIONS | _LOADS)
LINEAR = frozenset((_MOTIONS | _LOADS).values())

# `constant_unit` of a drive: motor effort per unit of command
CONSTANT_UNITS: dict[str, tuple[str, str, float]] = {
    "Nm/A": ("Nm", "A", 1.0),
    "mNm/A": ("Nm", "A", 1e-3),
    "N/A": ("N", "A", 1.0),
    "Nm/V": ("Nm", "V", 1.0),
    "N/V": ("N", "V", 1.0),
    "Nm/Nm": ("Nm", "Nm", 1.0),
    "N/N": ("N", "N", 1.0),
}


@dataclass(frozen=True)
class Quantity:
    """Marks a field whose key carries a unit: `Annotated[float, Quantity("angle", "length")]`."""

    dimensions: tuple[str, ...]

    def __init__(self, *dimensions: str) -> None:
        object.__setattr__(self, "dimensions", dimensions)

    @property
    def units(self) -> dict[str, float]:
        """Every unit that this quantity may be written in, with its factor to SI."""
        return {unit: factor for dimension in self.dimensions for unit, factor in UNITS[dimension].items()}

    def dimension_of(self, unit: str) -> str:
        """Return the dimension of this quantity that a unit belongs to."""
        return next(dimension for dimension in self.dimensions if unit in UNITS[dimension])
