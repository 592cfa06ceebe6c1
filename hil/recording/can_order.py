"""The order of a log's CAN frames: by their stamps or as they stand, copies left out, and a SYNC that was lost put in again."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from drivers.settings import BusSettings, Pdo
from hil.errors import RecordingError
from hil.recording.can_frames import CanFrame, counted
from hil.recording.senders import STRETCH
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


def in_order(frames: Sequence[CanFrame], bus: BusSettings | None = None, part: str = "") -> tuple[list[CanFrame], list[str]]:
    """Return frames in the order of the bus, and what was done.

    Parameters
    ----------
    frames : sequence of CanFrame
        In the order of the file. Without time stamps they stay so.
    bus : BusSettings, optional
        Its SYNC is the beat; without it the frames of the most frequent identifier are.
    part : str
        Which of two answers of a node to a SYNC is taken, `@1` or `@2`.

    Raises
    ------
    RecordingError
        The order is that of several senders: a node's answer comes twice to a SYNC, with other contents, and `part` says not which.
    """
    stamps_s = np.array([frame.time_s for frame in frames])
    if np.isnan(stamps_s).any():
        return (list(frames), []) if bus is None else _once(frames, bus, 0, part)
    copies = 0
    if np.any(np.diff(stamps_s) < 0.0) and _has_copies(frames):
        single = list(dict.fromkeys(frames))
        copies, frames = len(frames) - len(single), single
        stamps_s = np.array([frame.time_s for frame in frames])
    identifiers = np.array([frame.can_id for frame in frames])
    beat = identifiers == (Counter(identifiers.tolist()).most_common(1)[0][0] if bus is None else bus.sync_cob_id & 0x7FF)
    straight = straightened(stamps_s, beat=beat, what="frame")
    ordered = [frames[place]._replace(time_s=time_s) for place, time_s in zip(straight.places, straight.time_s.tolist(), strict=True)]
    if bus is None:
        return ordered, [*straight.notes, *_said_copies(copies)]
    kept, more = _once(ordered, bus, copies, part)
    return kept, [*straight.notes, *more]


def as_logged(frames: Sequence[CanFrame]) -> list[CanFrame]:
    """Return frames of a format that keeps each identifier apart, and merges them by their stamps, in the order in which they were logged.

    That matters where the clock was set back: each identifier then goes back as often, and its stretches are those of all.
    """
    stretch: Counter[tuple[str, int, bool]] = Counter()
    latest_s: dict[tuple[str, int, bool], float] = {}
    found: list[tuple[int, float]] = []
    for frame in frames:
        key = frame.channel, frame.can_id, frame.extended
        stretch[key] += frame.time_s < latest_s.get(key, -math.inf)
        latest_s[key] = frame.time_s
        found.append((stretch[key], frame.time_s))
    often = Counter((frame.channel, frame.can_id, frame.extended) for frame in frames).most_common(1)
    if not often or not 0 < max(stretch.values()) == stretch[often[0][0]] <= often[0][1] // STRETCH:
        return list(frames)
    starts_s = [min(time_s for number, time_s in found if number == one) for one in range(stretch[often[0][0]] + 1)]
    for place, frame in enumerate(frames):  # an identifier that is sent so rarely that it never went back
        if not stretch[frame.channel, frame.can_id, frame.extended]:
            number = next((one for one in range(len(starts_s))[::-1] if frame.time_s >= max(starts_s[: one + 1])), 0)
            found[place] = number, frame.time_s
    return [frames[place] for place in sorted(range(len(frames)), key=lambda place: found[place])]


def _said_copies(copies: int) -> list[str]:
    return [f"{counted(copies, 'frame')} logged twice: taken once"] if copies else []


def _has_copies(frames: Sequence[CanFrame]) -> bool:
    """Return whether frames at one time are the same rather than others; SYNCs, which are all the same, do not tell."""
    single = dict.fromkeys(frame for frame in frames if frame.data)
    said = {(frame.time_s, frame.channel, frame.can_id) for frame in single}
    return len(single) - len(said) <= sum(bool(frame.data) for frame in frames) - len(single)


def _is_copy(frame: CanFrame, before: CanFrame, period_s: float) -> bool:
    """Return whether a frame is the one before, heard again; without time stamps any with the same contents is."""
    return frame.data == before.data and not frame.time_s - before.time_s >= COPY * period_s


def _once(frames: Sequence[CanFrame], bus: BusSettings, copies: int, part: str) -> tuple[list[CanFrame], list[str]]:
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
            if latest is not None and not given and _is_copy(frame, latest, period_s):
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
            if _is_copy(frame, before, period_s):
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
                if part == "@1":
                    continue
        elif frame.can_id in answers:
            given[frame.can_id] = frame
        kept.append(frame)
    notes = _said_copies(copies)
    notes += [f"{counted(extra, 'SYNC')} between two of the period, which no node answered: left out, of another sender"] if extra else []
    notes += [f"{counted(lost, 'SYNC')} missing between answers a period apart: put in"] if lost else []
    for cob_id, those in twice.items():
        words = f"{cob_id:03X} comes twice to a SYNC, with other contents, in {len(those)} of {rows} rows, first row {those[0]}"
        if len(those) > max(1.0, FEW * rows) and not part:
            way = "take the first with --map @1=part or the last with @2=part, or correct the machine file"
            raise RecordingError(f"{words}: two nodes send it, or it is no answer to SYNC; {way}")
        notes.append(f"{words}: the {'first' if part == '@1' else 'last'} is taken")
    if part and not (twice and part in ("@1", "@2")):
        raise RecordingError(f"{part}=part: {'no node answers twice to a SYNC' if not twice else '@1 and @2 are known'}; leave it out")
    return kept, notes


def _every_sync(pdo: Pdo) -> bool:
    return 0 <= pdo.transmission_type <= SYNCHRONOUS
