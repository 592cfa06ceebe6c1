"""End stop: a stiff spring and damper beyond a position."""

from __future__ import annotations

from virtual_bus.effects.effect import EFFORT, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="end_stop",
    plain="The joint hits a buffer, which pushes it back.",
    kind=EFFORT,
    parameters=(
        Parameter("K", unit="Nm/rad", low=0.0, high=10000000.0, description="stiffness"),
        Parameter("D", unit="Nm s/rad", low=0.0, high=100000.0, description="damping while in contact"),
        Parameter("at_position", unit="rad", low=-10.0, high=10.0, description="where the stop begins", is_strength=False),
        Parameter(
            "side",
            unit="",
            low=-1.0,
            high=1.0,
            description="+1: it stops motion beyond at_position towards positive position, -1: towards negative; its sign counts",
            is_strength=False,
            fixed=True,
        ),
    ),
    equation="K depth + D depth', depth >= 0 past the stop, effort never sticky",
    convention=(
        "effort on the joint = -side max(0, K depth + D depth') with depth = side (position - at_position) > 0, on the joint's "
        "side of the gear: a stop pushes, it never pulls"
    ),
    neighbours=("current_saturation", "cable_spring"),
    source="Hunt and Crossley 1975 (linear case)",
    family="end_stop",
)


def effort(motion: JointMotion, K: float, D: float, at_position: float, side: float) -> float:
    """Return the effort [Nm or N] on the joint."""
    towards = 1.0 if side > 0.0 else -1.0
    depth = towards * (motion.position - at_position)
    return -towards * max(K * depth + D * towards * motion.speed, 0.0) if depth > 0.0 else 0.0


def laws(place: Place) -> list[Law]:
    """Return stops within the outer tenth of the range on either side."""
    return [
        one("K", D=0.0, at_position=end - side * share * place.travel, side=side)
        for side, end in ((-1.0, place.low), (1.0, place.high))
        for share in (0.01, 0.03, 0.1)
    ]
