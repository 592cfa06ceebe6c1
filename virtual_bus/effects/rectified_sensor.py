"""Rectified sensor: a channel that has lost its sign, or has the wrong one."""

from __future__ import annotations

from virtual_bus.effects.effect import SIGN, Effect, Parameter
from virtual_bus.effects.law import Law, Place, fixed, one

EFFECT = Effect(
    name="rectified_sensor",
    plain="A sensor has lost its sign: it shows how much, but not which way.",
    kind=SIGN,
    parameters=(
        Parameter("share", unit="", low=0.0, high=1.0, description="0: sign kept, 1: magnitude only"),
        Parameter(
            "sign", unit="", low=-1.0, high=1.0, description="+1, or -1 for a channel wired the wrong way round", neutral=1.0, fixed=True
        ),
    ),
    equation="y = abs(x), or -x",
    convention=(
        "reading = sign (x + share (abs(x) - x)) of the noise-free value, before noise and lattice; sign +1 and share 0 is no effect"
    ),
    neighbours=("constant_load",),
    source="CoupledDrives benchmark (Wigren and Schoukens 2017): pulse counters without direction",
    family="sign",
    is_exact=True,
    left_out="a lost sign has a corner at zero",
    left_out_of=("share",),
)


def signed(value: float, share: float, sign: float) -> float:
    """Return the channel before noise and lattice."""
    return sign * (value + share * (abs(value) - value))


def laws(place: Place) -> list[Law]:
    """Return a share of the magnitude, and the other sign."""
    return [one("share", 0.1, sign=1.0), fixed(share=0.0, sign=-1.0)]
