"""Has a fitted effect kept its own equation?

A fit that runs into a bound of what decides an effect's shape (a corner speed, a frequency, a stiffness) wants another law: a mode damped
until it no longer swings is a damper, a Stribeck speed above every speed that was driven is viscous friction. So is a wave of which the
motion shows less than a part of a cycle: an offset and a slope. A strength at the bound that no real machine exceeds is not that machine's
either, and no oil is viscous one way only: a load beside dry friction looks like that. A gap in which a spring keeps nearly all of its
stiffness is a spring that hardens.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.diagnosis.refit import Fitted
from hil.diagnosis.result import EffectAt
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.registry import effects

NO_LONGER_SWINGS = (("structural_mode", "zeta"),)
"""Numbers without a unit whose upper bound is the end of the law; others are exponents and shares, which may be there."""

DECIDE_THE_SHAPE = ("rad/s", "Hz", "cycles/turn", "Nm/rad", "rad")
"""Units of numbers whose bounds, but zero, are far outside of what the law is made for. A time longer than any recording is none: it is a
drift."""

SHARES = ("share", "sign", "p")
"""Strengths that may be all there is of them."""

WITHOUT = (("imu_bandwidth", "fc"),)
"""Numbers whose bound is the law without its term: a sensor without a low pass is one whose machine file says too much of it."""

OF_WAVES = ("cycles/turn", "Hz")

OF_A_REFINEMENT = (("presliding_hysteresis", "vs"), ("encoder_eccentricity", "Nl"))
"""Numbers of a second term, which may be zero and then says nothing of them."""

ONE_WAY = {"asymmetric_friction": ("Fv_plus", "Fv_minus")}
"""Numbers of the two directions, of which none is zero beside another that counts."""

NO_GAP = 0.9
"""Share of the spring's stiffness within a backlash from which on there is no gap."""

COUNTS = 0.01
"""Share of an effect's energy in the recordings from which a number of it counts: as much as an equation errs by (`naming.py`)."""

AT_BOUND = 1e-6
"""Of a bound's size."""


def lost_form(fitted: Fitted, lowest: Mapping[EffectAt, float]) -> str:
    """What left its equation, as a sentence; "" where every effect kept it.

    Parameters
    ----------
    fitted : Fitted
    lowest : mapping of EffectAt to float
        Of effects that are waves, the number of cycles per turn or second below which the recordings show no wave.
    """
    for number, (effect, values) in enumerate(zip(fitted.effects, fitted.values, strict=True)):
        if effect.effect in ONE_WAY and (name := _one_way(fitted, number)):
            return f"{effect} has {name} and none of it the other way: what fits is no longer that effect"
        if effect.effect == "backlash" and (inside := _stiffness_within(*values)) > NO_GAP:
            return f"{effect} leaves the spring {inside:.0%} of its stiffness within the gap: what fits is no longer that effect"
        for parameter, value in zip(effects()[effect.effect].parameters, values, strict=True):
            if (effect.effect, parameter.name) in OF_A_REFINEMENT:
                continue
            bound = _bound(effect.effect, parameter, float(value))
            if bound is not None:
                return f"{effect} has {parameter.name} at its bound of {bound:g}: what fits is no longer that effect"
            if parameter.unit in OF_WAVES and value < lowest.get(effect, 0.0):
                return f"{effect} has {parameter.name} = {value:.3g} {parameter.unit}, of which the recordings show less than half a cycle"
    return ""


def _stiffness_within(b: float, flank: float) -> float:
    """Of a gap, as a share of the spring's."""
    return float(flank / (b + flank)) if b + flank > 0.0 else 0.0


def _bound(name: str, parameter: Parameter, value: float) -> float | None:
    """The bound that a parameter is at, if it ends the law there. Zero ends none: what is without damping has none."""
    ends = [parameter.low, parameter.high] if parameter.unit in DECIDE_THE_SHAPE or parameter.is_strength else []
    if parameter.name in SHARES or (name, parameter.name) in WITHOUT:
        ends = []
    if (name, parameter.name) in NO_LONGER_SWINGS:
        ends = [parameter.high]
    return next((end for end in ends if end not in (0.0, parameter.neutral) and np.isclose(value, end, rtol=AT_BOUND, atol=0.0)), None)


def _one_way(fitted: Fitted, number: int) -> str:
    """Which of the two directions' numbers stands alone and counts; "" where none does."""
    effect, values = fitted.effects[number], fitted.values[number]
    names = [parameter.name for parameter in effects()[effect.effect].parameters]
    alone = [name for name in ONE_WAY[effect.effect] if values[names.index(name)] > 0.0]
    if len(alone) != 1:
        return ""
    parts = {names[p]: values[p] * fitted.jacobian[:, column] for column, (k, p) in enumerate(fitted.free) if k == number}
    own, whole = parts.get(alone[0], np.zeros(1)), sum(parts.values(), np.zeros(1))
    return alone[0] if own @ own > COUNTS * (whole @ whole) else ""
