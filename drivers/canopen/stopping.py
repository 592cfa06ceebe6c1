"""Stop of the drives from any state: quick stop, brakes, voltage off. Every step is tried, even when the one before failed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from drivers.canopen import cia402
from drivers.canopen.cia402 import State
from drivers.canopen.cyclic import AxisInput, AxisOutput
from drivers.interface import Clock

QUICK_STOP_PATIENCE_S = 0.6  # for slowing down, and for the brakes to close
DISABLE_PATIENCE_S = 0.2
STANDSTILL_S = 0.05  # an axis whose position has not changed for this long stands still
STANDSTILL_COUNTS = 1.5  # a position held by its drive may flicker by a count
POWERED = frozenset(
    {State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}
)


class Attempts:
    """Runs steps one after the other and collects their errors; never raises."""

    def __init__(self) -> None:
        self.trouble: list[str] = []

    def make(self, step: str, action: Callable[..., object], *arguments: object) -> None:
        """Try one step."""
        try:
            action(*arguments)
        except Exception as error:  # stopping continues after any error
            self.trouble.append(f"{step}: {error}")


class Standstill:
    """Determines, tick by tick, which axes have stood still for `STANDSTILL_S`; with a missing position an axis does not count as still.

    Parameters
    ----------
    resolution : (n_axes,) array
        One count of each axis [rad or m].
    period_s : float
        Between ticks.
    """

    def __init__(self, resolution: np.ndarray, period_s: float) -> None:
        self._window = STANDSTILL_COUNTS * resolution
        self._needed = math.ceil(STANDSTILL_S / period_s)
        self._anchor = np.full(len(resolution), np.nan)
        self._ticks = np.zeros(len(resolution), dtype=np.int64)

    def update(self, position: np.ndarray) -> None:
        """Take the newest positions (n_axes,)."""
        still = np.abs(position - self._anchor) <= self._window
        self._ticks = np.where(still, self._ticks + 1, 0)
        self._anchor = np.where(still, self._anchor, position)

    def of(self, axis: int) -> bool:
        """Return whether this axis stands still."""
        return bool(self._ticks[axis] >= self._needed)


def bring_to_rest(
    attempts: Attempts,
    clock: Clock,
    inputs: Sequence[AxisInput],
    outputs: Sequence[AxisOutput],
    tick: Callable[[], object],
    close_brakes: Callable[[], object],
    at_rest: Callable[[int, bool], bool],
) -> None:
    """Quick stop and close the brakes at once; switch voltage off only when every axis is at rest or time is up, so that nothing falls.

    Parameters
    ----------
    attempts : Attempts
    clock : Clock
    inputs, outputs : of the axes
    tick : callable
        One SYNC with zero targets, raising nothing but a dead bus.
    close_brakes : callable
        Commands all brakes to close.
    at_rest : callable
        Takes an axis and whether its drive is powered. Returns whether the voltage may be switched off: its brake has closed or, where the
        bench commands none, its drive has brought it to a standstill.
    """

    def tick_until(patience_s: float, done: Callable[[], bool]) -> None:
        deadline = clock.now() + patience_s
        tick()
        while not done() and clock.now() < deadline:
            tick()

    def states() -> list[State]:
        return [cia402.decode_state(source.statusword) for source in inputs]

    for output in outputs:
        output.controlword = cia402.QUICK_STOP
    attempts.make("quick stop", tick)
    attempts.make("closing the brakes", close_brakes)
    attempts.make(
        "slowing down",
        tick_until,
        QUICK_STOP_PATIENCE_S,
        lambda: all(state is not State.OPERATION_ENABLED and at_rest(axis, state in POWERED) for axis, state in enumerate(states())),
    )
    for output in outputs:
        output.controlword = cia402.DISABLE_VOLTAGE
    attempts.make("disabling voltage", tick_until, DISABLE_PATIENCE_S, lambda: POWERED.isdisjoint(states()))
