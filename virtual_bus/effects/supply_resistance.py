"""Supply resistance: a supply whose voltage sags while a motor draws current from it."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import SUPPLY, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import DriveState

EFFECT = Effect(
    name="supply_resistance",
    plain="The battery or power supply is weak: the harder the motor is driven, the less it gets of what it is asked for.",
    kind=SUPPLY,
    parameters=(
        Parameter(
            "sag",
            unit="1/A",
            low=0.0,
            high=10.0,
            description="resistance of supply and leads over that of the motor, per command at which the bridge is on all the time",
        ),
        Parameter(
            "ke",
            unit="A s/rad",
            low=0.0,
            high=10000.0,
            description="command that turns the joint without load, per speed: the back-EMF, which the damping of the machine file holds",
            is_strength=False,
            default=0.0,
        ),
    ),
    equation="u - (u - ke speed) sag abs(u) / (1 + sag abs(u))",
    convention=(
        "of a drive that is commanded in volts or duty, whose bridge is on for abs(u) / U of the time: there the motor's current i flows "
        "through the supply too, so that R i + abs(u) / U Rs i = u - ke speed, and sag = Rs / (R U); what acts (and is measured) in place "
        "of the command u is R i + ke speed. No capacitor at the bridge. A drive that is commanded in current keeps it up to "
        "current_saturation, which acts after this"
    ),
    neighbours=("torque_constant", "current_saturation", "motor_load_friction"),
    source="voltage equation of a motor behind a switching bridge, mean over its period (Mohan, Undeland, Robbins 2003, ch. 13)",
    family="drive_limit",
    is_exact=True,
    sought_at=(),
)


def limited(state: DriveState, sag: float, ke: float) -> float:
    """Return what acts in place of a command [drive's unit]."""
    drop = sag * abs(state.current)
    return state.current - (state.current - ke * state.speed) * drop / (1.0 + drop)


def target(current: float, sag: float, ke: float) -> float:
    """Return the command by which this much acts at rest; infinite where none does."""
    left = 1.0 - sag * abs(current)
    return current / left if left > 0.0 else math.copysign(math.inf, current)


def laws(place: Place) -> list[Law]:
    """Return a tenth of the motor's resistance at the largest command, of a motor that stands and of one that runs without load."""
    largest = max(place.current, 1e-9)
    return [one("sag", 0.1 / largest, ke=ke) for ke in (0.0, largest / max(place.speed, 1e-9))]
