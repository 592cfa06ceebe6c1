"""Base motion: an external disturbance of fixed frequency that is there with the drives off too."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import EFFORT, Effect, Parameter
from virtual_bus.effects.law import Law, Place, wave
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="base_motion",
    plain="The floor or the ceiling shakes the machine at one frequency.",
    kind=EFFORT,
    parameters=(
        Parameter("A", unit="Nm", low=0.0, high=100000.0, description="amplitude"),
        Parameter("f", unit="Hz", low=0.001, high=500.0, description="frequency", is_strength=False),
        Parameter("phi", unit="phase", low=-6.283185307179586, high=6.283185307179586, description="phase", is_strength=False),
    ),
    equation="A sin(2 pi f t + phi)",
    convention=(
        "effort on the joint = +A sin(2 pi f t + phi) from the first SYNC (t = 0) on; at a body it acts along the joint that "
        "carries the body: at a mount on the floor or ceiling it is the building that shakes"
    ),
    neighbours=("structural_mode",),
    source="IEEE Std 1293, vibration of the test pier",
    family="external",
    is_exact=True,
    left_out="it moves the machine by itself, whatever the drives do",
)


def effort(motion: JointMotion, A: float, f: float, phi: float) -> float:
    """Return the effort [Nm or N] on the joint."""
    return A * math.sin(2.0 * math.pi * f * motion.time_s + phi) if motion.time_s >= 0.0 else 0.0


def laws(place: Place) -> list[Law]:
    """Return the strongest lines, a sine of free phase each."""
    return [wave("A", "phi", f=f) for f in place.lines_Hz()]
