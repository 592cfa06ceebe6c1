"""Time stamps against the order of the file: clocks that were set, samples out of order or twice, and several senders of one signal.

A file has two orders: that in which its samples stand, and that of their stamps. Where they agree nothing is done. Where they do not, what
explains both is looked for: samples that stand elsewhere than their stamps say make an even raster when sorted; a clock that was set leaves
long stretches, each in order. What neither explains is refused, with its rows.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil.errors import RecordingError

LOST = 1.5
"""Neighbouring samples further apart than this many of the usual steps have lost one between them."""

CLOSE = 0.5
"""Samples of one sender are at least this many of the usual steps apart; halfway lies what belongs to neither."""

STRETCH = 8
"""Fewest samples between two settings of a clock: one that is set more often gives no time."""

FAR = 20.0
"""Ratio to the usual change from sample to sample beyond which a value does not go on from its neighbour."""

OFTEN = 0.02
"""Share of samples that leave their neighbours and return, from which there is a second sender: bad readings are fewer."""

FEWEST = 8
"""Samples that leave their neighbours and return, below which a file is too short to tell a second sender from a signal that jumps."""

IN_TURN = 0.34
"""Share of such samples from which even stamps are those of two senders, too, which take turns."""

_POSITION = re.compile(r"(?:^|[._])position(?:_|\[|$)|^reference_")
"""Names of positions, of channels as of joints in a bag."""

_COARSE = 0.1
"""Share of samples with the stamp of the one before, from which a clock is coarser than the samples."""

_ON_COMB = 0.15
"""Largest distance of a sample from its place in an even raster, in steps."""

_WHOLE_COMB = 0.95
"""Share of its places that a sender's raster has filled."""

_LONGEST_STRIDE = 9
"""Samples of other senders, and one, between two of a sender: more are not tried."""


class Straight(NamedTuple):
    """Samples in order of time.

    Parameters
    ----------
    places : ndarray, shape (M,)
        Of the samples that are kept, in the file.
    time_s : ndarray, shape (M,)
        Not decreasing; increasing where values were given.
    notes : tuple of str
        What was done.
    twice : int
        Samples left out at the time of another.
    """

    places: np.ndarray
    time_s: np.ndarray
    notes: tuple[str, ...] = ()
    twice: int = 0


class DisorderError(RecordingError):
    """Samples that do not come from one sender with one clock; `parts` are the places (M,) of those that belong together, if known."""

    def __init__(self, words: str, parts: Sequence[np.ndarray] = ()) -> None:
        super().__init__(words)
        self.parts = tuple(parts)


def straightened(
    stamps_s: np.ndarray,
    values: np.ndarray | None = None,
    *,
    other_s: np.ndarray | None = None,
    beat: np.ndarray | None = None,
    names: Sequence[str] = (),
    what: str = "row",
    numbers: Sequence[int] | None = None,
) -> Straight:
    """Return samples in order of time, with a time that does not step where only the clock did.

    Parameters
    ----------
    stamps_s : ndarray, shape (N,)
        In the order of the file, finite.
    values : ndarray, shape (N, K), optional
        What the samples say, NaN where missing. None for messages of several kinds, which may share their times.
    other_s : ndarray, shape (N,), optional
        Times by another clock, which tells a clock that was set from samples that were lost.
    beat : ndarray of bool, shape (N,), optional
        Samples that come at an even rate; all unless given.
    names : sequence of str, optional
        Of the K values: positions among them cannot jump there and back, by which a second sender is known.
    what : str
        What a message calls a sample.
    numbers : sequence of int, optional
        The samples' numbers in messages; from 0 unless given.

    Raises
    ------
    DisorderError
        Order and stamps disagree in a way that one sender with one clock cannot explain.
    """
    numbers = range(stamps_s.size) if numbers is None else numbers
    if stamps_s.size < 2 or np.all(np.diff(stamps_s) >= 0.0):
        straight = Straight(np.arange(stamps_s.size), stamps_s)
    elif _is_clock_set(stamps_s, values, beat):
        straight = _clock_set(stamps_s, values, other_s, beat, what, numbers)
    else:
        straight = _sorted(stamps_s, what, numbers)
    straight = _forward(straight, other_s, what, numbers)
    return straight if values is None else _apart(straight, values, names, what, numbers)


def said_twice(number: int) -> list[str]:
    """Return the note on samples that were left out because their time was that of another."""
    return [f"{number} sample{'s' if number > 1 else ''} at the time of another left out"] if number else []


