"""Encoder eccentricity: a scale that is off its axis, and an error within every line of it."""

from __future__ import annotations

import math

import numpy as np

from virtual_bus.effects.effect import ENCODER_ERROR, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one, wave

EFFECT = Effect(
    name="encoder_eccentricity",
    plain="The encoder's disc is not centred: over each turn it reads a little too much, then too little.",
    kind=ENCODER_ERROR,
    parameters=(
        Parameter("a", unit="rad", low=0.0, high=0.1, description="amplitude of the error once per turn"),
        Parameter("phi", unit="phase", low=-6.283185307179586, high=6.283185307179586, description="phase", is_strength=False),
        Parameter("b", unit="rad", low=0.0, high=0.1, description="amplitude of the error per line"),
        Parameter(
            "Nl",
            unit="cycles/turn",
            low=0.001,
            high=100000.0,
            description="lines per turn of the joint (a prismatic joint: radians per metre)",
            is_strength=False,
        ),
    ),
    equation="y = position + a cos(position + phi) + b cos(Nl position)",
    convention=(
        "error added to what the encoder sees, at the joint, before its lattice; an incremental encoder counts from the start, "
        "where its error is taken as zero"
    ),
    neighbours=("transmission_error", "cogging"),
    source="thesis ch. 3; Kavanagh 2001",
    family="periodic_position",
    is_exact=True,
)


SMALL_rad = 1e-5
"""At the joint: what a good encoder errs by."""


def error(position: float, a: float, phi: float, b: float, Nl: float) -> float:
    """Return what the encoder sees beyond the joint's position [rad or m]."""
    return a * math.cos(position + phi) + b * math.cos(Nl * position)


def laws(place: Place) -> list[Law]:
    """Return once a turn, of which a short arc shows the curvature, and with lines; what slides does not turn."""
    if place.is_prismatic:
        return [one("b", SMALL_rad, a=0.0, phi=0.0, Nl=order) for order in place.orders()]
    return [wave("a", "phi", SMALL_rad, b=0.0, Nl=2.0), *(_with_lines(order) for order in place.orders() if order != 1.0)]


def _with_lines(order: float) -> Law:
    """Return once a turn together with lines of this order."""
    columns = (*wave("a", "phi", SMALL_rad, b=0.0, Nl=order).columns, {"a": 0.0, "phi": 0.0, "b": SMALL_rad, "Nl": order})

    def parameters(w: np.ndarray) -> dict[str, float]:
        a, phi = SMALL_rad * float(np.hypot(w[0], w[1])), float(np.arctan2(w[1], w[0]))
        return {"a": a, "phi": phi, "b": SMALL_rad * max(float(w[2]), 0.0), "Nl": order}

    return Law(columns, parameters, -math.inf)
