"""What a run said, held against what truly was: every sentence about the machine's state, or a cause, that the truth contradicts.

Of states the log of the true motion is the judge, of causes the faults that had begun (`hil.faults.causes`). A sentence that neither knows
is found by `unlisted`; one with a word of `STATE_WORDS` counts as a contradiction, so that no claim about the machine goes unchecked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.canopen.axis_rest import NOT_PROVEN
from drivers.errors import KEEP_AWAY
from hil.faults.causes import ADVICE, is_true, told_cause
from virtual_bus.faults.motion_log import HOLDING, MotionLog

STATE_WORDS = re.compile(r"\b(rest|stopped|held|holds|moves?|MOVES|stands?|stand|released|opened|closed|voltage|moved)\b")
BEFORE_S = 1.5
"""Time before a sentence within which what it tells of was seen: a second of waiting for a brake, and the proof behind it."""
SWING_S = 0.125  # a period of the slowest vibration
ROUNDED_S = 0.01  # of a time that is told in hundredths of a second
STOPPING_S = 0.1  # before a standstill, in which the axis still moved


@dataclass(frozen=True)
class Witness:
    """What is known of a run for certain.

    Parameters
    ----------
    log : MotionLog
        To the end of the watch.
    said_row : int
        Of the log: when the run had said all.
    standing, count : sequence of float
        By axis [rad or m]: how far an axis may swing that stands, and a count of its motor's encoder.
    faults : collection of str
        Names of those that had begun by then.
    rows : int
        Rows of the recording.
    since_stop_s : float
        From the beginning of the last stop until the run had said all; NaN: there was none.
    """

    log: MotionLog
    said_row: int
    standing: Sequence[float]
    count: Sequence[float]
    faults: Sequence[str]
    rows: int
    since_stop_s: float = np.nan

    def swing(self, axis: str, begin_s: float, end_s: float = np.inf) -> float:
        """Return the range of an axis's position between two times, counted from when the run had said all [rad or m]."""
        time_s = self.log.time_s
        said_s = time_s[self.said_row]
        inside = (time_s >= said_s + begin_s) & (time_s <= said_s + end_s)
        return float(np.ptp(self.log.position[inside, self.log.axes.index(axis)])) if inside.any() else 0.0

    def stood(self, axis: str, after_s: float) -> bool:
        """Return whether an axis moved until so long after the stop began, and from then on no more until all was said.

        Of an axis whose encoders are all wrong nobody knows.
        """
        if all(any(fault.startswith(side) for fault in self.faults) for side in ("motor_encoder_", "link_encoder_")):
            return True
        index, at_s = self.log.axes.index(axis), after_s - self.since_stop_s
        moved_until = self.swing(axis, at_s - ROUNDED_S - STOPPING_S, at_s + ROUNDED_S) >= self.count[index]
        return (after_s <= ROUNDED_S or moved_until) and self.swing(axis, at_s + ROUNDED_S, 0.0) <= self.standing[index]

    def stays(self, axis: str) -> bool:
        """Return whether an axis stood when that was said, and ever after."""
        return self.swing(axis, -SWING_S) <= self.standing[self.log.axes.index(axis)]

    def moved(self, axis: str) -> bool:
        """Return whether an axis moved by a count of its encoder or more shortly before."""
        return self.swing(axis, -BEFORE_S, 0.0) >= self.count[self.log.axes.index(axis)]

    def drives(self, axis: str) -> bool:
        """Return whether an axis's drive had its power stage on."""
        return int(self.log.drive[self.said_row, self.log.axes.index(axis)]) in HOLDING

    def brakes(self, axis: str) -> bool:
        """Return whether an axis's brake was closed, and has been since."""
        return bool((self.log.brake[self.said_row :, self.log.axes.index(axis)] > 0.0).all())

    def pushed(self, axis: str) -> bool:
        """Return whether an axis's drive pushed and let go while its brake was closed; one that gives always the same proves nothing."""
        index = self.log.axes.index(axis)
        row = slice(0, self.said_row + 1)
        held = (self.log.brake[row, index] > 0.0) & np.isin(self.log.drive[row, index], HOLDING)
        return bool(held.any()) and float(np.ptp(self.log.effort[row, index][held])) > 0.0

    def eased(self, axis: str) -> bool:
        """Return whether an axis's drive gives less than half of the most effort that it gave before."""
        effort = np.abs(self.log.effort[: self.said_row + 1, self.log.axes.index(axis)])
        return bool(effort[-1] < 0.5 * effort.max())

    def unpowered(self, axis: str) -> bool:
        """Return whether an axis's drive has applied no effort since."""
        return not self.drives(axis) and not self.log.effort[self.said_row :, self.log.axes.index(axis)].any()


