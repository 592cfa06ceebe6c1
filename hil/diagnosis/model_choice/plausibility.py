"""Whether a fitted set may be a finding: what takes most of a drive's effort away, or is pressed against a bound, explains nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.free_runs.runs import FreeRuns
from hil.diagnosis.residuals.trajectory import Signals
from hil.diagnosis.retuning.linear_model import LinearModel, LinearRecord
from virtual_bus.effects.effect import PHASE, Parameter
from virtual_bus.errors import EffectError
from virtual_bus.settings import EffectSetting

MOST = 0.5
"""Share of its effort that a drive keeps under any effect that explains what it did."""
SURELY = 3.0
"""Standard deviations beyond a bound at which a parameter would be."""


def are_driven(linear: LinearModel, settings: tuple[EffectSetting, ...]) -> bool:
    """Return whether every drive gives MOST of its effort with these effects: what takes more away explains no motion that it drove."""
    if not settings:
        return True
    try:
        driven = sum(np.sum(signals_of(linear, one, settings).driven ** 2, axis=0) for one in linear.records)
    except EffectError:  # along this motion it cannot be told
        return True
    return bool(np.all(driven >= MOST**2 * sum(np.sum(one.signals.driven**2, axis=0) for one in linear.records)))


def on_bound(
    settings: tuple[EffectSetting, ...], parameters: Sequence[tuple[int, Parameter]], columns: Sequence[np.ndarray],
    left: Sequence[np.ndarray], dispersion: float,
) -> bool:  # fmt: skip
    """Return whether a parameter lies on a bound, beyond which it would surely leave less. A strength on its neutral value does not."""
    for column_of, (k, parameter) in enumerate(parameters, columns[0].shape[1] - len(parameters)):
        value = settings[k].parameters[parameter.name]
        if parameter.unit == PHASE or (parameter.is_strength and value == parameter.neutral):
            continue
        slope = sum(float(each[:, column_of] @ rest) for each, rest in zip(columns, left, strict=True))
        square = sum(float(each[:, column_of] @ each[:, column_of]) for each in columns)
        outward = (value <= parameter.low and slope < 0.0) or (value >= parameter.high and slope > 0.0)
        if outward and slope**2 > SURELY**2 * square * dispersion:
            return True
    return False


def pressed_against(
    view: LinearModel | FreeRuns, offset: np.ndarray, columns: Sequence[np.ndarray], left: Sequence[np.ndarray], dispersion: float
) -> np.ndarray:
    """Return which nuisances (P,) lie on a bound and would leave less beyond it."""
    low, high = view.bounds
    moved = offset - view.offset
    slopes = sum(each[:, : len(offset)].T @ rest for each, rest in zip(columns, left, strict=True)) / dispersion - offset
    pressed: np.ndarray = ((moved <= low) & (slopes < 0.0)) | ((moved >= high) & (slopes > 0.0))
    return pressed


def signals_of(linear: LinearModel, one: LinearRecord, settings: tuple[EffectSetting, ...]) -> Signals:
    """Return what the tuned machine does along a recording with these effects."""
    trajectory = one.equations.trajectory
    return trajectory.signals(one.motion, trajectory.model(linear.values, settings), settings, nearby=one.signals)