def rows_in_order(
    table: np.ndarray, names: Sequence[str], what: str = "row", numbers: Sequence[int] | None = None
) -> tuple[np.ndarray, list[str]]:
    """Return a table's rows (N, K) in order of its column `time`, and what was done; DisorderError as in `straightened`."""
    time_place = names.index("time")
    time_s = table[:, time_place]
    if not np.isfinite(time_s).all():  # told elsewhere
        return table, []
    others = [name for name in names if name != "time"]
    made = straightened(time_s, np.delete(table, time_place, axis=1), names=others, what=what, numbers=numbers)
    ordered = table[made.places]
    ordered[:, time_place] = made.time_s
    return ordered, [*made.notes, *said_twice(made.twice)]


def usual_step(time_s: np.ndarray) -> float:
    """Return the usual step between neighbouring times; 0 of fewer than two."""
    steps = np.diff(time_s)
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if steps.size else 0.0


def is_even(time_s: np.ndarray) -> bool:
    """Return whether samples come at one rate, gaps and jitter aside."""
    steps, step = np.diff(time_s), usual_step(time_s)
    return steps.size > 1 and float(np.mean(np.abs(steps - step) < CLOSE * step)) >= 1.0 - _COARSE


def _is_clock_set(stamps_s: np.ndarray, values: np.ndarray | None, beat: np.ndarray | None) -> bool:
    """Return whether the stretches between the places where stamps go back are a clock's, not parts of one raster in another order."""
    if not all(run.size >= STRETCH for run in _runs(stamps_s)[1:-1]):
        return False
    order = np.argsort(stamps_s, kind="stable")
    beats = order if beat is None else order[beat[order]]
    time_s = stamps_s[beats]
    steps, step = np.diff(time_s), usual_step(stamps_s if beat is None else stamps_s[beat])
    repeated = np.zeros(steps.size, dtype=bool) if values is None else _equal(values[beats[1:]], values[beats[:-1]])
    run = np.cumsum(np.concatenate([[0], np.diff(stamps_s) < 0.0]))[beats]
    mixed = (steps <= CLOSE * step) & (np.diff(run) != 0) & ~(repeated & (steps == 0.0))
    open_seam = (np.diff(beats) < 0) & (steps > LOST * step)
    return bool(mixed.any() or open_seam.any() or (values is not None and _goes_on_in_file(stamps_s, order, values)))


def _goes_on_in_file(stamps_s: np.ndarray, order: np.ndarray, values: np.ndarray) -> bool:
    """Return whether values go on across the places where stamps go back rather than across those that sorting makes neighbours."""
    scale = _usual_change(values)

    def largest(these: np.ndarray, places: np.ndarray) -> float:
        change = np.abs(these[places + 1] - these[places]) / scale
        return float(np.max(change[np.isfinite(change)], initial=0.0))

    in_file, sorted_s = np.flatnonzero(np.diff(stamps_s) < 0.0), np.flatnonzero(np.diff(order) < 0)
    return FAR * largest(values, in_file) < largest(values[order], sorted_s)


def _sorted(stamps_s: np.ndarray, what: str, numbers: Sequence[int]) -> Straight:
    order = np.argsort(stamps_s, kind="stable")
    displaced = np.flatnonzero(stamps_s < np.maximum.accumulate(stamps_s))
    many = f"{displaced.size} {what}{'s stand' if displaced.size > 1 else ' stands'}"
    words = f"{many} behind later ones, first {what} {numbers[displaced[0]]}"
    return Straight(order, stamps_s[order], (f"{words}: put in the order of their stamps",))


def _clock_set(
    stamps_s: np.ndarray, values: np.ndarray | None, other_s: np.ndarray | None, beat: np.ndarray | None, what: str, numbers: Sequence[int]
) -> Straight:
    """Return the samples in the order of the file, the stretches behind a step of the clock moved to where they belong."""
    runs = _runs(stamps_s)
    falls = np.cumsum([run.size for run in runs])[:-1]
    words = f"the stamps go back {falls.size} time{'s' if falls.size > 1 else ''}, first at {what} {numbers[falls[0]]}"
    step = usual_step(stamps_s if beat is None else stamps_s[beat])
    time_s, notes, back_s = stamps_s.copy(), [], 0.0
    for place in (1 + np.flatnonzero((np.diff(stamps_s) < 0.0) | (np.diff(stamps_s) > LOST * step))).tolist():
        jump_s = stamps_s[place] - stamps_s[place - 1]
        if jump_s >= 0.0 and not (back_s and abs(jump_s - step - back_s) <= LOST * step):
            continue
        _check_seam(values, place, runs, words, what, numbers)
        went_on_s = _since(other_s, place, step) if beat is None else _on_beat(time_s, beat, place, step)
        time_s[place:] += went_on_s - (time_s[place] - time_s[place - 1])
        back_s = back_s + went_on_s - jump_s if jump_s < 0.0 else 0.0
        notes.append(
            f"the clock was set {'back' if jump_s < 0.0 else 'on again'} by {abs(went_on_s - jump_s):.6g} s at {what} {numbers[place]}"
            f" (its stamp follows by {jump_s:.6g} s); what comes then is taken to go on {went_on_s:.6g} s later"
        )
    return Straight(np.arange(stamps_s.size), time_s, tuple(notes))


