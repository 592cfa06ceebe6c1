"""Predictions of every row from those before it, in units of noise that repeats tell: with right equations their errors have unit rms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hil.diagnosis.candidates.columns import column
from hil.diagnosis.model_choice.choose import Choice
from hil.diagnosis.model_choice.fitting import weaker_by
from hil.diagnosis.model_choice.plausibility import signals_of
from hil.diagnosis.prediction.open_runs import Predicted
from hil.diagnosis.residuals.residuals import Residuals
from hil.diagnosis.retuning.linear_model import LinearModel, least_left, linear_at, nominal_offset
from virtual_bus.settings import EffectSetting

Stage = tuple[np.ndarray, Sequence[EffectSetting]]
"""Numbers (P,) in standard deviations of their prior, and effects."""


def one_ahead(choice: Choice, residuals: Residuals, stages: Mapping[str, Stage]) -> Predicted:
    """Return the errors of recordings by channel and stage.

    Offsets of sensors, which differ from one recording to another, are fitted in every stage.

    Parameters
    ----------
    choice : Choice
        Its noise counts.
    residuals : Residuals
        The recordings that are predicted: held-out ones, or those of the answer.
    stages : mapping of str to Stage
    """
    levels = choice.levels.of(min(len(group.repeats) for group in residuals.groups))
    known = choice.residuals.trajectories[0].observed.channels
    channels = residuals.trajectories[0].observed.channels
    levels = levels.with_readings([*(known.index(channel) for channel in channels), *range(len(known), len(levels.sensors))])
    table: dict[str, dict[str, float]] = {channel: {} for channel in channels}
    squares = {}
    for stage, (numbers, effects) in stages.items():
        offset = nominal_offset(residuals.trajectories)
        offset[: len(numbers)] = numbers
        errors, weaker = _errors(linear_at(residuals.trajectories, levels, offset, effects), effects)
        squares[stage] = float(np.nansum((errors / weaker) ** 2))
        for c, channel in enumerate(channels):
            table[channel][stage] = float(np.sqrt(np.nanmean(errors[:, c] ** 2)))
    for channel in channels:
        table[channel]["noise"] = 1.0
    return Predicted(residuals.trajectories[0].observed.period_s, table, errors_of="rows", squares=squares)


def _errors(linear: LinearModel, effects: Sequence[EffectSetting]) -> tuple[np.ndarray, np.ndarray]:
    """Return what is left (rows, channels) in units of noise, with the offsets of sensors that leave least.

    And by how much less (rows, channels) a drive's effort shows in it, as fits count it.
    """
    acting = [signals_of(linear, one, tuple(effects)) for one in linear.records]
    left = [one.innovations - one.whiten([column(one.signals, its)])[:, 0] for one, its in zip(linear.records, acting, strict=True)]
    rows, weaker = [], []
    for one, its, rest in zip(linear.records, acting, least_left(left, [one.offsets for one in linear.records]), strict=True):
        innovations = rest.reshape(one.equations.left.shape)
        rows.append(np.where(one.equations.present, innovations, np.nan))
        weaker.append(np.broadcast_to(weaker_by(one, its), innovations.shape))
    return np.vstack(rows), np.vstack(weaker)
