"""How the emulated machine's time follows a clock while no SYNC comes.

A machine on a bus between processes must give the same frames in the same order as one in lockstep, run after run. So a pause counts as
time only when somebody is really waiting: not while a master computes between two frames, not while a loaded computer hesitates in the
middle of a configuration, and not right after a device has spoken and somebody may be about to answer. What is held back then is made up
for.
"""

from __future__ import annotations

SILENCE_S = 0.1
"""So much waiting since the last SYNC, and time begins to pass, unless somebody says otherwise: longer than a busy computer lets a process
stand still, shorter than the usual heartbeat time-outs."""
QUIET_SHARE = 0.02
"""A pause between frames that is shorter than this share of that silence is the master computing. A frame that follows so promptly takes as
much of the waiting back: in a burst of frames single hesitations do not add up."""
ANSWER_SHARE = 0.2
"""After a device has spoken of its own accord, so much more silence before time goes on."""


class IdleTime:
    """Turns silence into sample periods.

    Parameters
    ----------
    period_s : float
        Time passes in whole sample periods.
    silence_s : float
        So much waiting since the last SYNC, and time begins to pass.
    """

    def __init__(self, period_s: float, silence_s: float = SILENCE_S) -> None:
        self._period_s, self._silence_s = period_s, silence_s
        self._quiet_s, self._answer_s = QUIET_SHARE * silence_s, ANSWER_SHARE * silence_s
        self._pause_s = 0.0  # since the last frame
        self._waited_s = 0.0  # up to the silence after which time passes
        self._owed_s = 0.0  # silence that has not yet become machine time

    def frame(self) -> None:
        """A frame has come from the master."""
        if self._pause_s < self._quiet_s:
            self._waited_s -= self._quiet_s
            if self._waited_s <= 0.0:
                self.sync()
        self._pause_s = 0.0

    def sync(self) -> None:
        """A SYNC has come: it alone moves time from here, and all waiting begins anew."""
        self._pause_s = self._waited_s = self._owed_s = 0.0

    def spoken(self) -> None:
        """A device has sent something while nobody asked."""
        self._waited_s -= self._answer_s

    def add(self, seconds: float) -> None:
        """The bus has been silent for that long, in slices of any length."""
        before = self._pause_s
        self._pause_s += seconds
        if self._pause_s < self._quiet_s:
            return
        silence_s = seconds if before >= self._quiet_s else self._pause_s
        self._waited_s = min(self._silence_s, self._waited_s + silence_s)
        self._owed_s += silence_s

    def step(self) -> bool:
        """Whether one sample period is to pass now; call until it says no."""
        if self._waited_s < self._silence_s or self._owed_s < self._period_s:
            return False
        self._owed_s -= self._period_s
        return True
