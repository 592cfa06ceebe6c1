"""What a check of a machine file found, and the machine at one pose that checks look at."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.machine.machine import Machine

if TYPE_CHECKING:
    from hil.machine.closed_loop import Margins


@dataclass(frozen=True)
class Finding:
    """One check's answer."""

    name: str
    """Of the check."""
    ok: bool
    """Whether it is passed."""
    text: str
    """What was found, for a person."""
    values: dict[str, Any] = field(default_factory=dict)
    """Its numbers in SI."""
    is_partial: bool = False
    """A linear answer that does not hold all effects of the file: `note` on the terminal, not `ok`."""

    @property
    def mark(self) -> str:
        """Return the word before its text: `FAIL`, `ok`, or `note` where passing it says less than that."""
        if not self.ok:
            return "FAIL"
        return "note" if self.is_partial or self.name in ("assumed", "left_out") else "ok"


@dataclass(frozen=True)
class PoseResult:
    """The machine at one pose."""

    pose: tuple[float, ...]  # rad or m
    holding: np.ndarray  # (axes,) in the drives' units
    inertia: np.ndarray  # (axes,) kg m^2 or kg at each axis's joint, all others held
    modes: tuple[tuple[float, float], ...]  # frequency [Hz], damping ratio, rising
    pole_radius: float  # NaN without controllers
    margins: tuple[Margins, ...]


def shown_pose(machine: Machine, pose: tuple[float, ...]) -> str:
    """Write a pose in the units people use."""
    parts = []
    for units, position in zip(machine.units, pose, strict=True):
        number = f"{math.degrees(position):.4g} deg" if units.position == "rad" else f"{position:.4g} m"
        parts.append(f"{units.axis} {number}")
    return ", ".join(parts)
