"""A machine file before it is written: what is known of it, what is assumed and why, and what is still open."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from hil.errors import UnusableInputError


@dataclass(frozen=True)
class Value:
    """One value of the file.

    Attributes
    ----------
    value : number, text or list; None for an open point.
    why : of an assumption its reason, of an open point what to fill in, of what is known where from.
    is_known : whether it is known, and `why` a mere comment.
    """

    value: object
    why: str = ""
    is_known: bool = False


@dataclass(frozen=True)
class Question:
    """What is asked of a person or a script.

    Attributes
    ----------
    key : name of the answer, as `turn.mass_kg`.
    words : the question.
    read : makes a value of the answer's text; its ValueError says what would be right.
    otherwise : taken where nobody answers; None leaves the point open.
    """

    key: str
    words: str
    read: Callable[[str], object]
    otherwise: Value | None = None


class Answers:
    """Answers that were given, and someone to ask for the others.

    Parameters
    ----------
    given : mapping
        Key -> text.
    ask : callable, optional
        Returns the text of an answer; "" is none.
    """

    def __init__(self, given: Mapping[str, str], ask: Callable[[Question], str] | None = None) -> None:
        self._given = dict(given)
        self._ask = ask
        self._asked: list[str] = []

    def take(self, question: Question) -> Value:
        """Return the value of an answer, else what is assumed, else an open point.

        Raises
        ------
        UnusableInputError
            The answer that was given cannot be read.
        """
        self._asked.append(question.key)
        text = self._given.get(question.key, "")
        if text:
            try:
                return Value(question.read(text))
            except ValueError as error:
                raise UnusableInputError(f"--answer {question.key}={text}: {error}") from None
        while self._ask is not None and (text := self._ask(question).strip()):
            try:
                return Value(question.read(text))
            except ValueError as error:
                print(f"  {error}")
        return question.otherwise or Value(None, question.words.rpartition(question.key.partition(".")[0] + ": ")[2])

    def check(self) -> None:
        """Refuse answers to questions that were not asked.

        Raises
        ------
        UnusableInputError
            There is one.
        """
        if strange := [key for key in self._given if key not in self._asked]:
            raise UnusableInputError(f"--answer {strange[0]}: nothing asks for it; the questions are {', '.join(self._asked)}")


@dataclass
class DraftBody:
    """A body, and the joint by which it moves."""

    name: str
    parent: str
    values: dict[str, Value] = field(default_factory=dict)  # by key of the file, in its order
    joint: dict[str, Value] | None = None


@dataclass
class DraftAxis:
    """An axis: the joint it drives, and what is known of its drive, limits and node, by key of the file."""

    name: str
    joint: str
    kind: str  # "revolute" or "prismatic"
    drive: dict[str, Value] = field(default_factory=dict)
    brake: dict[str, Value] = field(default_factory=dict)
    limits: dict[str, Value] = field(default_factory=dict)
    node: dict[str, Value] = field(default_factory=dict)  # of its drive
    link: dict[str, Value] = field(default_factory=dict)  # of its link encoder
    homing: dict[str, Value] = field(default_factory=dict)


@dataclass
class Draft:
    """A machine, as far as it is known. `source` says where from, `left` what was not taken over."""

    name: str
    description: str
    source: str
    rate: Value
    gravity: Value
    bodies: list[DraftBody]
    axes: list[DraftAxis]
    left: list[str] = field(default_factory=list)
    sections: dict[str, list[list[float]]] = field(default_factory=dict)
    designed: str = ""  # what was designed, in words
