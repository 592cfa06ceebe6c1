"""The signals of any MDF file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import cast

import numpy as np
from asammdf import MDF, Signal

from hil.recording.can_tables import Group, is_of_frames
from hil.recording.naming import Column, Columns

_UNFIT = re.compile(r'[,"\[\]\x00-\x1f\x7f]')


def mdf4_columns(mdf: MDF) -> Columns:
    """Return every signal of numbers with its times; a name that signals of several groups have gets the group's number, `speed@3`."""
    found: dict[str, list[tuple[int, Column]]] = {}
    others: dict[str, str] = {}
    for number, group in enumerate(cast(Sequence[Group], mdf.groups)):
        if is_of_frames(group) and group.channel_group.cycles_nr:
            others[f"CAN frames of group {number}"] = f"{group.channel_group.cycles_nr} of them, beside signals"
    for place, signal in _signals(mdf):
        name = _UNFIT.sub("_", signal.name).strip()
        if signal.samples.ndim != 1 or signal.samples.dtype.kind not in "fiub":
            others[name] = "text or an array"
        elif not signal.samples.size:
            others[name] = "without samples"
        else:
            found.setdefault(name, []).append((place, _column(signal)))
    columns: dict[str, Column] = {}
    several: dict[str, list[str]] = {}
    for name, those in found.items():
        if len(those) == 1:
            columns[name] = those[0][1]
            continue
        groups = [group for group, _ in those]
        once = len(set(groups)) == len(groups)
        several[name] = [f"{name}@{group}" if once else f"{name}@{group}.{place}" for place, group in enumerate(groups)]
        columns |= dict(zip(several[name], (column for _, column in those), strict=True))
    return Columns(columns, several, others)


def _column(signal: Signal) -> Column:
    values = np.asarray(signal.samples, dtype=np.float64)
    if signal.invalidation_bits is not None:
        values = np.where(signal.invalidation_bits, np.nan, values)
    return Column(values, signal.unit or None, np.asarray(signal.timestamps, dtype=np.float64), signal.samples.dtype.kind in "iub")


def _signals(mdf: MDF) -> Iterator[tuple[int, Signal]]:
    """Yield every channel that is no time base, with its group's number and its invalidation bits, in one pass over the file."""
    wanted = [
        (None, number, index)
        for number, group in enumerate(cast(Sequence[Group], mdf.groups))
        for index in range(len(group.channels))
        if index != mdf.masters_db.get(number) and not is_of_frames(group)
    ]
    signals = mdf.select(wanted, validate=False, copy_master=False) if wanted else ()
    for (_, number, _), signal in zip(wanted, signals, strict=True):
        yield number, signal
