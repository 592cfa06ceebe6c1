"""The emulated machine's time while no SYNC comes.

A machine on a bus between processes must send the same frames in the same order as one in lockstep, in every run. So a pause counts as time
only when somebody is really waiting: not while a master computes between two frames, not while a loaded computer hesitates in the middle of
a configuration, and not right after a device has sent something that somebody may be about to answer. Time that is held back then is made
up for later.
"""

from __future__ import annotations

SILENCE_S = 0.1
"""Time begins to pass after this much waiting since the last SYNC, unless the settings of the bus say otherwise: longer than a busy
computer halts a process, shorter than the usual heartbeat time-outs."""
QUIET_SHARE = 0.02
"""A pause between frames that is shorter than this share of the silence counts as the master computing. A frame that follows so promptly
takes the same share of the waiting back, so that hesitations within a burst of frames do not add up."""
ANSWER_SHARE = 0.2
"""After a device has sent something unasked, the silence must last longer by this share before time goes on."""


class IdleTime:
    """Turns silence into sample periods.

    Parameters
    ----------
    period_s : float
        Time passes in whole sample periods.
    silence_s : float
        Time begins to pass after this much waiting since the last SYNC.
    by_the_wall : bool
        All time since the last SYNC passes then, whoever speaks: devices as real ones, for tools that judge their timers. Runs are not
        the same frame by frame any more.

    Attributes
    ----------
    waiting : bool
        Whether there has been any silence since the last SYNC: until then frames say nothing.
    """

    def __init__(self, period_s: float, silence_s: float = SILENCE_S, *, by_the_wall: bool = False) -> None:
        self._period_s, self._silence_s, self._by_the_wall = period_s, silence_s, by_the_wall
        self._quiet_s, self._answer_s = QUIET_SHARE * silence_s, ANSWER_SHARE * silence_s
        self.waiting = False
        self._pause_s = 0.0  # since the last frame
        self._waited_s = 0.0  # up to the silence after which time passes
        self._owed_s = 0.0  # silence that has not yet become machine time

    def frame(self) -> None:
        """Take note of a frame from the master."""
        if self._by_the_wall:
            return
        if self._pause_s < self._quiet_s:
            if self._waited_s > self._quiet_s:
                self._waited_s -= self._quiet_s
            else:
                self._waited_s = self._owed_s = 0.0
        self._pause_s = 0.0

    def sync(self) -> None:
        """Take note of a SYNC: it alone moves time, and all waiting begins anew."""
        self._pause_s = self._waited_s = self._owed_s = 0.0
        self.waiting = False

    def spoken(self) -> None:
        """Take note that a device has sent something unasked."""
        if not self._by_the_wall:
            self._waited_s -= self._answer_s

    def add(self, seconds: float) -> None:
        """Add silence of the bus, in slices of any length."""
        self.waiting = True
        if self._by_the_wall:
            self._waited_s += seconds
            self._owed_s += seconds
            return
        before = self._pause_s
        self._pause_s += seconds
        if self._pause_s < self._quiet_s:
            return
        silence_s = seconds if before >= self._quiet_s else self._pause_s
        self._waited_s = min(self._silence_s, self._waited_s + silence_s)
        self._owed_s += silence_s

    def step(self) -> bool:
        """Return whether one sample period is to pass; call until it returns False."""
        if self._waited_s < self._silence_s or self._owed_s < self._period_s:
            return False
        self._owed_s -= self._period_s
        return True