def _forward(straight: Straight, other_s: np.ndarray | None, what: str, numbers: Sequence[int]) -> Straight:
    """Take out steps forward of the clock that another clock does not have."""
    step = usual_step(straight.time_s)
    if other_s is None or straight.time_s.size < 2 or not is_even(straight.time_s):
        return straight
    time_s, notes, others = straight.time_s.copy(), list(straight.notes), other_s[straight.places]
    for place in (1 + np.flatnonzero(np.diff(straight.time_s) > LOST * step)).tolist():
        jump_s, other_jump_s = straight.time_s[place] - straight.time_s[place - 1], others[place] - others[place - 1]
        if 0.0 < other_jump_s < CLOSE * jump_s:
            time_s[place:] -= jump_s - _since(others, place, step)
            where = f"{what} {numbers[straight.places[place]]}"
            notes.append(f"the stamps leap by {jump_s:.6g} s at {where}, another clock by {other_jump_s:.6g} s: taken out")
    return straight._replace(time_s=time_s, notes=tuple(notes))


def _apart(straight: Straight, values: np.ndarray, names: Sequence[str], what: str, numbers: Sequence[int]) -> Straight:
    """Leave out what stands there twice, spread what a coarse clock stamped alike, and refuse what two senders said in turn."""
    places, time_s = straight.places, straight.time_s
    if time_s.size < 2:
        return straight
    said = values[places]
    steady = said[:, [bool(_POSITION.search(name)) for name in names]] if names else said
    leaves = _there_and_back(steady)
    if leaves.sum() >= max(FEWEST, OFTEN * leaves.size):
        words = f"the values jump there and back {leaves.sum()} times, first at {what} {numbers[places[np.argmax(leaves)]]}"
        if not is_even(time_s) or np.mean(leaves) > IN_TURN:
            raise DisorderError(f"{words}: two senders of one signal", _combs(places, time_s, said))
        straight = straight._replace(notes=(*straight.notes, words))
    alike = np.concatenate([[False], np.diff(time_s) <= 0.0])
    if not alike.any():
        return straight
    same = alike & np.concatenate([[False], _equal(said[1:], said[:-1])])
    if np.mean(alike) >= _COARSE and np.count_nonzero(same) < CLOSE * np.count_nonzero(alike) and _is_coarse(time_s):
        spread = np.interp(np.arange(time_s.size), np.flatnonzero(~alike), time_s[~alike])
        tail = int(np.flatnonzero(~alike)[-1])
        step = float(time_s[tail] - time_s[0]) / tail
        spread[tail:] = time_s[tail] + step * np.arange(time_s.size - tail)
        note = f"the stamps are coarser than the {what}s, {np.count_nonzero(alike)} have that of the one before: spread evenly between them"
        return straight._replace(time_s=spread, notes=(*straight.notes, note))
    differ = np.flatnonzero(alike & ~same)
    scale = _usual_change(steady)
    far = [place for place in differ.tolist() if np.any(np.abs(steady[place] - steady[place - 1]) > FAR * scale)]
    if far or differ.size > OFTEN * time_s.size:
        far = far or differ.tolist()
        words = f"{what}s {numbers[places[far[0] - 1]]} and {numbers[places[far[0]]]} have the same stamp and other values"
        words += f", and {len(far) - 1} more" if far[1:] else ""
        raise DisorderError(f"{words}: two senders of one signal", _combs(places, time_s, said))
    return straight._replace(places=places[~alike], time_s=time_s[~alike], twice=int(np.count_nonzero(alike)))


def _there_and_back(values: np.ndarray) -> np.ndarray:
    """Return where (N,) a sample lies far from both its neighbours, on the same side."""
    before, behind = np.diff(values, axis=0)[:-1], np.diff(values, axis=0)[1:]
    scale = _usual_change(values)
    with np.errstate(invalid="ignore"):
        leaves = (before * behind < 0.0) & (np.minimum(np.abs(before), np.abs(behind)) > FAR * scale)
    return np.concatenate([[False], leaves.any(axis=1), [False]])


