"""What the supervisor judges: frames of the bus and states of the I/O go in, a permission comes out.

It shares no code with the sample loop, has no model and no clock of its own. The permission ends in the round in which hold-to-run, door
or a user ask for a stop, or something is wrong, and stays so until the next session. Without it no refresh reaches the I/O device, whose
outputs then fall: brakes close, whatever loop, recorder and poller do.

Of an axis whose drive may apply torque, or whose brake reports open, this is watched: SYNC goes on, and no faster than it may; torques,
velocities and ways asked for keep to their limits; the drive sends its position, and measures no more torque than it was asked for; no
encoder is faster than the limit and a half; with a link encoder, both move alike and within the range. Without permission no drive leads
its axis on, or its communication is stopped; one that is told to hold its axis and does not is reset, on which it has no voltage.

The laws are in `laws.py`, what they keep in mind in `memory.py`; here are their words, and the sessions.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from typing import Any

from drivers.modbus.refresh import following_word
from drivers.settings import BusSettings
from drivers.supervisor import laws
from drivers.supervisor.laws import CHECK, COMMAND, NOTHING, SAID, SPEED_STEPS, TAKE, judged, stands, take_frame
from drivers.supervisor.memory import memory_of

NMT, NMT_STOP, NMT_RESET = 0x000, 0x02, 0x81  # identifier, and commands that stop a node's communication, and reset it (CiA 301)

WORDS = {
    laws.NO_SYNC: "no SYNC for {much:.2f} s while a drive has torque or a brake is open",
    laws.FAST_SYNC: "SYNC comes faster than it may: a second producer",
    laws.TORQUE: "{axis}: a torque of {much:.0f} per mille was asked for, {most:.0f} are allowed",
    laws.VELOCITY: "{axis}: a velocity of {much:.0f} counts/s was asked for, {most:.0f} are allowed",
    laws.WAY: "{axis}: a way of {much:.0f} counts was asked for, {most:.0f} are allowed",
    laws.NO_POSITION: "{axis}: its drive sends no position while it has torque or the brake is open",
    laws.TORQUE_OFF: "{axis}: its drive measures a torque of {much:.0f} per mille, {most:.0f} was asked for",
    laws.MOTOR_FAST: "{axis}: its motor shows more than the {most:.2f} {unit}/s allowed in most of its last {steps} readings",
    laws.LINK_FAST: "{axis}: its link shows more than the {most:.2f} {unit}/s allowed in most of its last {steps} readings",
    laws.APART: "{axis}: its encoders are {much:+.2e} {unit} apart since it was released",
    laws.OUT_OF_RANGE: "{axis}: its link shows {much:+.3f} {unit}, out of its range and moving on",
    laws.NOT_HELD_BY_EFFORT: "{axis}: its drive does not hold it, as its effort shows; its voltage is taken",
    laws.NOT_HELD_BY_MOTOR: "{axis}: its drive does not hold it, as its motor shows; its voltage is taken",
    laws.NOT_HELD_BY_LINK: "{axis}: its drive does not hold it, as its link shows; its voltage is taken",
    laws.LED_ON: "{axis}: it is still led {much:.1f} s after {who} asked for a stop",
}


class Supervisor:
    """Judges a machine by what passes on its bus and by the state of its I/O.

    Attributes
    ----------
    noted : list
        Whoever hears frames may note them here instead of calling `frame`: identifier, data and time of each, one after the other. They are
        judged with the next question, and before more than MOST_NOTED of them wait, the caller has `take_noted` judge them.
    """

    def __init__(self, settings: BusSettings) -> None:
        self._settings = settings
        self._axis_of = {scaling.axis: number for number, scaling in enumerate(settings.scalings)}
        self._drives = [(self._axis_of[node.axis], node.node_id) for node in settings.nodes if node.role == "drive"]
        self.noted: list[Any] = []
        self.begin()

    def begin(self) -> None:
        """Begin a session: permit again, and forget what was seen."""
        self._words = ""  # of the first reason
        self.asked_by = ""
        self.noted.clear()
        memory = memory_of(self._settings)
        self._machine, self._axes, self._fields, self._places = memory.machine, memory.axes, memory.fields, memory.places

    def end(self) -> None:
        """End the session: nothing is permitted before the next."""
        self.refuse(-inf, "no bench runs")

    @property
    def reason(self) -> str:
        """What was wrong first, in words; '' where nothing was."""
        if self.noted:
            self.take_noted()
        if self._words or self._machine.law == NOTHING:
            return self._words
        scaling = self._settings.scalings[self._machine.axis]
        return WORDS[self._machine.law].format(
            axis=scaling.axis,
            much=self._machine.much,
            most=self._machine.most,
            unit=scaling.position_unit,
            steps=SPEED_STEPS,
            who=self.asked_by or "hold-to-run or the door",
        )

    @property
    def torque(self) -> str:
        """What the drives' torque does: "torque on", "held" where it only holds axes that stand, "no torque", or "unknown"."""
        self._judged(TAKE, 0.0)
        if any(axis.is_powered for axis in self._axes):
            return "torque on" if any(axis.is_powered and not stands(axis) for axis in self._axes) else "held"
        return "no torque" if all(axis.statusword >= 0 for axis in self._axes) else "unknown"

    def frame(self, time_s: float, can_id: int, data: bytes) -> None:
        """Take a data frame with an 11-bit identifier, whoever sent it."""
        place = self._places.get(can_id)
        if place is not None:
            word = int.from_bytes(data, "little")
            take_frame(self._machine, self._axes, self._fields, place, len(data), word, time_s)

    def take_noted(self) -> None:
        """Take the frames that were noted."""
        self._judged(TAKE, 0.0)

    def io(self, time_s: float, hold_to_run: bool, door_closed: bool, brakes_open: Iterable[bool] = ()) -> None:
        """Take a state of the I/O; `brakes_open` in the order of the axes, empty where it is not known."""
        for axis, brake_open in zip(self._axes, brakes_open, strict=False):
            axis.brake_open = bool(brake_open)
        if not (hold_to_run and door_closed):
            self._judged(TAKE, 0.0)
            if any(axis.is_powered or axis.brake_open for axis in self._axes):
                self._end_permission(time_s)

    def ask_to_stop(self, time_s: float, who: str) -> None:
        """Take the permission back because somebody asks for a stop."""
        self.asked_by = self.asked_by or who
        self._end_permission(time_s)

    def refuse(self, time_s: float, reason: str) -> None:
        """Take the permission back; the first reason stays."""
        self._words = self.reason or reason
        self._machine.law = self._machine.law or SAID
        self._end_permission(time_s)

    def _end_permission(self, time_s: float) -> None:
        self._machine.ended_at_s = min(self._machine.ended_at_s, time_s)

    def held_up(self) -> None:
        """Take note that frames were not taken for a while: SYNCs that come together now are no second producer."""
        self._judged(TAKE, 0.0)
        self._machine.syncs = min(self._machine.syncs, 1)

    def check(self, time_s: float) -> bool:
        """Judge, and return whether motion is permitted; call it at least every period."""
        is_permitted = self._judged(CHECK, time_s)
        if not is_permitted:
            self._words = self.reason  # now: it names who has asked by now
        return is_permitted

    def answer(self, time_s: float, word: int) -> int | None:
        """Return the word that refreshes a device which shows this one; None without permission."""
        return following_word(word) if self.check(time_s) else None

    def commands(self, time_s: float) -> list[tuple[int, int]]:
        """Return what the supervisor commands itself where the loop does not stop an axis (NMT; `laws.command`), as command and node."""
        self._judged(COMMAND, time_s)
        if not self._machine.commands:
            return []
        stopped = [(NMT_STOP, node) for axis, node in self._drives if self._axes[axis].is_to_stop]
        return stopped + [(NMT_RESET, node) for axis, node in self._drives if self._axes[axis].is_to_reset]

    def _judged(self, question: int, time_s: float) -> bool:
        """Judge all that came, answer the question, and return whether motion is permitted."""
        for can_id, data, heard_s in zip(*[iter(self.noted)] * 3, strict=True):
            self.frame(heard_s, can_id, data)
        self.noted.clear()
        return judged(self._machine, self._axes, question, time_s)
