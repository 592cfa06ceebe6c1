"""Shared memory between the loop and the process that looks at images: poses one way, image measurements the other.

One writer and one reader for each direction; nobody locks and nobody waits. A writer fills a place first and counts it afterwards, and a
place is used again only after many others.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.context import BaseContext

import numpy as np

POSES = 2048
"""Rows of the recording whose poses are kept: 8 s at 256 Hz, longer than any image takes to arrive."""

LETTERS = 64
LARGEST = 9
"""Numbers of the largest measurement, all nine parameters."""

LATE_S = 0.2
"""How long after an exposure's end its image is looked at, where time is emulated: as `isocenter calibrate data` takes it."""

WAITS_S = 1e-3

KINDS = ("phantom", "marker")

_HANDLED, _SENT, _TAKEN, _LOST, _UNPLACED, _SKIPPED = range(6)


@dataclass(frozen=True)
class Sighting:
    """The measurement from one image, on its way to the loop.

    Attributes
    ----------
    exposure_id : int
    handled : int
        Images that had been looked at when this one was sent.
    time_s : float
        Middle of the exposure in the loop's time.
    kind : "phantom" or "marker"
    positions : (axes,) array
        Of the axes then, that `values` are deviations at.
    values, covariance : (k,), (k, k) arrays
        As `hil.calibration.data_driven.parameter_filter.Measurement` has them.
    """

    exposure_id: int
    handled: int
    time_s: float
    kind: str
    positions: np.ndarray
    values: np.ndarray
    covariance: np.ndarray


class Mailbox:
    """The shared memory of both directions.

    Parameters
    ----------
    context
        Of `multiprocessing`, whose processes get it as an argument.
    axes : int
    """

    def __init__(self, context: BaseContext, axes: int) -> None:
        self.axes = axes
        self._width = 5 + axes + LARGEST + LARGEST**2
        self._counters = context.RawArray("q", 6)
        self._poses = context.RawArray("d", POSES * (2 + axes))
        self._ticks = context.RawArray("q", POSES * 2)
        self._letters = context.RawArray("d", LETTERS * self._width)
        self.poses[:, 0] = -1.0
        self.ticks[:, 0] = -1

    @property
    def counters(self) -> np.ndarray:
        """Images looked at; letters sent, taken, lost as the box was full, not sent as the pose was unknown; images skipped, (6,)."""
        return np.frombuffer(self._counters, dtype=np.int64)

    @property
    def poses(self) -> np.ndarray:
        """Row, time and positions, (POSES, 2 + axes)."""
        return np.frombuffer(self._poses, dtype=float).reshape(POSES, 2 + self.axes)

    @property
    def ticks(self) -> np.ndarray:
        """Number of each row that was told, counted from 0, and its tick of the plan, (POSES, 2)."""
        return np.frombuffer(self._ticks, dtype=np.int64).reshape(POSES, 2)

    @property
    def letters(self) -> np.ndarray:
        """Letters (LETTERS, width)."""
        return np.frombuffer(self._letters, dtype=float).reshape(LETTERS, self._width)

    # the looking process's end

    def pose_at(self, time_s: float, period_s: float) -> np.ndarray | None:
        """Return axis positions (axes,) at a time, linear between two rows; None where one of them is not kept."""
        row = int(np.floor(time_s / period_s))
        found = self.poses[[row % POSES, (row + 1) % POSES]]
        if row < 0 or found[0, 0] != row or found[1, 0] != row + 1 or not np.isfinite(found).all():
            return None
        share = (time_s - found[0, 1]) / (found[1, 1] - found[0, 1])
        pose: np.ndarray = (1.0 - share) * found[0, 2:] + share * found[1, 2:]
        return pose

    def newest(self, syncs: bool) -> int:
        """Return the newest row that was told: by its tick of the plan, or by the count of SYNCs; -1 before the first."""
        return int(self.ticks[:, 0].max() if syncs else self.poses[:, 0].max())

    def loop_time(self, synced_s: float, period_s: float) -> float:
        """Return the loop's time of a time in periods of SYNC since row 0: later by the lost ticks; NaN where unknown."""
        sync = int(np.floor(synced_s / period_s))
        (first, tick), (second, after) = self.ticks[[sync % POSES, (sync + 1) % POSES]]
        if first != sync or second != sync + 1:
            return np.nan
        return float((tick + (synced_s / period_s - sync) * (after - tick)) * period_s)

    def send(self, sighting: Sighting) -> None:
        """Put a letter in; if the box is full it is lost, and counted."""
        counters = self.counters
        if counters[_SENT] - counters[_TAKEN] >= LETTERS:
            counters[_LOST] += 1
            return
        letter, size, axes = self.letters[counters[_SENT] % LETTERS], len(sighting.values), self.axes
        letter[:5] = sighting.exposure_id, sighting.handled, sighting.time_s, KINDS.index(sighting.kind), size
        letter[5 : 5 + axes] = sighting.positions
        letter[5 + axes : 5 + axes + size] = sighting.values
        letter[5 + axes + LARGEST : 5 + axes + LARGEST + size**2] = sighting.covariance.ravel()
        counters[_SENT] += 1

    def unplaced(self) -> None:
        """Count an image whose axis positions are unknown: of a lost row, or of one whose pose has been overwritten."""
        self.counters[_UNPLACED] += 1

    def skipped(self) -> None:
        """Count an image that was not looked at, since a newer one was there."""
        self.counters[_SKIPPED] += 1

    def handled(self) -> None:
        """Count an image that has been looked at, and whose measurement was sent."""
        self.counters[_HANDLED] += 1


