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
from hil.recording.coarse import is_coarse_clock, spread, spread_runs, told
from hil.recording.senders import FAR, STRETCH, added, combs, persistent_combs, there_and_back
from hil.recording.steps import CLOSE, COARSE, LOST, equal_rows, is_even, usual_change, usual_step

OFTEN = 0.02
"""Share of samples that leave their neighbours and return, from which there is a second sender: bad readings are fewer."""

FEWEST = 8
"""Samples that leave their neighbours and return, below which a file is too short to tell a second sender from a signal that jumps."""

IN_TURN = 0.34
"""Share of such samples from which even stamps are those of two senders, too, which take turns."""

_MOST_NOTES = 6
"""Settings of one clock that are told one by one."""

_POSITION = re.compile(r"(?:^|[._])position(?:_|\[|$)|^reference_")
"""Names of positions, of channels as of joints in a bag."""


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
    kept = _without_copies(stamps_s, values)
    if kept.size < stamps_s.size and values is not None:
        others = None if other_s is None else other_s[kept]
        try:
            made = straightened(
                stamps_s[kept], values[kept], other_s=others, names=names, what=what, numbers=[numbers[place] for place in kept.tolist()]
            )
        except DisorderError as problem:
            raise DisorderError(str(problem), [kept[part] for part in problem.parts]) from None
        again = int(np.setdiff1d(np.arange(stamps_s.size), kept)[0])
        words = (
            f"{_counted(stamps_s.size - kept.size, what)} with stamps and values of earlier ones, first {what} {numbers[again]}: left out"
        )
        return made._replace(places=kept[made.places], notes=(words, *made.notes))
    falls = bool(np.any(np.diff(stamps_s) < 0.0))
    if not falls and (is_coarse_clock(stamps_s, values) or not _set_back_by_a_step(stamps_s, values).any()):
        straight = Straight(np.arange(stamps_s.size), stamps_s)
    elif not falls or _is_clock_set(stamps_s, values, beat):
        straight = _clock_set(stamps_s, values, other_s, beat, what, numbers)
    else:
        straight = _sorted(stamps_s, what, numbers)
    straight = _forward(straight, other_s, what, numbers)
    return straight if values is None else _apart(straight, values, names, what, numbers)


def part_straightened(
    stamps_s: np.ndarray,
    values: np.ndarray,
    names: Sequence[str],
    what: str,
    numbers: Sequence[int] | None = None,
    part: str = "",
    heads: Sequence[int] = (),
) -> Straight:
    """As `straightened`, of one sender or run where there are several: `part` is `@1` for the first of them, `@2` for the second.

    `heads` are numbers at which the table's head stands again: another run begins there if the stamps go back.

    Raises
    ------
    RecordingError
        There are several, and none is asked for; or there is no such part.
    """
    try:
        _check_heads(stamps_s, values, what, range(stamps_s.size) if numbers is None else numbers, heads)
        made = straightened(stamps_s, values, names=names, what=what, numbers=numbers)
    except DisorderError as problem:
        ways = [f"@{number}=part ({_counted(one.size, what)})" for number, one in enumerate(problem.parts, 1)]
        known = {way.partition("=")[0]: one for way, one in zip(ways, problem.parts, strict=True)}
        if part not in known:
            way = f"take one with --map {' or '.join(ways)}" if ways else "nothing in the file tells them apart: record one of them alone"
            raise RecordingError(f"{problem}; {way}") from None
        own = known[part]
        mine = own.tolist() if numbers is None else [numbers[place] for place in own.tolist()]
        made = straightened(stamps_s[own], values[own], names=names, what=what, numbers=mine)
        note = f"the {_counted(own.size, what)} of part {part} are taken of {stamps_s.size}: {problem}"
        return made._replace(places=own[made.places], notes=(note, *made.notes))
    if part:
        raise RecordingError(f"{part}=part: the {what}s have one sender and one clock, so there is no part; leave it out")
    return made


def said_twice(number: int) -> list[str]:
    """Return the note on samples that were left out because their time was that of another."""
    return [f"{number} sample{'s' if number > 1 else ''} at the time of another left out"] if number else []


def rows_in_order(
    table: np.ndarray,
    names: Sequence[str],
    what: str = "row",
    numbers: Sequence[int] | None = None,
    part: str = "",
    heads: Sequence[int] = (),
) -> tuple[np.ndarray, list[str]]:
    """Return a table's rows (N, K) in order of its column `time`, and what was done; parameters as in `part_straightened`.

    Raises
    ------
    RecordingError
        As `straightened`, with the option that takes one sender's rows; or there is no such `part`.
    """
    time_place = names.index("time")
    time_s = table[:, time_place]
    if not np.isfinite(time_s).all():  # told elsewhere
        return table, []
    others = [name for name in names if name != "time"]
    made = part_straightened(time_s, np.delete(table, time_place, axis=1), others, what, numbers, part, heads)
    ordered = table[made.places]
    ordered[:, time_place] = made.time_s
    return ordered, [*made.notes, *said_twice(made.twice)]


