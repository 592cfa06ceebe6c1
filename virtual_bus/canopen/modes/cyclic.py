"""Cyclic synchronous torque, velocity and position (IEC 61800-7-201): the master sends a target and offsets with every SYNC."""

from __future__ import annotations

from virtual_bus.canopen.modes.following_error import FollowingError
from virtual_bus.canopen.modes.mode import FOLLOWS_COMMAND, Following, Mode, Read
from virtual_bus.canopen.servo import Demand, Servo


class CyclicTorque(Mode):
    """Target torque plus torque offset."""

    number = 10
    supported_bit = 9
    needs = (0x6071,)
    steady = True

    def __init__(self, servo: Servo) -> None:
        super().__init__(servo)
        self._target, self._offset = servo.entry(0x6071), servo.entry(0x60B2)

    def torque(self) -> int:
        """Return the sum, within the limits; the drive has marked the servo as not limited."""
        limit, target = self.servo.limit, self._target.value + self._offset.value
        if -limit <= target <= limit:
            return target
        torque = min(max(target, -limit), limit)
        self.servo.limited = torque != target
        return torque

    def foreseen(self, read: Read, *, takes_over: bool) -> int:
        """Return the sum that will be, within the limits."""
        limit, target = self.servo.limit, read(self._target) + read(self._offset)
        return min(max(target, -limit), limit)

    def status(self, *, in_charge: bool) -> int:
        """Return bit 12: the drive follows its target."""
        return FOLLOWS_COMMAND if in_charge else 0


class CyclicVelocity(Following):
    """Target velocity plus velocity offset through the velocity loop, the torque offset behind it."""

    number = 9
    supported_bit = 8
    needs = (0x60FF,)
    steady = True

    def __init__(self, servo: Servo) -> None:
        super().__init__(servo)
        self._target = servo.entry(0x60FF)
        self._velocity_offset, self._torque_offset = servo.entry(0x60B1), servo.entry(0x60B2)

    def start(self) -> None:
        """Let the velocity loop take over what the torque offset leaves to it."""
        self.servo.take_over(self._torque_offset.value)

    def demand(self, read: Read) -> Demand:
        """Return the sum of target and offset; it is not ramped."""
        return Demand(self.servo.counts_s(read(self._target) + read(self._velocity_offset)), read(self._torque_offset))

    def status(self, *, in_charge: bool) -> int:
        """Return bit 12: the drive follows its target."""
        return FOLLOWS_COMMAND if in_charge else 0


class CyclicPosition(Following):
    """Target position plus position offset through the position loop, the velocity and torque offsets behind it.

    A demand that the software limits cut stands still, so its velocity offset is left out.
    """

    number = 8
    supported_bit = 7
    needs = (0x607A,)
    observes = True

    def __init__(self, servo: Servo) -> None:
        super().__init__(servo)
        self._target, self._position_offset = servo.entry(0x607A), servo.entry(0x60B0)
        self._velocity_offset, self._torque_offset = servo.entry(0x60B1), servo.entry(0x60B2)
        self._following_error = FollowingError(servo)

    def start(self) -> None:
        """Let the loops take over what the torque offset leaves to them."""
        self._following_error.restart()
        self.servo.take_over(self._torque_offset.value)

    def demand(self, read: Read) -> Demand:
        """Return the sum of target and offset within the software limits, and the speed that leads there."""
        asked = read(self._target) + read(self._position_offset)
        position = self.servo.within_software_limits(asked)
        ahead = self.servo.counts_s(read(self._velocity_offset)) if position == asked else 0.0
        speed = self.servo.position_gain * self.servo.way_to(position) + ahead
        return Demand(speed, read(self._torque_offset), position, limited=position != asked)

    def observe(self, *, in_charge: bool) -> int:
        """Watch the following error."""
        return self._following_error.observe(in_charge=in_charge)

    def status(self, *, in_charge: bool) -> int:
        """Return bit 12, the drive follows its target, and bit 13, following error."""
        return (FOLLOWS_COMMAND if in_charge else 0) | self._following_error.status