class LoopEnd:
    """The loop's end of a mailbox: takes what has come.

    Parameters
    ----------
    mailbox : Mailbox
    """

    def __init__(self, mailbox: Mailbox) -> None:
        self.mailbox = mailbox
        self._counters, self._poses, self._letters, self._ticks = mailbox.counters, mailbox.poses, mailbox.letters, mailbox.ticks
        self._taken = self._told = 0

    def tell(self, row: int, time_s: float, positions: np.ndarray) -> None:
        """Tell where the axes are in a row of the recording, NaN if unknown; every row is told."""
        known = self._ticks[self._told % POSES]
        known[0] = -1
        known[1] = row
        known[0] = self._told
        self._told += 1
        place = self._poses[row % POSES]
        place[0] = -1.0
        place[1] = time_s
        place[2:] = positions
        place[0] = row

    def collect(self, row: int) -> list[Sighting]:
        """Return what has come by this row and was not taken yet."""
        if self._counters[_SENT] == self._taken:
            return []
        return self.up_to(np.inf)

    def up_to(self, handled: float) -> list[Sighting]:
        """Return what was sent up to a number of images looked at, the last of them included."""
        found = []
        while self._taken < self._counters[_SENT]:
            letter, axes = self._letters[self._taken % LETTERS].copy(), self.mailbox.axes
            if letter[1] >= handled:
                break
            size = int(letter[4])
            values = letter[5 + axes : 5 + axes + size]
            covariance = letter[5 + axes + LARGEST : 5 + axes + LARGEST + size**2].reshape(size, size)
            kind = KINDS[int(letter[3])]
            found.append(Sighting(int(letter[0]), int(letter[1]), float(letter[2]), kind, letter[5 : 5 + axes], values, covariance))
            self._taken += 1
        self._counters[_TAKEN] = self._taken
        return found

    @property
    def looked_at(self) -> int:
        """Images looked at so far."""
        return int(self._counters[_HANDLED])

    @property
    def lost(self) -> int:
        """Measurements for which the mailbox had no place."""
        return int(self._counters[_LOST])

    @property
    def unplaced(self) -> int:
        """Images whose axis positions were unknown or had been overwritten: `POSES` rows are kept."""
        return int(self._counters[_UNPLACED])

    @property
    def skipped(self) -> int:
        """Images that were not looked at, since newer ones were there."""
        return int(self._counters[_SKIPPED])


class LockstepEnd(LoopEnd):
    """The loop's end in lockstep, where time stands still between ticks.

    An image comes `LATE_S` after its exposure, and the loop waits for it then. So a run repeats bit for bit, however long images take to
    make and to look at.

    Parameters
    ----------
    mailbox : Mailbox
    due_s : (N,) array
        When each exposure's image is there, in the loop's time.
    period_s : float

    Attributes
    ----------
    check : callable
        Asked while it waits; raises where nobody makes images any more.
    """

    def __init__(self, mailbox: Mailbox, due_s: np.ndarray, period_s: float) -> None:
        super().__init__(mailbox)
        self._due_s, self._period_s, self._due = due_s, period_s, 0
        self.check: Callable[[], None] = lambda: None

    def collect(self, row: int) -> list[Sighting]:
        """Collect like `LoopEnd`, after waiting for the images that are due."""
        while self._due < len(self._due_s) and self._due_s[self._due] <= row * self._period_s:
            self._due += 1
        while self.looked_at < self._due:
            self.check()
            time.sleep(WAITS_S)
        return self.up_to(self._due)
