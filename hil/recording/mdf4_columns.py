"""The signals of any MDF file."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import cast

import numpy as np
from asammdf import MDF, Signal

from hil.errors import RecordingError
from hil.recording.can_tables import Group, is_of_frames
from hil.recording.channels import unit_and_factor
from hil.recording.naming import Column, Columns

_MOST_TEXTS = 4
"""Different texts in one message."""

_OTHER_BASES = {2: "an angle", 3: "a distance", 4: "an index"}
"""What a group's samples are over instead of time, by the master's type of synchronisation."""

_UNFIT = re.compile(r'[,"\[\]\x00-\x1f\x7f]')


def mdf4_columns(mdf: MDF) -> Columns:
    """Return every signal of numbers with its times; a name that signals of several groups have gets the group's number, `speed@3`."""
    found: dict[str, list[tuple[int, Column]]] = {}
    others: dict[str, str] = {}
    for number, group in enumerate(cast(Sequence[Group], mdf.groups)):
        if is_of_frames(group) and group.channel_group.cycles_nr:
            others[f"CAN frames of group {number}"] = f"{group.channel_group.cycles_nr} of them, beside signals"
    notes: list[str] = []
    bases = {number: _base_of(mdf, number, group) for number, group in enumerate(cast(Sequence[Group], mdf.groups))}
    for place, index, signal in _signals(mdf):
        name = _UNFIT.sub("_", signal.name).strip()
        factor, over, note = bases[place]
        if over:
            others[name] = over
        elif signal.samples.ndim != 1 or signal.samples.dtype.kind not in "fiub":
            others[name] = "text or an array"
        elif not signal.samples.size:
            others[name] = "without samples"
        else:
            found.setdefault(name, []).append((place, _column(signal, factor)))
            notes += [note] if note and note not in notes else []
            notes += _said_texts(mdf, place, index, signal, name)
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
    return Columns(columns, several, others, notes)


def _said_texts(mdf: MDF, group: int, index: int, signal: Signal, name: str) -> list[str]:
    """Return a note on readings that the channel's conversion table makes texts, as of an error code: they are missing as numbers."""
    conversion = cast(Sequence[Group], mdf.groups)[group].channels[index].conversion
    if conversion is None or signal.samples.dtype.kind != "f" or not np.isnan(signal.samples).any():
        return []
    raw = mdf.get(group=group, index=index, raw=True)
    texts = {place: one for place, one in enumerate(conversion.convert(raw.samples, as_object=True)) if isinstance(one, bytes | str)}
    if not texts:
        return []
    first, counts = min(texts), Counter(texts.values())
    words = ", ".join(f"{_text(text)!r} ({number})" for text, number in counts.most_common(_MOST_TEXTS))
    words += ", ..." if len(counts) > _MOST_TEXTS else ""
    return [f"{name}: {len(texts)} of {signal.samples.size} readings are texts and missing as numbers: {words}, first sample {first}"]


def _text(text: bytes | str) -> str:
    return text.decode("utf-8", errors="replace") if isinstance(text, bytes) else text


def _base_of(mdf: MDF, number: int, group: Group) -> tuple[float, str, str]:
    """Return the seconds of a group's unit of time, why its samples have no time, and a note on the unit; both "" as a rule."""
    place = mdf.masters_db.get(number)
    if place is None:
        return 1.0, f"without a time base in group {number}; of a .csv, --map NAME=time says which column it is", ""
    master = group.channels[place]
    unit = str(getattr(master, "unit", "") or getattr(master.conversion, "unit", "") or "")  # version 3 has it in the conversion
    base = f"group {number}: {master.name} [{unit}]"
    if over := _OTHER_BASES.get(getattr(master, "sync_type", 0)):
        return 1.0, f"over {over}, {master.name} [{unit}] of group {number}", ""
    try:
        factor = unit_and_factor("time", unit or "s")[1]
    except RecordingError:
        return 1.0, "", f"{base} is no unit of time: taken in s, as the standard has it"
    return factor, "", "" if factor == 1.0 else f"{base} is its time base, which the standard has in s: taken in {unit}"


def _column(signal: Signal, factor: float) -> Column:
    values = np.asarray(signal.samples, dtype=np.float64)
    if signal.invalidation_bits is not None:
        values = np.where(signal.invalidation_bits, np.nan, values)
    return Column(values, signal.unit or None, factor * np.asarray(signal.timestamps, dtype=np.float64), signal.samples.dtype.kind in "iub")


def _signals(mdf: MDF) -> Iterator[tuple[int, int, Signal]]:
    """Yield every channel that is no time base, with its group's number, its own and its invalidation bits, in one pass over the file."""
    wanted = [
        (None, number, index)
        for number, group in enumerate(cast(Sequence[Group], mdf.groups))
        for index in range(len(group.channels))
        if index != mdf.masters_db.get(number) and not is_of_frames(group)
    ]
    signals = mdf.select(wanted, validate=False, copy_master=False) if wanted else ()
    for (_, number, index), signal in zip(wanted, signals, strict=True):
        yield number, index, signal
