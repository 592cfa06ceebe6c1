"""What the supervisor's process does, round by round: sleep for half a period, take the frames that came meanwhile, judge and answer.

It does not wait for frames, which would wake it at each of them, and its rounds end between the loop's ticks: on a computer of two
processors it would else take that of whoever exchanges them, at that moment. Where others send SYNC, nobody tells it when.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

import can
import numpy as np

from drivers.settings import BusSettings
from drivers.shared_memory.block import Block
from drivers.shared_memory.io_state import IoState, state_values, take_state
from drivers.shared_memory.supervisor_blocks import ANSWER, ASKED, END, ORDERS, OWN, PERMITS, ROUNDS, SESSION, TICK_S, WANTED_SESSION, WORD
from drivers.supervisor.supervisor import NMT, Supervisor

HELD_UP_ROUNDS = 8.0  # of a round's time, after which the process was held up: frames have come together meanwhile
ENDS = 0.7
"""Of a round's time after a tick of the loop, at which a round ends, and so on: 1.4 and 3.3 ms after a tick of 3.9 ms. By then a loop at
256 Hz has exchanged its frames, and before the next tick it is not yet awake. At 1 kHz the first falls among them."""
MOST_FRAMES = 64  # taken in a round, those of 9 ticks: who judges with frames unread calls a bus silent, who never does is silent itself
LINGERS_S = 2.0  # for which it goes on judging after the loop's process is gone


class Line(Protocol):
    """A bus that is read and written frame by frame."""

    def receive(self) -> tuple[int, bytes] | None:
        """Return the next data frame that has come; None where none has. Never waits."""

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame."""


class Clock(Protocol):
    """What the module `time` gives."""

    def monotonic(self) -> float:
        """Return a time [s] that never goes back."""

    def sleep(self, seconds: float, /) -> None:
        """Wait."""


class Shared(NamedTuple):
    """Memory that the supervisor's process shares."""

    own: Block  # what it writes for the loop
    orders: Block  # what the loop writes for it
    io: Block | None  # what the poller of the I/O publishes


class Rounds:
    """The supervisor at work between a bus, the memory that it shares with the loop, and the I/O's.

    Parameters
    ----------
    settings : BusSettings
    supervisor : Supervisor
        Who judges.
    line : Line
    shared : Shared
    asked : callable
        Who asks for a stop now, in words, '' where nobody does; it is given what answers a question.
    bench_is_there : callable
        Whether the loop's process lives.
    clock : Clock
    """

    def __init__(
        self,
        settings: BusSettings,
        supervisor: Supervisor,
        line: Line,
        shared: Shared,
        asked: Callable[[Callable[[], str]], str],
        bench_is_there: Callable[[], bool],
        clock: Clock = time,
    ) -> None:
        self._supervisor, self._settings, self._line, self._clock = supervisor, settings, line, clock
        self._own, self._orders, self._io = shared
        self._asked, self._bench_is_there = asked, bench_is_there
        self._who = ""  # asked for a stop, in any session
        self._stale_s = settings.io.stale_after_s if settings.io is not None else 0.0
        self._supervisor.end()  # until the bench begins a session
        self._round_s = 0.5 * settings.sync_period_s
        self._gone_s = 0.0
        self._has_left = False  # frames that the last round did not take
        self._told = np.zeros(ORDERS)
        self._values = np.zeros(OWN)
        self._state = IoState(len(settings.scalings))
        self._read = np.zeros(state_values(len(settings.scalings)))

    def run(self) -> None:
        """Go on until told to end, or some time after the loop's process is gone."""
        while not self.is_over:
            self.round()

    @property
    def is_over(self) -> bool:
        """Whether it was told to end, or the loop's process has been gone for long enough."""
        return bool(self._told[END]) or self._gone_s >= LINGERS_S

    def round(self) -> None:
        """Take orders and frames, judge, and answer."""
        began_s = self._clock.monotonic()
        self._heed()
        all_taken = self._take_frames(self._end_after(began_s))
        if not all_taken or self._clock.monotonic() - began_s > HELD_UP_ROUNDS * self._round_s:
            self._supervisor.held_up()
        now_s = self._clock.monotonic()
        if not self._bench_is_there():
            self._gone_s += now_s - began_s
            self._supervisor.refuse(now_s, "the bench's process is gone")
        self._judge(now_s)

    def _end_after(self, began_s: float) -> float:
        """Return when a round ends that begins now, by the loop's ticks where it has told them."""
        tick_s = self._told[TICK_S]
        left = 1.0 if not 0.0 < tick_s <= began_s else 1.0 - ((began_s - tick_s) / self._round_s - ENDS) % 1.0
        return float(began_s + left * self._round_s)

    def _take_frames(self, until_s: float) -> bool:
        """Take what has come by the end of the round, or at once where the last one left frames; return whether that is all."""
        if not self._has_left:
            self._clock.sleep(max(0.0, until_s - self._clock.monotonic()))
        self._has_left = False
        try:
            for _ in range(MOST_FRAMES):
                if (frame := self._line.receive()) is None:
                    return True
                self._supervisor.frame(self._clock.monotonic(), *frame)
            self._has_left = True
        except (can.CanError, OSError) as error:
            self._supervisor.refuse(self._clock.monotonic(), f"the bus cannot be read: {error}")
        return False

    def _heed(self) -> None:
        """Take the loop's orders and what others ask for."""
        session = self._told[WANTED_SESSION]
        self._orders.read(self._told)
        if self._told[WANTED_SESSION] != session:
            (self._supervisor.begin if self._told[WANTED_SESSION] > 0.0 else self._supervisor.end)()
        self._who = self._who or self._asked(self._seen)
        if self._who:
            self._asked(self._seen)
            self._supervisor.ask_to_stop(self._clock.monotonic(), self._who)

    def _seen(self) -> str:
        return f"{self._supervisor.torque}\n{self._supervisor.reason}"

    def _judge(self, now_s: float) -> None:
        supervisor, values = self._supervisor, self._values
        if self._io is not None and take_state(self._io, self._read, self._state) >= 0:
            fresh = now_s - self._state.time_s <= self._stale_s
            supervisor.io(now_s, self._state.hold_to_run and fresh, self._state.door_closed and fresh, self._state.brakes_open)
        answer = supervisor.answer(now_s, self._state.word)
        values[ROUNDS] += 1.0
        values[SESSION] = self._told[WANTED_SESSION]
        values[PERMITS], values[ASKED] = answer is not None, bool(supervisor.asked_by) and not supervisor.reason
        values[WORD], values[ANSWER] = self._state.word, answer or 0
        self._own.write(values, supervisor.reason or supervisor.asked_by)
        for command in supervisor.commands(now_s):
            with contextlib.suppress(can.CanError, OSError):
                self._line.send(NMT, bytes(command))
