"""Which effects at which places may have been left out, and where a fit of each may start."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.shape_limits import NO_LIMIT, shape_limits
from hil.diagnosis.starting.starts import shapes_of, starts_of
from virtual_bus.effects.effect import CLOCK, DROPOUT, SIGN, Effect
from virtual_bus.effects.places import is_prismatic, joint_at, places, spring_at
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting, PlantSettings

ON_A_SPRING = ("joint_compliance", "nonlinear_stiffness", "backlash", "structural_mode", "base_motion", "bouc_wen_hysteresis")
"""What may act at a joint without a drive: it moves as far as its spring gives way, so a law over its own range would show nothing."""

NEEDS_GRAVITY = ("gravity_imbalance",)
"""What no machine has whose file says that gravity does nothing to it: a circuit, a balanced rotor, a level slide. Nor has a joint that
slides: the sine of a position in metres is no law of a weight, which is a constant load there and could not be told from it."""

WHOLE_IMU = "imu"


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect at one place, with the parameter values a fit may start from, in the catalogue's order."""

    effect: EffectAt
    starts: tuple[np.ndarray, ...]  # each (parameters,)
    shapes: float = 1.0  # searched between starts and fit, see `starts.shapes_of`
    limits: tuple[float, float] = NO_LIMIT  # between which recordings show its shape, see `shape_limits.py`

    def setting(self, values: np.ndarray) -> EffectSetting:
        """The effect with these parameters."""
        return setting_of(self.effect, values)


def setting_of(effect: EffectAt, values: np.ndarray) -> EffectSetting:
    """An effect with these parameters, in the catalogue's order."""
    names = [parameter.name for parameter in effects()[effect.effect].parameters]
    return EffectSetting(effect.effect, effect.at, dict(zip(names, (float(value) for value in values), strict=True)))


def candidates(
    motion: Motion,
    channels: Sequence[str],
    present: Sequence[EffectAt] = (),
    at_once: Callable[[Callable[[EffectAt], Candidate | None], Sequence[EffectAt]], Iterable[Candidate | None]] = map,
) -> list[Candidate]:
    """All effects of the catalogue at the places of this machine where recordings could show them.

    Parameters
    ----------
    motion : Motion
        How the machine moved and what is missing at each place.
    channels : sequence of str
        Recorded and compared.
    present : sequence of EffectAt
        Found already. Of those that may act at a place several times, the next one is tried there.
    at_once : callable
        Looks at every place, as `map` does one after another.
    """

    def at(place: EffectAt) -> Candidate | None:
        if effects()[place.effect].several:
            place = replace(place, number=1 + sum((one.effect, one.at) == (place.effect, place.at) for one in present))
        starts = starts_of(place.effect, place.at, motion)
        if not starts:
            return None
        shapes = shapes_of(place.effect, place.at, motion, len(starts))
        return Candidate(place, tuple(starts), shapes, shape_limits(place.effect, place.at, motion))

    return [found for found in at_once(at, places_to_try(motion.machine.plant, channels)) if found is not None]


def places_to_try(settings: PlantSettings, channels: Sequence[str]) -> list[EffectAt]:
    """Every effect once at every place that is physically another one; of those the machine has, such as may act there several times."""
    driven = {drive.joint for drive in settings.drives}
    chosen: list[EffectAt] = []
    taken = {(one.name, _place(one.name, one.at, settings)) for one in settings.effects if not effects()[one.name].several}
    of_imus = [channel for channel in channels if channel.startswith(("imu_", "gyro_"))]
    for name, effect in effects().items():
        if effect.kind is DROPOUT or effect.is_slow or (name in NEEDS_GRAVITY and not np.any(settings.tree.gravity_m_s2)):
            continue
        is_of_readings = effect.kind in (CLOCK, SIGN) or "encoder" in effect.kind.allowed_at
        for at in places(effect.kind, settings):
            if name in NEEDS_GRAVITY and is_prismatic(at, settings):
                continue
            key = _place(name, at, settings)
            if _is_at_a_joint(effect):
                if key not in driven and (name not in ON_A_SPRING or spring_at(at, settings) is None):
                    continue
            elif is_of_readings and at not in channels and not (effect.kind is CLOCK and at == WHOLE_IMU and len(of_imus) > 1):
                continue  # of a single channel's clock and its IMU's nothing tells which it is
            if "imu" in effect.kind.allowed_at and not of_imus:
                continue
            if (name, key) not in taken:
                taken.add((name, key))
                chosen.append(EffectAt(name, at))
    return chosen


def _place(name: str, at: str, settings: PlantSettings) -> str:
    """What is the same for all names of a place where an effect is physically the same."""
    effect = effects()[name]
    if effect.kind.needs == "spring":
        return spring_at(at, settings) or at
    return joint_at(at, settings) if _is_at_a_joint(effect) else at


def _is_at_a_joint(effect: Effect) -> bool:
    return effect.kind.needs != "spring" and {"axis", "body"} <= set(effect.kind.allowed_at)
