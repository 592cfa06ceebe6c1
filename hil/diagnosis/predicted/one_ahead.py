"""Predictions of every row from those before it, in units of noise that repeats tell: with right equations their errors have unit rms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hil.diagnosis.candidates.columns import column
from hil.diagnosis.named.naming import Named
from hil.diagnosis.named.plausible import signals_of
from hil.diagnosis.predicted.open_runs import Predicted
from hil.diagnosis.seen.see import Seen
from hil.diagnosis.tuned.retuning import Looked, Tuned, least_left, nominal_offset, tuned_at
from virtual_bus.settings import EffectSetting

Stage = tuple[np.ndarray, Sequence[EffectSetting]]
"""Numbers (P,) in standard deviations of their prior, and effects."""


def one_ahead(named: Named, seen: Seen, stages: Mapping[str, Stage]) -> Predicted:
    """Return the errors of recordings by channel and stage.

    Offsets of sensors, which differ from one recording to another, are fitted in every stage.

    Parameters
    ----------
    named : Named
        Its noise counts.
    seen : Seen
        The recordings that are predicted: held-out ones, or those of the answer.
    stages : mapping of str to Stage
    """
    levels = named.levels.of(min(len(group.repeats) for group in seen.groups))
    known = named.seen.alongs[0].observed.channels
    channels = seen.alongs[0].observed.channels
    levels = levels.with_readings([*(known.index(channel) for channel in channels), *range(len(known), len(levels.sensors))])
    table: dict[str, dict[str, float]] = {channel: {} for channel in channels}
    for stage, (numbers, effects) in stages.items():
        offset = nominal_offset(seen.alongs)
        offset[: len(numbers)] = numbers
        errors = _errors(tuned_at(seen.alongs, levels, offset, effects), effects)
        for c, channel in enumerate(channels):
            table[channel][stage] = float(np.sqrt(np.nanmean(errors[:, c] ** 2)))
    for channel in channels:
        table[channel]["noise"] = 1.0
    return Predicted(seen.alongs[0].observed.period_s, table, errors_of="rows")


def _errors(tuned: Tuned, effects: Sequence[EffectSetting]) -> np.ndarray:
    """Return what is left (rows, channels) in units of noise, with the offsets of sensors that leave least."""
    left = least_left([one.innovations - _done(one, tuned, effects) for one in tuned.looked], [one.offsets for one in tuned.looked])
    rows = []
    for one, rest in zip(tuned.looked, left, strict=True):
        innovations = rest.reshape(one.beside.left.shape)
        rows.append(np.where(one.beside.present, innovations, np.nan))
    return np.vstack(rows)


def _done(one: Looked, tuned: Tuned, effects: Sequence[EffectSetting]) -> np.ndarray:
    if not effects:
        return np.zeros_like(one.innovations)
    return np.asarray(one.whiten([column(one.signals, signals_of(tuned, one, tuple(effects)))])[:, 0])
