"""A whole machine on a CAN bus behind `drivers.interface.MachineLink`: drives, encoders, the IMU on its serial line, the I/O over Modbus.

Life of a machine: `start` (boot, identity, configuration, operational), `home`, `enable`, `release_brakes`, `exchange` once per tick,
`stop`, `close`. Every error tells the motors to stop before it is raised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from drivers.canopen import power_and_brakes
from drivers.canopen.cia402 import Mode, State
from drivers.canopen.first_move_and_homing import commission_axis
from drivers.canopen.own_limits import allow_range
from drivers.canopen.profile_moves import go_to
from drivers.errors import MotionRefusedError
from drivers.ticking_machine import TickingMachine

LOOP_MODES = {
    "torque": Mode.CYCLIC_SYNCHRONOUS_TORQUE,
    "velocity": Mode.CYCLIC_SYNCHRONOUS_VELOCITY,
    "position": Mode.CYCLIC_SYNCHRONOUS_POSITION,
    "profile_velocity": Mode.PROFILE_VELOCITY,
    "profile_position": Mode.PROFILE_POSITION,
}


class CanMachine(TickingMachine):
    """A ticking machine and the phases in which it ticks by itself: homing, enabling, brakes.

    Each phase is watched, and stops the motors when it refuses. Parameters as for `TickingMachine`.

    Attributes
    ----------
    found_load : (n_axes,) array
        Effort beside the expected one that the last first move of each axis found to hold it, in the drive's unit.
    """

    found_load: np.ndarray = np.zeros(0)

    def home(
        self,
        holding_effort: np.ndarray | None = None,
        windup: np.ndarray | None = None,
        load_between: np.ndarray | None = None,
        *,
        check_first_move: bool = True,
        begins: Callable[[int], None] = lambda axis: None,
    ) -> tuple[str, ...]:
        """Check the first move, home and check encoder agreement of each axis. Drives are disabled and brakes closed before and after.

        Parameters
        ----------
        holding_effort : (n_axes,) array, optional
            Effort that holds each axis where it is, in the drives' units; none where the machine is balanced.
        windup : (n_axes,) array, optional
            How far each gear's deflection puts the link ahead of the motor side where the machine stands [rad or m].
        load_between : (n_axes, 2) array, optional
            Least and most effort beside the holding effort that may be what holds each axis of a sound machine; zero by default.
        check_first_move : bool
            Whether each axis is pushed a little to check that it moves in the right direction.
        begins : callable, optional
            Told the number of the axis whose turn it is.

        Returns
        -------
        tuple of str
            The checks and their findings, a line each.

        Raises
        ------
        MotionRefusedError
            A check failed, or the permission to move was withdrawn by hold-to-run, door or I/O.
        DeviceFaultError, HeartbeatLostError, BusError
        """
        holding = self.zeros.copy() if holding_effort is None else np.asarray(holding_effort, dtype=float).copy()
        between = np.zeros((len(self.axes), 2)) if load_between is None else load_between
        found: list[str] = []
        self.found_load = self.zeros.copy()
        with self.stopping_on_error():
            self._check_permission()
            for axis, homing in enumerate(self.settings.homings):
                begins(axis)
                alone = np.where(np.arange(len(self.axes)) == axis, holding, 0.0)
                ahead = 0.0 if windup is None else float(windup[axis])
                found += commission_axis(self, axis, homing, alone, ahead, between[axis], push=check_first_move)
                self.found_load[axis] = alone[axis] - holding[axis]
        return tuple(found)

    def enable(self, hold: power_and_brakes.Hold | None = None) -> None:
        """Bring every drive to operation enabled in the loop's mode, brakes closed.

        A drive in fault is reset first, and the reset is checked.

        Parameters
        ----------
        hold : callable, optional
            As in `release_brakes`, for drives that work their own brake and open it when they are enabled; zero otherwise.

        Raises
        ------
        MotionRefusedError
            Hold-to-run is not pressed or the door is open.
        DeviceFaultError, BusTimeoutError, HeartbeatLostError, BusError
        """
        with self.stopping_on_error():
            self._check_permission()
            axes = range(len(self.axes))
            for axis in axes:
                power_and_brakes.reset_fault(self, axis)
                power_and_brakes.set_mode(self, axis, LOOP_MODES[self.scalings[axis].mode])
                if self.scalings[axis].mode.endswith("position"):
                    allow_range(self, axis, self.settings.motions[axis])
            self.watch.stand()
            power_and_brakes.reach(self, State.OPERATION_ENABLED, axes, hold or (lambda _: self.zeros))

    def release_brakes(self, hold: power_and_brakes.Hold) -> None:
        """Hold the enabled axes, open all brakes, wait for their feedback.

        Parameters
        ----------
        hold : callable
            From the newest sample to the command (n_axes,) that holds: the loop's feedback, or a constant.

        Raises
        ------
        MotionRefusedError
            A brake's feedback does not follow, or the permission to move was withdrawn by hold-to-run, door or I/O.
        DeviceFaultError, HeartbeatLostError, BusError
        """
        with self.stopping_on_error():
            self.watch.stand()
            power_and_brakes.open_brakes(self, range(len(self.axes)), hold)

    def go_to(self, targets: Sequence[float], hold: power_and_brakes.Hold) -> None:
        """Let all drives, in profile position mode and released by `release_brakes`, go to their targets; errors as in `go_to`.

        Parameters
        ----------
        targets : (n_axes,) sequence
            [rad or m]
        hold : callable
            As in `release_brakes`.
        """
        with self.stopping_on_error():
            self.watch.lead()
            go_to(self, range(len(self.axes)), targets, self.settings.motions, hold)

    def close_brakes(self, hold: power_and_brakes.Hold) -> None:
        """Close all brakes while the drives still hold, prove them, disable the drives: the reverse of `release_brakes` and `enable`."""
        with self.stopping_on_error():
            axes = range(len(self.axes))
            self.watch.settle()
            power_and_brakes.come_to_rest(self, axes, hold)

    def _check_permission(self) -> None:
        """Make one tick, and check that motion is permitted."""
        self.exchange(self.zeros)
        refusal = self.refusal()
        if refusal:
            raise MotionRefusedError(refusal)
