"""The order of a log's CAN frames: by their stamps or as they stand, copies left out, and a SYNC that was lost put in again."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from drivers.settings import BusSettings, Pdo
from hil.errors import RecordingError
from hil.recording.can_frames import CanFrame, counted
from hil.recording.stamps import straightened

COPY = 0.2
"""Part of a period within which a second SYNC, or the same frame, is a copy: of an interface that hears itself, or of two that listen."""

ANOTHER = 0.6
"""Part of a period from which a second answer of a node belongs to another SYNC, which was lost."""

UNANSWERED = 1.5
"""Of three SYNCs within this many periods, the middle one is another sender's if no node answers it."""

SYNCHRONOUS = 240
"""Largest transmission type of a PDO that comes once at every so many SYNCs (CiA 301)."""

FEW = 0.01
"""Share of rows that a disturbed log may have with two answers of a node; with more, two nodes answer."""


def in_order(frames: Sequence[CanFrame], bus: BusSettings | None = None) -> tuple[list[CanFrame], list[str]]:
    """Return frames in the order of the bus, and what was done.

    Parameters
    ----------
    frames : sequence of CanFrame
        In the order of the file. Without time stamps they stay so.
    bus : BusSettings, optional
        Its SYNC is the beat; without it the frames of the most frequent identifier are.

    Raises
    ------
    RecordingError
        The order is that of several senders: a node's answer comes twice to a SYNC, with other contents.
    """
    stamps_s = np.array([frame.time_s for frame in frames])
    if np.isnan(stamps_s).any():
        return list(frames), []
    copies = 0
    if np.any(np.diff(stamps_s) < 0.0):
        single = list(dict.fromkeys(frames))
        copies, frames = len(frames) - len(single), single
        stamps_s = np.array([frame.time_s for frame in frames])
    identifiers = np.array([frame.can_id for frame in frames])
    beat = identifiers == (Counter(identifiers.tolist()).most_common(1)[0][0] if bus is None else bus.sync_cob_id & 0x7FF)
    straight = straightened(stamps_s, beat=beat, what="frame")
    ordered = [frames[place]._replace(time_s=time_s) for place, time_s in zip(straight.places, straight.time_s.tolist(), strict=True)]
    if bus is None:
        return ordered, [*straight.notes, *_said_copies(copies)]
    kept, more = _once(ordered, bus, copies)
    return kept, [*straight.notes, *more]


def _said_copies(copies: int) -> list[str]:
    return [f"{counted(copies, 'frame')} logged twice: taken once"] if copies else []


def _once(frames: Sequence[CanFrame], bus: BusSettings, copies: int) -> tuple[list[CanFrame], list[str]]:
    """Return frames without copies, with the SYNCs that were lost."""
    sync, period_s = bus.sync_cob_id & 0x7FF, bus.sync_period_s
    answers = {pdo.cob_id & 0x7FF for node in bus.nodes for pdo in node.tpdos if _every_sync(pdo)}
    kept: list[CanFrame] = []
    latest: CanFrame | None = None  # SYNC
    given: dict[int, CanFrame] = {}  # answers to it
    lost = rows = extra = latest_place = 0
    answered_s = -math.inf  # SYNC
    twice: dict[int, list[int]] = {}  # COB-ID -> rows
    for frame in frames:
        if frame.can_id == sync:
            if latest is not None and not given and frame.data == latest.data and frame.time_s - latest.time_s < COPY * period_s:
                copies += 1
                continue
            is_extra = latest is not None and not given and frame.time_s - answered_s < UNANSWERED * period_s
            if is_extra and answers:
                kept.pop(latest_place)
                extra += 1
                rows -= 1
            elif given and latest is not None:
                answered_s = latest.time_s
            latest, latest_place, given = frame, len(kept), {}
            rows += 1
        elif (before := given.get(frame.can_id)) is not None and latest is not None:
            if frame.data == before.data and frame.time_s - before.time_s < COPY * period_s:
                copies += 1
                continue
            if frame.time_s - before.time_s >= ANOTHER * period_s:
                answered_s = latest.time_s
                latest, latest_place = latest._replace(time_s=latest.time_s + period_s), len(kept)
                given = {frame.can_id: frame}
                kept.append(latest)
                lost += 1
                rows += 1
            else:
                twice.setdefault(frame.can_id, []).append(rows - 1)
        elif frame.can_id in answers:
            given[frame.can_id] = frame
        kept.append(frame)
    notes = _said_copies(copies)
    notes += [f"{counted(extra, 'SYNC')} between two of the period, which no node answered: left out, of another sender"] if extra else []
    notes += [f"{counted(lost, 'SYNC')} missing between answers a period apart: put in"] if lost else []
    for cob_id, those in twice.items():
        words = f"{cob_id:03X} comes twice to a SYNC, with other contents, in {len(those)} of {rows} rows, first row {those[0]}"
        if len(those) > max(1.0, FEW * rows):
            raise RecordingError(
                f"{words}: two nodes send it, or it is no answer to SYNC; keep the frames of one, or correct the machine file"
            )
        notes.append(f"{words}: the last is taken")
    return kept, notes


def _every_sync(pdo: Pdo) -> bool:
    return 0 <= pdo.transmission_type <= SYNCHRONOUS
