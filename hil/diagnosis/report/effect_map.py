"""An effect's own map: the effort the simulation lacks against what the effect depends on, and what the fitted effect says there.

Recording and fit go through the same estimator (disturbance.py), so what it smooths in one it smooths in the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.locating.disturbance import Estimator, ends
from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.motion import Motion
from hil.pages import Band, Chart, Charts, Scale, Series
from virtual_bus.effects.effect import (
    CALIBRATION,
    CLOCK,
    DROPOUT,
    ELASTIC,
    ENCODER_ERROR,
    FRICTION,
    IMU_CHANGE,
    LATTICE,
    SIGN,
    SPRING_CHANGE,
)
from virtual_bus.effects.places import joint_at, spring_at
from virtual_bus.effects.registry import effects

SENSOR_KINDS = (CALIBRATION, CLOCK, DROPOUT, ENCODER_ERROR, IMU_CHANGE, LATTICE, SIGN)
BY_SPEED = ("power_law_friction", "quadratic_friction", "temperature_dependent_friction", "viscous_friction", "presliding_hysteresis")
OVER_POSITION = ("position_dependent_friction",)
ON_A_SPRING = (ELASTIC, SPRING_CHANGE)
CELLS = 40
LEAST_ROWS = 5
BAND = 1.96
EFFECT_PX = 300


@dataclass(frozen=True, eq=False)
class EffectMap:
    """Cells of one effect's map.

    Attributes
    ----------
    x, recorded, fitted : (cells,) arrays
        Means; NaN where nothing was.
    band : (cells,) array
        Half width of the 95 % band of the recorded mean.
    """

    title: str
    x_label: str
    y_label: str
    x: np.ndarray
    recorded: np.ndarray
    fitted: np.ndarray
    band: np.ndarray


def effect_map(
    found: Mismatch,
    bare: Sequence[np.ndarray],
    extended: Sequence[np.ndarray],
    effect: EffectAt,
    values: np.ndarray,
    period_s: float | None = None,
) -> EffectMap | None:
    """The map of one effect.

    Parameters
    ----------
    found : Mismatch
    bare, extended : sequence of (N, C) arrays
        Simulated rows per group without and with the effects, all other numbers the same.
    effect : EffectAt
    values : (parameters,) array
        Plant parameters of both.
    period_s : float, optional
        Of an effect that acts by a clock of its own.
    """
    kind = effects()[effect.effect].kind
    if kind in SENSOR_KINDS:
        return _sensor_map(found, bare, extended, effect)
    settings = found.machine.plant
    by_name = [each.name for each in settings.tree.joints]
    spring = spring_at(effect.at, settings) if kind in ON_A_SPRING else None
    joint = by_name.index(spring or joint_at(effect.at, settings))
    axis = _axis_of(found, joint)
    over = _abscissa(found, effect, joint, period_s)
    xs, recorded, fitted = [], [], []
    for group, plain, full in zip(found.groups, bare, extended, strict=True):
        sign = -np.sign(group.speed[:, axis]) if over.against_motion else np.ones(len(plain))
        known = slice(ends(len(plain), found.noise.rate_Hz), len(plain) - ends(len(plain), found.noise.rate_Hz))
        estimator = Estimator(found, group, values)
        recorded.append((sign * estimator.effort(group.mean - plain)[:, joint])[known])
        fitted.append((sign * estimator.effort(full - plain)[:, joint])[known])
        xs.append(over.of(Motion(group.machine, values, group, found.channels))[known])
    effort_unit = "Nm" if settings.tree.joints[joint].kind == "revolute" else "N"
    what = "missing effort against the motion" if over.against_motion else "missing effort"
    return _cells(
        f"{effect}: {what} over {over.name}", f"{over.name} [{over.unit}]", f"{what}, on {by_name[joint]} [{effort_unit}]",
        np.concatenate(xs), np.concatenate(recorded), np.concatenate(fitted),
    )  # fmt: skip


@dataclass(frozen=True)
class _Over:
    """What an effect depends on."""

    name: str
    unit: str
    of: Callable[[Motion], np.ndarray]  # (N,) of a group
    against_motion: bool = False


def _abscissa(found: Mismatch, effect: EffectAt, joint: int, period_s: float | None) -> _Over:
    """Speed, position, a spring's deflection, or, of what acts by a clock, the time in its period."""
    settings, kind = found.machine.plant, effects()[effect.effect].kind
    axis = _axis_of(found, joint)
    units = found.machine.units[axis]
    if period_s is not None:
        return _Over("time in the period", "s", lambda motion: (motion.group.time_s - motion.group.time_s[0] + motion.start_s) % period_s)
    if settings.tree.joints[joint].name not in {drive.joint for drive in settings.drives} and settings.tree.joints[joint].stiffness > 0.0:
        unit = "rad" if settings.tree.joints[joint].kind == "revolute" else "m"
        return _Over(f"deflection of {settings.tree.joints[joint].name}", unit, lambda motion: motion.deflection(joint))
    if effect.effect in OVER_POSITION:
        return _Over(f"position of {units.axis}", units.position, lambda motion: motion.group.position[:, axis], against_motion=True)
    if kind is FRICTION or effect.effect in BY_SPEED:
        return _Over(f"speed of {units.axis}", f"{units.position}/s", lambda motion: motion.group.speed[:, axis])
    return _Over(f"position of {units.axis}", units.position, lambda motion: motion.group.position[:, axis])