def _check_heads(stamps_s: np.ndarray, values: np.ndarray, what: str, numbers: Sequence[int], heads: Sequence[int]) -> None:
    """Refuse several runs, each behind the table's head; a run that stands there twice is one."""
    starts = [
        place
        for place in np.unique(np.searchsorted(numbers, heads)).tolist()
        if 0 < place < stamps_s.size and stamps_s[place] < stamps_s[place - 1]
    ]
    kept = np.isin(np.arange(stamps_s.size), _without_copies(stamps_s, values))
    runs = [run for run in np.split(np.arange(stamps_s.size), starts) if kept[run].any()]
    if runs[1:]:
        words = f"the header stands there again before {what} {numbers[runs[1][0]]}, where the stamps go back"
        raise DisorderError(f"{words}: several runs", runs)


def _without_copies(stamps_s: np.ndarray, values: np.ndarray | None) -> np.ndarray:
    """Return the places of samples but those of stretches that stand there again, stamps and values the same; a standstill is no copy."""
    places = np.arange(stamps_s.size)
    falls = np.flatnonzero(np.diff(stamps_s) < 0.0)
    if values is None or not falls.size:
        return places
    rows = np.ascontiguousarray(np.column_stack([stamps_s, values]) + 0.0)
    _, first, which = np.unique(rows.view(f"V{rows.itemsize * rows.shape[1]}").ravel(), return_index=True, return_inverse=True)
    again = first[which] < places
    again[: falls[0] + 1] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[False], again, [False]]).astype(np.int8)))
    for begin, end in edges.reshape(-1, 2).tolist():
        again[begin:end] &= end - begin >= STRETCH and _change(values[begin:end])
    return places[~again]


def _change(values: np.ndarray) -> bool:
    """Return whether not all rows are the same."""
    return not equal_rows(values[1:], values[:-1]).all()


def _set_back_by_a_step(stamps_s: np.ndarray, values: np.ndarray | None) -> np.ndarray:
    """Return at which samples (N,) of an even raster a clock was set back by just a step: the stamp before, another value, and no gap."""
    back = np.zeros(stamps_s.size, dtype=bool)
    steps, step = np.diff(stamps_s), usual_step(stamps_s)
    if values is None or steps.size < STRETCH or not is_even(stamps_s):
        return back
    change = np.abs(np.diff(values, axis=0))
    with np.errstate(invalid="ignore"):
        goes_on = ~equal_rows(values[1:], values[:-1]) & ~np.any(change > FAR * usual_change(values), axis=1)
    whole = np.abs(steps - step) < CLOSE * step
    back[2:-1] = (steps[1:-1] == 0.0) & goes_on[1:-1] & whole[:-2] & whole[2:]
    return back


def _is_clock_set(stamps_s: np.ndarray, values: np.ndarray | None, beat: np.ndarray | None) -> bool:
    """Return whether the stretches between the places where stamps go back are a clock's, not parts of one raster in another order."""
    if not all(run.size >= STRETCH for run in _runs(stamps_s)[1:-1]):
        return False
    order = np.argsort(stamps_s, kind="stable")
    beats = order if beat is None else order[beat[order]]
    time_s = stamps_s[beats]
    steps, step = np.diff(time_s), usual_step(stamps_s if beat is None else stamps_s[beat])
    repeated = np.zeros(steps.size, dtype=bool)
    if values is not None:
        repeated = (steps == 0.0) & equal_rows(values[beats[1:]], values[beats[:-1]])
        if np.count_nonzero(repeated) >= STRETCH and not _change(values[beats[1:][repeated]]):
            repeated[:] = False
    run = np.cumsum(np.concatenate([[0], np.diff(stamps_s) < 0.0]))[beats]
    mixed = (steps <= CLOSE * step) & (np.diff(run) != 0) & ~repeated
    open_seam = (np.diff(beats) < 0) & (steps > LOST * step)
    return bool(mixed.any() or open_seam.any() or (values is not None and _goes_on_in_file(stamps_s, order, values)))


