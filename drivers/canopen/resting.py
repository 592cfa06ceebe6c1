"""How a machine is brought to rest, and how each of its axes was seen to end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from drivers.canopen import power_and_brakes
from drivers.canopen.axis_rest import AxisRest
from drivers.canopen.cia402 import Mode
from drivers.canopen.quick_stop import AxisStop
from drivers.canopen.stopping import Attempts, Attendant, Stops, in_words
from drivers.errors import DriverError, MotionRefusedError
from drivers.settings import BusSettings

Ticks = Callable[[np.ndarray], object]
"""One SYNC with the efforts of all axes, which raises nothing but a dead bus."""


class Machine(power_and_brakes.Machine, Protocol):
    """What a stop needs of a machine besides what the procedures of its drives need."""

    settings: BusSettings

    def io_is_fresh(self) -> bool:
        """Return whether the I/O's newest state is recent enough."""

    def command_node(self, axis: int, command: int) -> None:
        """Send an NMT command to an axis's drive."""

    def stand(self, axis: int) -> None:
        """Let a drive's own loops stand, where it does not obey or is enabled anew."""


class Resting:
    """Brings the axes of a machine to rest.

    Parameters
    ----------
    machine : Machine
    tick : Ticks
    """

    def __init__(self, machine: Machine, tick: Ticks) -> None:
        self._machine, self._tick = machine, tick
        self.rests: tuple[AxisRest, ...] = ()
        """How each axis ended in the last stop of the whole machine."""

    @property
    def held(self) -> set[str]:
        """The axes that only their drives held when the last stop ended, or that they may hold: a stop that broke off does not tell."""
        return {rest.axis for rest in self.rests if rest.held}

    @property
    def outcome(self) -> str:
        """How the last stop ended, in words, as far as it was seen."""
        if not self.rests:
            return "nothing was moved"
        words = in_words(self.rests)
        return f"the motors were stopped: {words}" if all(rest.safe for rest in self.rests) else words

    def stop_all(self, attempts: Attempts, attendant: Attendant) -> None:
        """Stop every axis; where a brake is not proven the drive holds, until the attendant lets it."""
        stops = self._stops(range(len(self._machine.axes)))
        stops.alarm = attendant.say
        attempts.make("stopping", stops.run)
        attempts.make("holding", stops.serve_hold, attendant)
        ended = {rest.axis: self._with_node_state(rest) for rest in stops.rests}
        unknown = "nobody knows whether it stands: the stop broke off"
        self.rests = tuple(ended.get(axis, AxisRest(axis, False, True, unknown, may_move=True)) for axis in self._machine.axes)

    def _with_node_state(self, rest: AxisRest) -> AxisRest:
        """Return how an axis ended, with what is known of a drive that does not answer: its heartbeat tells its state."""
        machine = self._machine
        state = machine.heartbeats.nmt_state(machine.drives[machine.axes.index(rest.axis)].node_id)
        known = "" if state in ("operational", "never heard") else f" (its node is {state})"
        return replace(rest, words=rest.words.replace("does not answer", f"does not answer{known}"))

    def take_over(self, axes: Sequence[int]) -> None:
        """Bring to rest what drives held before this bench came.

        Raises
        ------
        MotionRefusedError
            A brake is not proven; its drive holds.
        """
        stops = self._stops(axes)
        stops.run()
        self._refuse_unproven(stops, "found under voltage at the start, and ")

    def rest_axes(self, axes: Sequence[int], effort: np.ndarray | None) -> None:
        """Prove the closed brakes of enabled axes that stand, and take their voltage; see `drivers.canopen.quick_stop`.

        Parameters
        ----------
        axes : sequence of int
        effort : (n_axes,) array or None
            With which the drives hold them now; None: nothing holds them yet, and they are stopped first.

        Raises
        ------
        MotionRefusedError
            A brake is not proven; its drive holds.
        """
        stops = self._stops(axes)
        for axis in stops.axes:
            self._machine.arm(axis.axis, False)
            if effort is not None:
                axis.prove(float(effort[axis.axis]))
        stops.run()
        self._refuse_unproven(stops)

    @staticmethod
    def _refuse_unproven(stops: Stops, begins: str = "") -> None:
        if unproven := [rest for rest in stops.rests if not rest.safe]:
            raise MotionRefusedError(f"{begins}{in_words(unproven)}")

    def _stops(self, axes: Iterable[int]) -> Stops:
        """Return the stops of these axes; all others keep their controlwords."""
        machine = self._machine
        stops = [
            AxisStop(
                axis,
                machine.scalings[axis],
                machine.settings.motions[axis],
                machine.settings.homings[axis],
                machine.period_s,
                braked=machine.has_brake(axis),
                takes_torque=machine.modes[axis] is Mode.CYCLIC_SYNCHRONOUS_TORQUE,
                pushes=machine.takes_effort(axis),
            )
            for axis in axes
        ]
        efforts = np.zeros(len(machine.axes))

        def tick() -> None:
            for stop in stops:
                machine.set_controlword(stop.axis, stop.controlword)
                machine.stand(stop.axis)
                efforts[stop.axis] = stop.effort
            self._tick(efforts)

        from_machine = machine.io_is_fresh, self._to_torque, machine.command_node
        return Stops(stops, machine.clock, machine.sample, tick, self._close_brakes, *from_machine)

    def _close_brakes(self, axes: Sequence[str]) -> None:
        self._machine.command_brakes(dict.fromkeys(axes, False))

    def _to_torque(self, axis: int) -> bool:
        try:
            power_and_brakes.set_mode(self._machine, axis, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
        except DriverError:
            return False
        return True
