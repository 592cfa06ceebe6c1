"""Two clocks, one loop: wall time with absolute ticks, and lockstep, where the emulated machine moves only when it is told to."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

SPIN_S = 400e-6
"""The last stretch before a tick is spent spinning, not sleeping: it brings wake-up lateness from tens of microseconds to none
(measured 46/61/84 us p50/p99/max with SCHED_FIFO asleep, 0/0/62 us with a spin of 150 us). The rehearsals take the rest."""

ANSWERS_AWAKE_S = 1e-3
"""So long after a SYNC its answers are looked for, not slept for: on CAN at 1 Mbit/s six of them take 0.8 ms. A sleeper costs whoever wakes
it as much time as it takes itself to wake, tens of microseconds for every frame."""


class WallClock:
    """Absolute ticks of `time.perf_counter`: sleep until shortly before each, spin the rest.

    A tick that is already past when the loop comes to wait for it is served at once, and its lateness says how late it was. When a whole
    period or more was lost, the lost ticks are skipped (a SYNC that comes in a burst would be worse than one that is missing) and counted.

    Parameters
    ----------
    spin_s : float
    waits : bool
        Lose no tick: all later ones come as much later. Time then is no longer the wall's, here too: it stood still while ticks were
        waited for, as the emulated machine's did, and every sample of the plan is sent.
    awake_s : float
        See `drivers.interface.Clock`; 0 without a real-time scheduler.
    """

    def __init__(self, spin_s: float = SPIN_S, waits: bool = False, awake_s: float = 0.0) -> None:
        self.awake_s = awake_s
        self.rehearsals: list[Callable[[], None]] = []  # done after the sleep: what the tick will have to do at once
        self._spin_s = spin_s
        self._waits = waits
        self._period_s = 0.0
        self._start_s = 0.0
        self._tick = 0
        self._missed = 0
        self._waited_s = 0.0  # that ticks were put off
        self.idle_began_s = 0.0  # when the loop last came to wait: its work was done
        self.tick_began_s = 0.0  # when the present tick was let go

    def now(self) -> float:
        """Seconds of the performance counter, less what ticks were put off."""
        return time.perf_counter() - self._waited_s

    def wait(self, seconds: float) -> None:
        """Sleep."""
        time.sleep(seconds)

    def start_ticks(self, period_s: float) -> None:
        """The first tick comes one period from now."""
        self._period_s = period_s
        self._start_s = time.perf_counter()
        self._tick = 0
        self._missed = 0

    def wait_tick(self) -> float:
        """Wait for the next tick; return its lateness [s]."""
        self.idle_began_s = now = time.perf_counter()
        self._tick += 1
        due = self._start_s + self._tick * self._period_s
        behind = int((now - due) / self._period_s)
        if behind >= 1:
            due += behind * self._period_s
            if self._waits:
                self._start_s += behind * self._period_s
                self._waited_s += behind * self._period_s
            else:
                self._tick += behind
                self._missed += behind
        asleep = due - now - self._spin_s
        if asleep > 0.0:
            time.sleep(asleep)
            for rehearse in self.rehearsals:
                rehearse()
        now = time.perf_counter()
        while now < due:
            now = time.perf_counter()
        self.tick_began_s = now
        return now - due

    @property
    def missed(self) -> int:
        """Ticks skipped since `start_ticks`."""
        return self._missed


@dataclass
class LockstepClock:
    """Virtual time: it passes when the loop waits, and the emulated machine moves on by exactly as much.

    Parameters
    ----------
    advance : callable
        Lets that many seconds pass on the emulated machine without a SYNC (heartbeats run, time-outs expire).
    machine_time : callable
        The emulated machine's own time [s].
    """

    advance: Callable[[float], None]
    machine_time: Callable[[], float]
    idle_began_s: float = 0.0
    tick_began_s: float = 0.0
    missed: int = 0
    awake_s: float = 0.0

    def now(self) -> float:
        """Virtual seconds."""
        return self.machine_time()

    def wait(self, seconds: float) -> None:
        """Let the emulated machine live that long."""
        self.advance(seconds)

    def start_ticks(self, period_s: float) -> None:
        """Nothing to align: a SYNC moves the machine by one period."""

    def wait_tick(self) -> float:
        """The next tick is now; in lockstep nothing is ever late."""
        self.idle_began_s = time.perf_counter()
        self.tick_began_s = self.idle_began_s
        return 0.0
