"""Stop of all axes from any state, and the service of a hold where a brake is not proven."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Sequence
from typing import Protocol

from drivers.canopen.axis_rest import AxisRest
from drivers.canopen.quick_stop import AxisStop
from drivers.errors import KEEP_AWAY
from drivers.interface import Clock, Sample

SAY_EVERY_S = 5.0
"""Time between two reports of a hold, after each of which the brakes are told to close once more."""


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


class Attendant(Protocol):
    """Who looks after axes that only their drives hold."""

    def say(self, text: str) -> None:
        """Tell an operator."""

    def stays(self, held_s: float) -> bool:
        """Return whether the hold is served on, `held_s` after it began. When it is left, the drives hold by themselves or not at all."""

    def released(self) -> Collection[str]:
        """Return the axes that an operator has confirmed, since it was last asked, to be supported."""


class Unattended:
    """Serves a hold without end, in silence."""

    def say(self, text: str) -> None:
        """Say nothing."""

    def stays(self, held_s: float) -> bool:
        """Stay."""
        return True

    def released(self) -> Collection[str]:
        """Nobody confirms anything."""
        return ()


class Stops:
    """The stops of several axes, stepped together.

    Parameters
    ----------
    axes : sequence of AxisStop
    clock : Clock
    sample : Sample
        Which `tick` overwrites.
    tick : callable
        One SYNC with the stops' controlwords and efforts; raises nothing but a dead bus.
    close_brakes : callable
        Told the axes whose brakes are to close.
    io_is_fresh : callable
    to_torque : callable
        Brings the drive of an axis into cyclic synchronous torque mode; returns whether it did.
    command_node : callable
        Sends an NMT command to an axis's drive.
    """

    def __init__(
        self,
        axes: Sequence[AxisStop],
        clock: Clock,
        sample: Sample,
        tick: Callable[[], object],
        close_brakes: Callable[[Sequence[str]], object],
        io_is_fresh: Callable[[], bool],
        to_torque: Callable[[int], bool],
        command_node: Callable[[int, int], object],
    ) -> None:
        self.axes = axes
        self._clock, self._sample, self._tick = clock, sample, tick
        self._close_brakes, self._io_is_fresh, self._to_torque = close_brakes, io_is_fresh, to_torque
        self._command_node = command_node
        self._missed = clock.missed
        self.alarm: Callable[[str], object] = lambda text: None
        """Takes what an operator must be told while the stop goes on."""

    def run(self) -> None:
        """Step, tick by tick, until every axis is at rest, held, or given up. The brakes are told first: a bus may be dead."""
        self._order_brakes()
        while any(axis.rest is None for axis in self.axes):
            self.step()
        self._tick()  # the last controlwords

    def step(self) -> None:
        """Make one tick."""
        self._tick()
        fresh, missed, before = self._io_is_fresh(), self._clock.missed, self._missed
        for axis in self.axes:
            axis.step(self._sample, io_is_fresh=fresh, ticks=1 + max(0, missed - before))
        self._missed = missed
        self._order_brakes()
        for axis in self.axes:
            if axis.orders_node:
                self._command_node(axis.axis, axis.orders_node)
                axis.orders_node = 0
            if axis.alarm:
                with contextlib.suppress(OSError, ValueError):  # a terminal that is gone keeps no stop from going on
                    self.alarm(f"{KEEP_AWAY}: {axis.name}: {axis.alarm}")
                axis.alarm = ""
            if axis.asks_for_torque:
                axis.torque_mode(self._to_torque(axis.axis))

    def _order_brakes(self) -> None:
        ordered = [axis for axis in self.axes if axis.orders_brake]
        if ordered:
            self._close_brakes([axis.name for axis in ordered])
            for axis in ordered:
                axis.orders_brake = False

    @property
    def held(self) -> list[AxisRest]:
        """The axes that only their drives hold."""
        return [rest for rest in self.rests if rest.held]

    @property
    def rests(self) -> list[AxisRest]:
        """How the axes that have come to an end did."""
        return [rest for axis in self.axes if (rest := axis.rest) is not None]

    def serve_hold(self, attendant: Attendant) -> None:
        """Hold what only its drive holds, until its brake is proven, an operator releases it, or the attendant leaves."""
        if not self.held:
            return
        began_s = said_s = self._clock.now()
        attendant.released()  # what was confirmed before there was a hold confirms nothing
        attendant.say(in_words(self.held))
        while self.held:
            now_s = self._clock.now()
            tries_again = now_s - said_s >= SAY_EVERY_S
            if released := attendant.released():
                for axis in self.axes:
                    if axis.name in released:
                        axis.release()
            elif not attendant.stays(now_s - began_s):
                return
            elif tries_again:
                said_s = now_s
                for axis in self.axes:
                    axis.close_again()
            self.step()
            while any(axis.rest is None for axis in self.axes):
                self.step()
            if tries_again or not self.held:
                attendant.say(in_words(self.rests))


def in_words(rests: Sequence[AxisRest]) -> str:
    """Return how axes were brought to rest, those with the same end together; first what is to be done where one may move."""
    together: dict[str, list[str]] = {}
    for rest in rests:
        together.setdefault(rest.words, []).append(rest.axis)
    ends = "; ".join(f"{', '.join(axes)} {words}" for words, axes in together.items())
    return f"{KEEP_AWAY}: {ends}" if any(rest.may_move for rest in rests) else ends