def _goes_on_in_file(stamps_s: np.ndarray, order: np.ndarray, values: np.ndarray) -> bool:
    """Return whether values go on across the places where stamps go back rather than across those that sorting makes neighbours."""
    scale = usual_change(values)

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
    words = f"the stamps go back {_times(falls.size)}, first at {what} {numbers[falls[0]]}" if falls.size else ""
    step = usual_step(stamps_s if beat is None else stamps_s[beat])
    steps = np.diff(stamps_s)
    still, coarse = _set_back_by_a_step(stamps_s, values)[1:], tuple[str, ...]()
    if falls.size and values is not None and np.mean(steps == 0.0) < COARSE:
        still |= (steps == 0.0) & ~equal_rows(values[1:], values[:-1])
        if (even_s := spread_runs(stamps_s, values, falls)) is not None:
            coarse = (told(int(np.count_nonzero(steps == 0.0)), what),)
            stamps_s, steps, step, still = even_s, np.diff(even_s), usual_step(even_s), np.zeros_like(still)
    time_s, notes, ahead_s = stamps_s.copy(), [], 0.0
    places = 1 + np.flatnonzero((steps < 0.0) | still | (steps > LOST * step))
    for number, place in enumerate(places.tolist()):
        jump_s = steps[place - 1]
        is_back = ahead_s and abs(ahead_s + jump_s - step) <= LOST * step
        if jump_s > 0.0 and not is_back and not _is_undone(jump_s, steps[places[number + 1 :] - 1], step):
            continue
        if falls.size:
            _check_seam(values, place, runs, words, what, numbers)
        went_on_s = _since(other_s, place, step) if beat is None else _on_beat(time_s, beat, place, step)
        time_s[place:] += went_on_s - (time_s[place] - time_s[place - 1])
        ahead_s = 0.0 if is_back else ahead_s + jump_s - went_on_s
        ahead_s = 0.0 if abs(ahead_s) <= LOST * step < abs(jump_s) else ahead_s
        how = "back" if jump_s <= 0.0 else "on again" if is_back else "on"
        notes.append(
            f"the clock was set {how} by {abs(went_on_s - jump_s):.6g} s at {what} {numbers[place]}"
            f" (its stamp follows by {jump_s:.6g} s); what comes then is taken to go on {went_on_s:.6g} s later"
        )
    return Straight(np.arange(stamps_s.size), time_s, (*coarse, *_few(notes)))


def _is_undone(jump_s: float, later_s: np.ndarray, step: float) -> bool:
    """Return whether the next step back of a clock takes back that it was set on."""
    back = later_s[later_s < 0.0]
    return bool(back.size) and abs(jump_s - step + float(back[0]) - step) <= LOST * step


def _few(notes: list[str]) -> tuple[str, ...]:
    """Return the first notes, and how many more there are."""
    return tuple(notes) if len(notes) <= _MOST_NOTES else (*notes[:_MOST_NOTES], f"and {len(notes) - _MOST_NOTES} more such steps")


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
    leaves = there_and_back(steady)
    between, many = leaves & added(time_s), max(FEWEST, OFTEN * leaves.size)
    if leaves.any():
        words = f"the values jump there and back {_times(int(leaves.sum()))}, first at {what} {numbers[places[np.argmax(leaves)]]}"
        if between.sum() >= many or (leaves.sum() >= many and (not is_even(time_s) or np.mean(leaves) > IN_TURN)):
            parts = combs(places, time_s, said) or ((places[~between], places[between]) if between.sum() >= many else ())
            raise DisorderError(f"{words}: two senders of one signal, or one whose clock was set before the samples were sorted", parts)
        if between.any():
            straight = straight._replace(places=places[~between], time_s=time_s[~between])
            words = f"{_counted(int(between.sum()), what)} between two of the raster, whose values are far from both"
            words += f", first {what} {numbers[places[np.argmax(between)]]}: left out, of another sender"
            return _apart(straight._replace(notes=(*straight.notes, words)), values, names, what, numbers)
        if leaves.sum() >= many:  # a few are bad readings, which stand on their own in any recording
            straight = straight._replace(notes=(*straight.notes, words))
    if parts := persistent_combs(places, time_s, steady):
        words = f"{what}s of two even rates stand between each other, the second's from {what} {numbers[max(part[0] for part in parts)]} on"
        raise DisorderError(f"{words}, and what one says keeps to one side of the other: two senders of one signal", parts)
    alike = np.concatenate([[False], np.diff(time_s) <= 0.0])
    if not alike.any():
        return straight
    if (even_s := spread(time_s, steady, said)) is not None:
        return straight._replace(time_s=even_s, notes=(*straight.notes, told(int(np.count_nonzero(alike)), what)))
    same = alike & np.concatenate([[False], equal_rows(said[1:], said[:-1])])
    differ = np.flatnonzero(alike & ~same)
    scale = usual_change(steady)
    far = [place for place in differ.tolist() if np.any(np.abs(steady[place] - steady[place - 1]) > FAR * scale)]
    if far or differ.size > OFTEN * time_s.size:
        far = far or differ.tolist()
        words = f"{what}s {numbers[places[far[0] - 1]]} and {numbers[places[far[0]]]} have the same stamp and other values"
        words += f", and {len(far) - 1} more" if far[1:] else ""
        raise DisorderError(f"{words}: two senders of one signal", combs(places, time_s, said))
    return straight._replace(places=places[~alike], time_s=time_s[~alike], twice=int(np.count_nonzero(alike)))


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


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
        apart = np.flatnonzero((jump > FAR * usual_change(values)) & (jump > LOST * np.nanmax(change, axis=0, initial=0.0)))
    if apart.size:
        ends = np.cumsum([run.size for run in runs])
        parts = [np.arange(end - run.size, end) for run, end in zip(runs, ends, strict=True)]
        where = f"from {what} {numbers[place - 1]} to {numbers[place]}"
        raise DisorderError(f"{words}, and the values do not go on {where}: several runs", parts)
