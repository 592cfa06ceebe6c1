"""Homing mode (IEC 61800-7-201): the drive finds its home by itself. The runs are in `virtual_bus.canopen.homing`."""

from __future__ import annotations

from collections.abc import Callable

from virtual_bus.canopen.homing import Homing, HomingState
from virtual_bus.canopen.modes.mode import MODE_BIT_12, MODE_BIT_13, TARGET_REACHED, Mode
from virtual_bus.canopen.servo import Servo

HOMING_START = 1 << 4  # of the controlword
HOMING_ATTAINED, HOMING_ERROR = MODE_BIT_12, MODE_BIT_13


class HomingMode(Mode):
    """Homing runs and, before and after them, standing still.

    Parameters
    ----------
    servo : Servo
    homing : callable
        Returns the drive's present homing runs.
    """

    number = 6
    supported_bit = 5
    needs = (0x6098, 0x6099, 0x609A)

    def __init__(self, servo: Servo, homing: Callable[[], Homing]) -> None:
        super().__init__(servo)
        self._homing = homing

    def start(self) -> None:
        """Let the velocity loop take over."""
        self.servo.take_over()

    def obey(self, word: int, previous: int, *, halted: bool) -> None:
        """Start a run at the rising edge of bit 4, and end it when the bit is taken back."""
        homing, servo = self._homing(), self.servo
        if not word & HOMING_START:
            homing.interrupt()
        elif not previous & HOMING_START and not halted:
            homing.start(servo.objects.number(0x6098), servo.absolute)
            servo.take_over()
            self._take_home()

    def torque(self) -> int:
        """Return the torque that moves as the run wants it."""
        homing, servo, speed = self._homing(), self.servo, 0.0
        if homing.running:
            search, zero = servo.counts_s(servo.objects.number(0x6099, 1)), servo.counts_s(servo.objects.number(0x6099, 2))
            speed = homing.update(servo.absolute, search, zero, servo.loop.standing)
            self._take_home()
        return servo.move(speed, servo.objects.number(0x609A) / servo.units.acceleration)

    def _take_home(self) -> None:
        homing, servo = self._homing(), self.servo
        if homing.state is HomingState.ATTAINED and servo.offset != servo.objects.number(0x607C) - homing.home_counts:
            servo.take_home(homing.home_counts)

    def halt(self) -> None:
        """End the run."""
        self._homing().interrupt()

    def leave(self) -> None:
        """End the run."""
        self._homing().interrupt()

    def status(self, *, in_charge: bool) -> int:
        """Return bits 10, 12 and 13 of the homing mode (IEC 61800-7-201, table 105)."""
        homing = self._homing()
        if homing.state is HomingState.ATTAINED:
            return HOMING_ATTAINED | TARGET_REACHED
        if homing.state is HomingState.FAILED:
            return HOMING_ERROR | TARGET_REACHED
        return 0 if homing.running else TARGET_REACHED
