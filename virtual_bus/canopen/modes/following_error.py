"""Following error of the modes with a position loop: 60F4h, and a fault where it stays beyond its window (6065h) for a time (6066h)."""

from __future__ import annotations

from virtual_bus.canopen.modes.mode import MODE_BIT_13
from virtual_bus.canopen.motion import Dwell
from virtual_bus.canopen.servo import NO_LIMIT, Servo

FOLLOWING_ERROR = 0x8611  # EMCY code


class FollowingError:
    """Watches how far the position demand and the position actual value are apart."""

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self._window, self._timeout_ms = servo.entry(0x6065, NO_LIMIT), servo.entry(0x6066)
        self._error_code = servo.entry(0x603F)
        self._beyond = Dwell(servo.period_s)

    def restart(self) -> None:
        """Begin anew."""
        self._beyond.restart()

    @property
    def status(self) -> int:
        """Bit 13 of the statusword, from the fault until it is reset."""
        return MODE_BIT_13 if self._error_code.value == FOLLOWING_ERROR else 0

    def observe(self, *, in_charge: bool) -> int:
        """Show the error of this sample and return the code of the fault once it has been too large for too long."""
        if not in_charge:
            self.restart()
            return 0
        servo = self._servo
        error = servo.way_to(servo.position_demand.value)
        servo.following_error.value = int(error)
        beyond = abs(error) > self._window.value  # never where the window is FFFF FFFFh: switched off
        return FOLLOWING_ERROR if self._beyond.held(beyond, self._timeout_ms.value * 1e-3) else 0