def _usual_change(values: np.ndarray) -> np.ndarray:
    """Return the usual change (K,) of values (N, K) from sample to sample, or to the next but one where two take turns; inf without one."""
    scale = np.full(values.shape[1], np.inf)
    for column in range(values.shape[1]):
        for stride in (1, 2):
            change = np.abs(values[stride:, column] - values[:-stride, column])
            change = change[np.isfinite(change) & (change > 0.0)]
            if change.size:
                scale[column] = min(scale[column], float(np.median(change)))
    return scale


def _is_coarse(time_s: np.ndarray) -> bool:
    """Return whether equal stamps come in groups of one size, or two neighbouring ones."""
    _, sizes = np.unique(time_s, return_counts=True)
    inner = sizes[1:-1]
    return bool(inner.size and inner.max() - inner.min() <= 1)


def _combs(places: np.ndarray, time_s: np.ndarray, said: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the places of two senders with even rates of their own; nothing where they cannot be told apart.

    All are in order of time: places (N,), time_s (N,), said (N, K).
    """
    if places.size < 2 * STRETCH:
        return ()
    for start in range(2):
        for stride in range(1, _LONGEST_STRIDE + 1):
            if start + stride >= places.size or time_s[start + stride] <= time_s[start]:
                continue
            comb = _comb(time_s, said, start, float(time_s[start + stride] - time_s[start]))
            rest = np.setdiff1d(np.arange(places.size), comb)
            if comb.size < STRETCH or rest.size < STRETCH or _there_and_back(said[comb]).any() or _there_and_back(said[rest]).any():
                continue
            if is_even(time_s[comb]) and is_even(time_s[rest]):
                return np.sort(places[comb]), np.sort(places[rest])
    return ()


def _comb(time_s: np.ndarray, said: np.ndarray, start: int, step: float) -> np.ndarray:
    """Return the samples (M,) that follow `start` in steps of `step`, each nearest in value where several have its time."""
    comb, due = [start], time_s[start] + step
    asked = 1
    while due <= time_s[-1]:
        asked += 1
        low, high = np.searchsorted(time_s, (due - _ON_COMB * step, due + _ON_COMB * step))
        near = [place for place in range(low, high) if place > comb[-1]]
        if near:
            nearest = min(near, key=lambda place: float(np.nansum(np.abs(said[place] - said[comb[-1]]))))
            comb.append(nearest)
            due = time_s[nearest]
        elif len(comb) < _WHOLE_COMB * asked - 1.0:
            return np.zeros(0, dtype=np.int64)
        due += step
    return np.array(comb)


def _runs(stamps_s: np.ndarray) -> list[np.ndarray]:
    """Return the stretches in which stamps do not go back."""
    return np.split(stamps_s, 1 + np.flatnonzero(np.diff(stamps_s) < 0.0))


def _since(other_s: np.ndarray | None, place: int, step: float) -> float:
    """Return the time from the sample before, in whole steps where another clock tells, else one step."""
    passed = 0.0 if other_s is None else float(other_s[place] - other_s[place - 1])
    return max(1.0, float(np.rint(passed / step))) * step if passed > 0.0 and step > 0.0 else step


def _on_beat(time_s: np.ndarray, beat: np.ndarray, place: int, step: float) -> float:
    """Return the time from the sample before that puts the next beat one step behind the last."""
    before, behind = np.flatnonzero(beat[:place]), np.flatnonzero(beat[place:])
    if not before.size or not behind.size:
        return 0.0
    due_s = time_s[before[-1]] + step - (time_s[place + behind[0]] - time_s[place])
    return max(0.0, float(due_s - time_s[place - 1]))


def _check_seam(values: np.ndarray | None, place: int, runs: Sequence[np.ndarray], words: str, what: str, numbers: Sequence[int]) -> None:
    """Refuse to join two stretches whose values do not go on."""
    if values is None:
        return
    change = np.abs(np.diff(values, axis=0))
    jump = change[place - 1].copy()
    change[np.cumsum([run.size for run in runs])[:-1] - 1] = 0.0
    change[place - 1] = 0.0
    with np.errstate(invalid="ignore"):
        apart = np.flatnonzero((jump > FAR * _usual_change(values)) & (jump > LOST * np.nanmax(change, axis=0, initial=0.0)))
    if apart.size:
        ends = np.cumsum([run.size for run in runs])
        parts = [np.arange(end - run.size, end) for run, end in zip(runs, ends, strict=True)]
        where = f"from {what} {numbers[place - 1]} to {numbers[place]}"
        raise DisorderError(f"{words}, and the values do not go on {where}: several runs", parts)


def _equal(these: np.ndarray, those: np.ndarray) -> np.ndarray:
    """Return which rows (N,) of two arrays (N, K) are the same, missing values too."""
    equal: np.ndarray = ((these == those) | (np.isnan(these) & np.isnan(those))).all(axis=1)
    return equal
