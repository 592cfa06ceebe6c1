"""Tables in which each line is of one joint or node: a column says of which."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np

from hil.errors import RecordingError
from hil.recording.said import listed
from hil.recording.steps import COARSE, LOST

_LABELS = re.compile(
    r"(?:joint|axis|node|motor|drive|device|actuator|servo|can|sender|source|publisher|frame|topic|channel|signal|unit|slave)?"
    r"[\s_.-]*(?:name|id|nr|no|number|address)?",
    re.IGNORECASE,
)
"""Heads of such columns."""

_COUNTERS = re.compile(r"frame[\s_.-]*(?:id|nr|no|number)?|nr|no|number", re.IGNORECASE)
"""Those of them that a count of the lines has, too."""

_MOST_LABELS = 64
"""Of a machine: a column with more values counts or measures."""

_TAKES_TURNS = 0.25
"""Share of lines with another label than the line before, from which those lines are of several senders."""

Lines = list[tuple[int, list[str]]]
"""Number of a line in the file, and its cells."""


def of_one_part(
    header: Sequence[str], lines: Lines, time_place: int | None, named: Collection[str], part: str
) -> tuple[Lines, int | None, list[str]]:
    """Return the lines of one joint, the place of the column that says so, and what was taken; all lines where no column says it.

    Parameters
    ----------
    header, lines
        Of the table; every line has as many cells as the header.
    time_place : int, optional
        Of the column of times.
    named : collection of str
        Columns that are channels, which are no labels.
    part : str
        `joint@roll`: the lines with `roll` in the column `joint`.

    Raises
    ------
    RecordingError
        A column says whose the lines are, and `part` not which; or there is no such part.
    """
    places = {place: head.strip() for place, head in enumerate(header) if head.strip() and _LABELS.fullmatch(head.strip())}
    wanted, _, label = part.partition("@")
    for place, head in places.items():
        if place == time_place or head in named:
            continue
        labels = [cells[place].strip() for _, cells in lines]
        counts = Counter(labels)
        ways = [f"'{head}@{one}=part' ({number} line{'' if number == 1 else 's'})" for one, number in counts.items()]
        if wanted and wanted == head:
            if label not in counts:
                raise RecordingError(f"{part}=part: no such line; --map takes {listed(ways[:_MOST_LABELS])}")
            kept = [line for line, own in zip(lines, labels, strict=True) if own == label]
            return kept, place, [f"the {len(kept)} lines of {part} are taken of {len(lines)}"]
        if not part and 1 < len(counts) <= _MOST_LABELS and min(counts.values()) > 1 and _are_apart(labels, lines, time_place):
            if _COUNTERS.fullmatch(head) and _is_count(labels, lines, place, time_place):
                continue
            raise RecordingError(f"column {head} says whose a line is; take one with --map {' or '.join(ways)}")
    if wanted:
        raise RecordingError(f"{part}=part: no column {wanted} that says whose a line is")
    return lines, None, []


def _are_apart(labels: Sequence[str], lines: Lines, time_place: int | None) -> bool:
    """Return whether lines with other labels are others' lines: they take turns, or share their times."""
    turns = sum(one != other for one, other in zip(labels[1:], labels, strict=False))
    return turns > _TAKES_TURNS * len(labels) or _share_times(labels, lines, time_place)


def _share_times(labels: Sequence[str], lines: Lines, time_place: int | None) -> bool:
    times = [] if time_place is None else [cells[time_place] for _, cells in lines]
    return len(set(times)) < len(times) - len(labels) // len(set(labels)) // 2


def _is_count(labels: Sequence[str], lines: Lines, label_place: int, time_place: int | None) -> bool:
    """Return whether labels count the lines and begin anew at a limit, and numbers go on from line to line as well as from cycle to cycle.

    Those of parts that take turns go on from cycle to cycle only.
    """
    if not all(label.isdecimal() for label in labels) or _share_times(labels, lines, time_place):
        return False
    counts = np.array([int(label) for label in labels])
    cycle = int(np.ptp(counts)) + 1
    if np.mean(np.diff(counts) % cycle == 1) < 1.0 - COARSE or len(counts) <= 2 * cycle:
        return False
    others = [place for place in range(len(lines[0][1])) if place != label_place]
    table = np.array([[_number(cells[place]) for place in others] for _, cells in lines])
    for column in table[:, np.isfinite(table).all(axis=0)].T:
        if np.mean(np.diff(column) % cycle == 1.0) >= 1.0 - COARSE:  # the same count again
            continue
        near, far = (np.mean(np.abs(column[many:-many] - 0.5 * (column[: -2 * many] + column[2 * many :]))) for many in (1, cycle))
        if near > LOST * far:
            return False
    return True


def _number(cell: str) -> float:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return np.nan