Check = Callable[[Witness, str], bool]
OF_AN_AXIS: tuple[tuple[str, Check | None], ...] = (
    (r"at rest: brake proven, voltage off",
     lambda w, axis: w.stays(axis) and w.brakes(axis) and w.unpowered(axis) and w.pushed(axis)),
    (r"at rest: brake closed by its feedback(, not pushed: .*)?, (voltage off|no voltage)(, its drive in .*)?",
     lambda w, axis: w.stays(axis) and w.unpowered(axis)),
    (r"at rest: (.*), (voltage off|no voltage)(, its drive in .*)?", lambda w, axis: w.stays(axis) and w.unpowered(axis)),
    (r"held by its drive: .*", lambda w, axis: w.stays(axis) and w.drives(axis)),
    (r"not proven at rest: its drive is told to hold it and IT MOVES.*", lambda w, axis: w.moved(axis)),
    (r"not proven at rest: its drive did not hold it, .*, voltage off", lambda w, axis: w.unpowered(axis)),
    (r"not proven at rest: its drive .*", None),
    (r"nobody knows whether it stands: the stop broke off", None),
)  # fmt: skip
"""Ends of an axis's stop, and what each says of the truth; None: that nothing is known."""
OF_THE_SAME_AXIS: tuple[tuple[str, Check | None], ...] = (
    (r"it stands", lambda w, axis: w.swing(axis, -SWING_S, 0.0) <= w.standing[w.log.axes.index(axis)]),
    (r"IT MOVES", lambda w, axis: w.moved(axis)),
    (r"(nobody knows whether it moves|its motor side shows motion, its link none)", None),
    (r"its brake reports (open|closed).*", None),
    (r"its drive gives .* of its rated effort, it gave .*: something else carries it, or nothing", lambda w, axis: w.eased(axis)),
    (r"(the I/O does not say whether its brake is closed|the bench commands no brake of it).*", None),
)  # fmt: skip
OF_THE_RUN: tuple[tuple[str, Callable[[Witness, re.Match[str]], bool]], ...] = (
    (r"(?:row \d+: )?hold-to-run (?:was released|is not pressed)", lambda w, said: any("hold_to_run" in name for name in w.faults)),
    (r"(?:row \d+: )?the door (?:was opened|is open)", lambda w, said: "door_opened" in w.faults),
    (r"(\d+) rows are kept", lambda w, said: int(said[1]) == w.rows),
    (r"nothing was recorded", lambda w, said: w.rows == 0),
    (r"standstill ([\d.]+) s after the stop began(?: \((.*)\))?", lambda w, said: _stood(w, float(said[1]), said[2])),
    (r"no encoder moved by more than .* after the stop began", lambda w, said: all(w.stood(axis, 0.0) for axis in w.log.axes)),
    (r"nothing was moved", lambda w, said: not w.log.speed[: w.said_row].any()),
)  # fmt: skip


def contradictions(said: str, witness: Witness) -> list[str]:
    """Return every claim in the words of a run that the truth contradicts, and every sentence about a state that nobody checks.

    Parameters
    ----------
    said : str
        The run's last line.
    witness : Witness
    """
    found, axes = [], tuple[str, ...]()
    if ("IT MOVES" in said or NOT_PROVEN in said) and not said.startswith(f"{KEEP_AWAY}: "):
        found.append("nobody is told to keep away")
    if KEEP_AWAY in said and re.search("type release|upport the axis", said):
        found.append("somebody is sent to an axis that may move")
    said = said.removeprefix(f"{KEEP_AWAY}: ")
    names = "|".join(map(re.escape, witness.log.axes))
    for sentence in said.split("; "):
        text = sentence.removeprefix("the motors were stopped: ").removeprefix("found under voltage at the start, and ")
        about = re.fullmatch(rf"((?:{names})(?:, (?:{names}))*) (.*)", text)
        if about is not None and (checked := _of_axes(OF_AN_AXIS, about[2], tuple(about[1].split(", ")), witness)) is not None:
            axes = tuple(about[1].split(", "))
            found += [f"{axis} {about[2]}" for axis in checked]
        elif axes and (checked := _of_axes(OF_THE_SAME_AXIS, text, axes, witness)) is not None:
            found += [f"{axis}: {text}" for axis in checked]
        elif (holds := _of_run(text, witness)) is not None:
            found += [] if holds else [text]
        elif (kinds := told_cause(text)) is not None:
            found += [] if is_true(kinds, witness.faults) else [text]
        elif STATE_WORDS.search(text) and not ADVICE.fullmatch(text):
            found.append(f"nobody checks: {text}")
    return found


def unlisted(said: str, axes: Sequence[str]) -> list[str]:
    """Return every sentence in the words of a run that no table knows.

    Parameters
    ----------
    said : str
    axes : sequence of str
        Of the machine.
    """
    states = [pattern for pattern, _ in (*OF_AN_AXIS, *OF_THE_SAME_AXIS)] + [pattern for pattern, _ in OF_THE_RUN]
    names = "|".join(map(re.escape, axes))
    found = []
    for sentence in said.removeprefix(f"{KEEP_AWAY}: ").split("; "):
        text = sentence.removeprefix("the motors were stopped: ").removeprefix("found under voltage at the start, and ")
        state = re.sub(rf"^(?:{names})(?:, (?:{names}))* ", "", text)
        known = any(re.fullmatch(pattern, words) for pattern in states for words in (state, text))
        if text and not known and told_cause(text) is None and not ADVICE.fullmatch(text):
            found.append(sentence)
    return found


def _of_axes(table: Sequence[tuple[str, Check | None]], text: str, axes: Sequence[str], witness: Witness) -> list[str] | None:
    """Return the axes of which a text is not true; None where the table does not know it."""
    for pattern, check in table:
        if re.fullmatch(pattern, text):
            return [axis for axis in axes if check is not None and not check(witness, axis)]
    return None


def _stood(witness: Witness, last_s: float, each: str | None) -> bool:
    """Return whether every axis came to a standstill when a sentence says so: the last of them, and each where there are several."""
    axes = [part.split() for part in each.split(", ")] if each else [[witness.log.axes[0], str(last_s)]]
    times_s = {axis: 0.0 if words[0] == "within" else float(words[0]) for axis, *words in axes}
    return max(times_s.values()) == last_s and all(witness.stood(axis, time_s) for axis, time_s in times_s.items())


def _of_run(text: str, witness: Witness) -> bool | None:
    for pattern, check in OF_THE_RUN:
        if (said := re.fullmatch(pattern, text)) is not None:
            return check(witness, said)
    return None
