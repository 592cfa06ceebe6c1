"""The two clocks of the sample loop: wall time with absolute ticks, and lockstep, in which waiting advances the emulated machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

SPIN_S = 400e-6
"""Time before a tick in which the loop spins instead of sleeping, which removes the wake-up lateness of tens of microseconds
(measured 46/61/84 us p50/p99/max with SCHED_FIFO asleep, 0/0/62 us with a spin of 150 us). The rehearsals take the rest."""

MORE_S = 300e-6
"""By which the loop is awake sooner where the end of a motion window is rehearsed too, whose code no other tick brings into the caches."""

ANSWERS_AWAKE_S = 1e-3
"""Time after a SYNC in which its answers are polled without sleeping: on CAN at 1 Mbit/s six of them take 0.8 ms. A sleeping process costs
the process that wakes it as much time as its own wake-up, tens of microseconds for every frame."""


class WallClock:
    """Absolute ticks of `time.perf_counter`: sleep until shortly before each, then spin.

    A tick that is already past when the loop waits for it is served at once, with its lateness. When a whole period or more was lost, the
    lost ticks are skipped and counted, because SYNCs in a burst would be worse than missing ones.

    Parameters
    ----------
    spin_s : float
    waits : bool
        Lose no tick: all later ones are delayed by as much, and every sample of the plan is sent. The clock then differs from wall time,
        because it stands still while ticks are delayed, as the emulated machine's does.
    awake_s : float
        See `drivers.interface.Clock`; 0 without a real-time scheduler.
    """

    def __init__(self, spin_s: float = SPIN_S, waits: bool = False, awake_s: float = 0.0) -> None:
        self.awake_s = awake_s
        self.rehearsals: list[Callable[[], None]] = []  # called after the sleep, to warm up the code of the tick
        self.has_more_to_rehearse: Callable[[], bool] = lambda: False  # whether that takes longer before the next tick: see `MORE_S`
        self._spin_s = spin_s
        self._waits = waits
        self._period_s = 0.0
        self._start_s = 0.0
        self._tick = 0
        self._missed = 0
        self._waited_s = 0.0  # by which ticks were delayed
        self.idle_began_s = 0.0  # when the loop last began to wait, its work being done
        self.tick_began_s = 0.0  # when the present tick began

    def now(self) -> float:
        """Return seconds of the performance counter, less the delay of ticks."""
        return time.perf_counter() - self._waited_s

    def wait(self, seconds: float) -> None:
        """Sleep for this many seconds."""
        time.sleep(seconds)

    def start_ticks(self, period_s: float) -> None:
        """Start the ticks; the first comes after one period."""
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
        asleep = due - now - self._awake_before()
        if asleep > 0.0:
            time.sleep(asleep)
            for rehearse in self.rehearsals:
                rehearse()
        now = time.perf_counter()
        while now < due:
            now = time.perf_counter()
        self.tick_began_s = now
        return now - due

    def await_tick(
        self, comes: Callable[[float], bool], due_s: float, patience_s: float, shortly_before: Callable[[], object] | None = None
    ) -> bool:
        """Wait for a tick that somebody else gives: asleep until shortly before it is due, then awake for as long as answers are."""
        self.idle_began_s = time.perf_counter()
        asleep = due_s - self.now() - self._awake_before()
        came = comes(asleep) if asleep > 0.0 else False
        if asleep > 0.0 and not came:
            if shortly_before is not None:
                shortly_before()
            for rehearse in self.rehearsals:
                rehearse()
        while not came and self.now() < due_s + self.awake_s:
            came = comes(0.0)
        came = came or comes(max(0.0, due_s + patience_s - self.now()))
        self.tick_began_s = time.perf_counter()
        return came

    def _awake_before(self) -> float:
        """Return how long before the next tick the loop is awake [s]."""
        return self._spin_s + MORE_S if self.has_more_to_rehearse() else self._spin_s

    def lose(self, ticks: int) -> None:
        """Count ticks that were lost while others gave them."""
        self._missed += ticks

    @property
    def missed(self) -> int:
        """Ticks skipped since `start_ticks`."""
        return self._missed


BEHIND_S = 0.05
"""By which paced virtual time may be behind the wall before the wall waits for it."""


@dataclass
class LockstepClock:
    """Virtual time, which passes when the loop waits; the emulated machine advances by exactly as much.

    Parameters
    ----------
    advance : callable
        Lets this many seconds pass on the emulated machine without a SYNC (heartbeats run, time-outs expire).
    machine_time : callable
        The emulated machine's own time [s].
    paced : bool
        Whether it passes no faster than on the wall, for somebody who watches; on a computer that is too slow it passes as fast as it can.
    """

    advance: Callable[[float], None]
    machine_time: Callable[[], float]
    idle_began_s: float = 0.0
    tick_began_s: float = 0.0
    missed: int = 0
    awake_s: float = 0.0
    waited_s: float = 0.0  # in which the machine's own time stood still between two SYNCs
    paced: bool = False
    _ahead_s: float = float("-inf")  # of the machine's time, before the wall's

    def now(self) -> float:
        """Return virtual seconds."""
        return self.machine_time()

    def wait(self, seconds: float) -> None:
        """Advance the emulated machine by this many seconds."""
        self.waited_s += seconds
        self.advance(seconds)
        self._keep_pace()

    def start_ticks(self, period_s: float) -> None:
        """Do nothing: a SYNC advances the machine by one period, so ticks need no alignment."""

    def wait_tick(self) -> float:
        """Begin the next tick at once, or when its time has come, and return a lateness of 0, since nothing is late in lockstep."""
        self._keep_pace()
        self.idle_began_s = time.perf_counter()
        self.tick_began_s = self.idle_began_s
        return 0.0

    def await_tick(
        self, comes: Callable[[float], bool], due_s: float, patience_s: float, shortly_before: Callable[[], object] | None = None
    ) -> bool:
        """Let virtual time pass until the tick comes that somebody else gives."""
        if shortly_before is not None:
            shortly_before()
        came = comes(max(0.0, due_s + patience_s - self.now()))
        self.wait_tick()
        return came

    def lose(self, ticks: int) -> None:
        """Count ticks that were lost while others gave them."""
        self.missed += ticks

    def _keep_pace(self) -> None:
        """Sleep until the wall's time has come; what was lost is not made up for, since an arm that hurries is no arm to be watched."""
        if not self.paced:
            return
        ahead_s = self.machine_time() - time.perf_counter()
        if ahead_s > self._ahead_s:
            if self._ahead_s > float("-inf"):
                time.sleep(ahead_s - self._ahead_s)
            else:
                self._ahead_s = ahead_s
        elif ahead_s < self._ahead_s - BEHIND_S:
            self._ahead_s = ahead_s