def _sensor_map(found: Mismatch, bare: Sequence[np.ndarray], extended: Sequence[np.ndarray], effect: EffectAt) -> EffectMap | None:
    """A sensor's reading against what the machine without its error would show."""
    columns = [c for c, name in enumerate(found.channels) if name == effect.at]
    columns = columns or [c for c, name in enumerate(found.channels) if name.startswith(("imu_", "gyro_"))]
    if not columns:
        return None
    change = sum(np.sum((full - plain) ** 2, axis=0) for plain, full in zip(bare, extended, strict=True)) / found.noise.std**2
    c = max(columns, key=lambda column: change[column])
    x = np.concatenate([plain[:, c] for plain in bare])
    recorded = np.concatenate([group.mean[:, c] for group in found.groups])
    fitted = np.concatenate([full[:, c] for full in extended])
    name, unit = found.channels[c], found.units[c]
    title = f"{effect}: reading against the machine"
    return _cells(title, f"{name} simulated without it [{unit}]", f"{name} [{unit}]", x, recorded, fitted)


def _axis_of(found: Mismatch, joint: int) -> int:
    """The axis that drives a joint, or the nearest one before it in the tree."""
    settings = found.machine.plant
    driven = [settings.tree.joint_index(drive.joint) for drive in settings.drives]
    before = [k for k, j in enumerate(driven) if j <= joint]
    return driven.index(joint) if joint in driven else max(before, key=lambda k: driven[k], default=0)


def _cells(title: str, x_label: str, y_label: str, x: np.ndarray, recorded: np.ndarray, fitted: np.ndarray) -> EffectMap | None:
    if not np.ptp(x) > 0.0:
        return None
    edges = np.linspace(x.min(), x.max(), CELLS + 1)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, CELLS - 1)
    rows = np.bincount(place, minlength=CELLS).astype(float)
    rows[rows < LEAST_ROWS] = np.nan

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(place, weights=values, minlength=CELLS) / rows

    scatter = np.sqrt(np.maximum(mean(recorded**2) - mean(recorded) ** 2, 0.0))
    enters = np.flatnonzero(np.diff(place, prepend=-1))
    passes = np.maximum(np.bincount(place[enters], minlength=CELLS), 1)  # neighbouring rows of one pass are not independent
    return EffectMap(title, x_label, y_label, mean(x), mean(recorded), mean(fitted), BAND * scatter / np.sqrt(passes))


def effect_map_charts(drawn: EffectMap) -> Charts:
    """Recorded cells with their band, and the fit."""
    seen = np.isfinite(drawn.x)
    x = drawn.x[seen]
    series = [Series("recorded", x, drawn.recorded[seen], is_points=True, look=0), Series("fitted effect", x, drawn.fitted[seen], look=1)]
    band = Band("95 % band", x, (drawn.recorded - drawn.band)[seen], (drawn.recorded + drawn.band)[seen])
    return Charts([Chart(drawn.title, Scale(drawn.x_label), Scale(drawn.y_label), series, [band], height=EFFECT_PX)])
