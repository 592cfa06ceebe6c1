"""Which faults act now: each begins when its condition has come and its time has passed, and ends after its duration."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from virtual_bus.faults.condition import Condition, Facts
from virtual_bus.faults.seam import Undo

ROUNDING_S = 1e-9
"""Times are sums of sample periods: rounding must not decide whether one that falls on a sample is reached there."""


@dataclass(frozen=True)
class Injection:
    """One fault of a run, ready to begin.

    Parameters
    ----------
    label : str
        `name at place`.
    begin : callable
        Begins the fault and returns what takes it back.
    when : Condition, optional
        Must hold once before the fault can begin; None: holds from power-on.
    from_s : float
        Time [s] between that instant and the fault.
    for_s : float
        How long the fault lasts [s]; infinite: for ever.
    """

    label: str
    begin: Callable[[], Undo]
    when: Condition | None
    from_s: float
    for_s: float


@dataclass(frozen=True)
class FaultEvent:
    """A fault has begun or ended."""

    time_s: float  # of the machine
    label: str
    begins: bool


class _Waiting:
    """An injection on its way from waiting to over."""

    def __init__(self, injection: Injection) -> None:
        self.injection = injection
        self.held_s = math.nan  # when the condition first held
        self.ends_s = math.inf
        self.undo: Undo | None = None
        self.over = False


class Schedule:
    """The faults of a run, asked once per sample."""

    def __init__(self) -> None:
        self._waiting: list[_Waiting] = []
        self.events: list[FaultEvent] = []

    def add(self, injection: Injection) -> None:
        """Add a fault."""
        self._waiting.append(_Waiting(injection))

    def step(self, facts: Facts, now_s: float) -> None:
        """Begin and end what is due at this time [s]."""
        for waiting in self._waiting:
            if waiting.over:
                continue
            if waiting.undo is None:
                self._perhaps_begin(waiting, facts, now_s)
            elif now_s >= waiting.ends_s - ROUNDING_S:
                waiting.undo()
                waiting.over = True
                self.events.append(FaultEvent(now_s, waiting.injection.label, False))

    def _perhaps_begin(self, waiting: _Waiting, facts: Facts, now_s: float) -> None:
        injection = waiting.injection
        if math.isnan(waiting.held_s):
            if injection.when is not None and not injection.when.holds(facts):
                return
            waiting.held_s = now_s if injection.when is not None else 0.0
        if now_s >= waiting.held_s + injection.from_s - ROUNDING_S:
            waiting.undo = injection.begin()
            waiting.ends_s = now_s + injection.for_s
            self.events.append(FaultEvent(now_s, injection.label, True))
