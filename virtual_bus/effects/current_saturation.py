"""Current saturation: an amplifier that cannot supply the current it is asked for."""

from __future__ import annotations

from virtual_bus.effects.effect import LIMIT, Effect, Parameter
from virtual_bus.effects.law import Law, Place, fixed
from virtual_bus.effects.motion import DriveState

EFFECT = Effect(
    name="current_saturation",
    plain="The drive cannot give as much current as it is asked for: at high effort or speed it falls short.",
    kind=LIMIT,
    parameters=(
        Parameter(
            "imax",
            unit="A",
            low=1e-06,
            high=1000.0,
            description="largest current at standstill: the smaller of the amplifier's limit and V / R",
            neutral=1000.0,
        ),
        Parameter("droop", unit="A s/rad", low=0.0, high=10000.0, description="fall of the limit per speed of the joint: Ke N / R"),
    ),
    equation="sat(i, imax - droop abs(speed))",
    convention=(
        "the current is cut to +-max(0, imax - droop abs(speed)), both ways alike, after delay and drive_bandwidth; the "
        "measured current is the cut one"
    ),
    neighbours=("torque_constant", "end_stop"),
    source="imax(speed) = (V - Ke speed) / R, the voltage equation of a motor at constant current",
    family="drive_limit",
    is_exact=True,
    left_out="within its limit it does nothing, and what it cuts of large motions has no slope",
)


def limited(state: DriveState, imax: float, droop: float) -> float:
    """Return the part of the current [drive's unit] that flows."""
    limit = max(imax - droop * abs(state.speed), 0.0)
    return min(max(state.current, -limit), limit)


def laws(place: Place) -> list[Law]:
    """Return limits below the largest current, the same at all speeds or falling with it."""
    limits = (place.current * share for share in (0.95, 0.85, 0.7, 0.55))
    return [fixed(imax=limit, droop=droop * limit / max(place.speed, 1e-9)) for limit in limits for droop in (0.0, 0.5)]
