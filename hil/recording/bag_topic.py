"""The samples of one topic of a bag, by signal, with both their clocks and their senders."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hil.recording.naming import Column
from hil.recording.senders import STRETCH
from hil.recording.stamps import DisorderError, Straight, straightened
from hil.recording.steps import LOST, usual_step


@dataclass
class Topic:
    """Messages in the order of the file, and the samples in them.

    Parameters
    ----------
    name : str
    stamps_ns, logged_ns : list of int
        The stamp in each message, 0 without one, and when it was logged.
    senders : list
        What tells the messages' senders apart, as far as the file says.
    samples : dict
        Signal -> (number of the message, value).
    """

    name: str
    stamps_ns: list[int] = field(default_factory=list)
    logged_ns: list[int] = field(default_factory=list)
    senders: list[Hashable] = field(default_factory=list)
    samples: dict[str, list[tuple[int, float]]] = field(default_factory=lambda: defaultdict(list))

    def add(self, stamp_ns: int, logged_ns: int, sender: Hashable) -> None:
        """Begin the next message."""
        self.stamps_ns.append(stamp_ns)
        self.logged_ns.append(logged_ns)
        self.senders.append(sender)

    @cached_property
    def times_ns(self) -> np.ndarray:
        """Stamps (N,) [ns]; those that are missing or stand still, by the times of logging since one that is not."""
        stamps, logged, without = self._stamps
        if without.all():
            return logged
        known = np.flatnonzero(~without)
        near = known[np.maximum(np.searchsorted(known, np.arange(stamps.size), side="right") - 1, 0)]
        return np.where(without, stamps[near] + logged - logged[near], stamps)

    @property
    def notes(self) -> list[str]:
        """What is said of the stamps."""
        without = self._stamps[2]
        if without.all() or not without.any():
            return []
        words = f"{np.count_nonzero(without)} of {without.size} messages have no stamp or that of those before, first message"
        return [f"{self.name}: {words} {np.argmax(without)}: taken by their times of logging"]

    @cached_property
    def _stamps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stamps (N,) and times of logging (N,) [ns], and which messages have no stamp of their own."""
        stamps, logged = np.array(self.stamps_ns, dtype=np.int64), np.array(self.logged_ns, dtype=np.int64)
        begins = (stamps == 0) & (np.append(stamps[1:], 0) > 0)  # a clock of a simulation begins at 0
        begins &= np.append(stamps[1:], 0) <= LOST * 1e9 * usual_step(1e-9 * stamps[stamps != 0])
        still = np.concatenate([[False], (np.diff(stamps) == 0) & (np.diff(logged) > 0)])
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        for begin, end in edges.reshape(-1, 2).tolist():
            still[begin:end] = end - begin >= STRETCH
        return stamps, logged, ((stamps == 0) & ~begins) | still


@dataclass
class Signals:
    """What the topics' signals are.

    Parameters
    ----------
    columns : dict
        Signal -> column; of one with several senders `signal@1`, `signal@2`.
    several : dict
        Such a signal -> the names of its parts, each with its number of samples.
    disorder : dict
        Signal that is none, or several -> why.
    notes : list of str
    repeated : int
        Samples at the time of another.
    """

    columns: dict[str, Column] = field(default_factory=dict)
    several: dict[str, list[str]] = field(default_factory=dict)
    disorder: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    repeated: int = 0


def signals_of(topics: list[Topic]) -> Signals:
    """Return the signals of all topics, each in order of time [s] since the first of all."""
    found = Signals()
    first_ns = min((int(topic.times_ns.min()) for topic in topics if topic.samples), default=0)
    for topic in topics:
        found.notes += topic.notes
        together: dict[bytes, list[str]] = {}
        for name, those in topic.samples.items():
            together.setdefault(np.array([number for number, _ in those], dtype=np.int64).tobytes(), []).append(name)
        for names in together.values():
            _add(found, topic, names, first_ns)
    return found


def _add(found: Signals, topic: Topic, names: list[str], first_ns: int) -> None:
    """Add signals that come in the same messages."""
    messages = np.array([number for number, _ in topic.samples[names[0]]])
    values = np.column_stack([[value for _, value in topic.samples[name]] for name in names]).astype(np.float64)
    time_s = 1e-9 * (topic.times_ns[messages] - first_ns)
    logged_ns = np.array(topic.logged_ns, dtype=np.int64)
    other_s = 1e-9 * (logged_ns - logged_ns[0])[messages] if any(topic.stamps_ns) else None

    def straight(places: np.ndarray) -> Straight:
        mine = None if other_s is None else other_s[places]
        mine = mine if mine is not None and np.all(np.diff(mine) > 0.0) else None
        return straightened(time_s[places], values[places], other_s=mine, names=names, what="message")

    words, parts = _senders(topic, messages)
    whole = np.arange(messages.size)
    try:
        if not parts:
            made = straight(whole)
            for column, name in enumerate(names):
                found.columns[name] = Column(values[made.places, column], None, made.time_s)
            found.notes += [f"{topic.name}: {note}" for note in made.notes if f"{topic.name}: {note}" not in found.notes]
            found.repeated += made.twice * len(names)
            return
    except DisorderError as problem:
        words, parts = str(problem), list(problem.parts)
    kept = []
    for part in parts:
        try:
            kept.append((part, straight(part)))
        except DisorderError:
            continue
    for column, name in enumerate(names):
        found.disorder[name] = f"{name}: {words}"
        for number, (part, made) in enumerate(kept, 1):
            own = f"{name}@{number}"
            found.columns[own] = Column(values[part[made.places], column], None, made.time_s)
            found.several.setdefault(name, []).append(own)


def _senders(topic: Topic, messages: np.ndarray) -> tuple[str, list[np.ndarray]]:
    """Return the places of each sender's messages, where there are several that take turns; else nothing."""
    places: dict[Hashable, list[int]] = {}
    for place, number in enumerate(messages.tolist()):
        places.setdefault(topic.senders[number], []).append(place)
    spans = sorted((those[0], those[-1]) for those in places.values())
    if all(one[1] < other[0] for one, other in itertools.pairwise(spans)):
        return "", []
    second = spans[1][0]
    words = f"{len(places)} senders (by channel, frame or joints), the second from message {second} on"
    return words, [np.array(those) for those in places.values()]
