"""Bringing drives to rest from any state: quick stop, brakes, voltage off. Every step is tried, whatever the one before ran into."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.canopen import cia402
from drivers.canopen.cia402 import State
from drivers.canopen.cyclic import AxisInput, AxisOutput
from drivers.interface import Clock

QUICK_STOP_PATIENCE_S = 0.6  # for slowing down, and for the brakes to close
DISABLE_PATIENCE_S = 0.2
POWERED = frozenset(
    {State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}
)


class Attempts:
    """Runs steps one after the other and remembers what each ran into; never raises."""

    def __init__(self) -> None:
        self.trouble: list[str] = []

    def make(self, step: str, action: Callable[..., object], *arguments: object) -> None:
        """Try one step."""
        try:
            action(*arguments)
        except Exception as error:  # stopping goes on whatever one step runs into
            self.trouble.append(f"{step}: {error}")


def bring_to_rest(
    attempts: Attempts,
    clock: Clock,
    inputs: Sequence[AxisInput],
    outputs: Sequence[AxisOutput],
    tick: Callable[[], object],
    close_brakes: Callable[[], object],
    brakes_closed: Callable[[], bool],
) -> None:
    """Quick stop at once, brakes at once; voltage off only when the brakes have closed or their patience is over, so that nothing falls.

    Parameters
    ----------
    attempts : Attempts
    clock : Clock
    inputs, outputs : of the axes
    tick : callable
        One SYNC with zero targets, raising nothing but a dead bus.
    close_brakes, brakes_closed : callable
        Command, and feedback.
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
    attempts.make("slowing down", tick_until, QUICK_STOP_PATIENCE_S, lambda: brakes_closed() and State.OPERATION_ENABLED not in states())
    for output in outputs:
        output.controlword = cia402.DISABLE_VOLTAGE
    attempts.make("disabling voltage", tick_until, DISABLE_PATIENCE_S, lambda: POWERED.isdisjoint(states()))
