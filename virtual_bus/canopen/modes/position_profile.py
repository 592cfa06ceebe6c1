"""Profile position mode (IEC 61800-7-201): the drive goes to set-points by itself, one of which waits while another is under way."""

from __future__ import annotations

from typing import NamedTuple

from virtual_bus.canopen.modes.following_error import FollowingError
from virtual_bus.canopen.modes.mode import MODE_BIT_12, TARGET_REACHED, Following, Read
from virtual_bus.canopen.modes.profile import Limits, Profile, to_rest, to_target
from virtual_bus.canopen.motion import Dwell
from virtual_bus.canopen.servo import NO_LIMIT, Demand, Servo

NEW_SET_POINT, CHANGE_AT_ONCE, RELATIVE = 1 << 4, 1 << 5, 1 << 6  # of the controlword
SET_POINT_ACKNOWLEDGED = MODE_BIT_12


class SetPoint(NamedTuple):
    """Where to go, and how fast."""

    target: int
    limits: Limits
    limited: bool  # the software limits have cut the target


class ProfilePosition(Following):
    """Trapezoidal profiles, whose position and speed the position loop follows."""

    number = 1
    supported_bit = 0
    needs = (0x607A, 0x6081, 0x6083)
    observes = True

    def __init__(self, servo: Servo) -> None:
        super().__init__(servo)
        entry = servo.entry
        self._target, self._velocity, self._fastest = entry(0x607A), entry(0x6081), entry(0x607F, NO_LIMIT)
        self._acceleration, self._deceleration = entry(0x6083), servo.objects.get(0x6084) or entry(0x6083)
        self._window, self._window_ms = entry(0x6067, NO_LIMIT), entry(0x6068)
        self._following_error = FollowingError(servo)
        self._reached = Dwell(servo.period_s)
        self._profile = Profile(0.0, 0.0, [])
        self._samples = 0  # since the profile began
        self._last: SetPoint | None = None  # the set-point under way, or gone to
        self._next: SetPoint | None = None
        self._word = 0
        self._asked = self._acknowledged = False
        self._status = 0

    # ---- the handshake --------------------------------------------------------------------------------
    def obey(self, word: int, previous: int, *, halted: bool) -> None:
        """Note a rising edge of bit 4; the set-point is read when all that came with this SYNC is in the objects."""
        self._word = word
        if word & ~previous & NEW_SET_POINT:
            self._asked = True

    def _take_set_point(self) -> None:
        at_once = bool(self._word & CHANGE_AT_ONCE)
        if self._asked and (at_once or self._next is None):
            set_point = self._asked_for()
            self._acknowledged = True
            if at_once or self._last is None or self._done:
                self._go_to(set_point)
            else:
                self._next = set_point
        self._asked = False
        if self._next is not None and self._done:
            self._go_to(self._next)
        if not self._word & NEW_SET_POINT and self._next is None:
            self._acknowledged = False

    def _asked_for(self) -> SetPoint:
        asked = self._target.value
        if self._word & RELATIVE:
            asked += round(self._profile.end)
        target = self.servo.within_software_limits(asked)
        servo, speed = self.servo, max(1, min(self._velocity.value, self._fastest.value))
        limits = Limits(servo.counts_s(speed), servo.counts_s2(self._acceleration.value), servo.counts_s2(self._deceleration.value))
        return SetPoint(target, limits, target != asked)

    def _go_to(self, set_point: SetPoint) -> None:
        """Leave the present profile, where it is now, for a set-point."""
        position, speed = self._profile.at(self._samples * self.servo.period_s)
        self._begin(to_target(position, speed, set_point.target, set_point.limits))
        self._last, self._next = set_point, None

    def _begin(self, profile: Profile) -> None:
        self._profile, self._samples = profile, 0
        self._reached.restart()

    @property
    def _done(self) -> bool:
        return self._samples * self.servo.period_s >= self._profile.duration_s

    # ---- one sample -----------------------------------------------------------------------------------
    def start(self) -> None:
        """Slow down from the present position and speed, or go on to the set-point that a halt has left."""
        servo = self.servo
        servo.take_over()
        self._following_error.restart()
        position, speed = float(servo.position.value), servo.speed_counts_s
        if self._last is not None:
            self._begin(to_target(position, speed, self._last.target, self._last.limits))
        else:
            self._begin(to_rest(position, speed, servo.counts_s2(self._deceleration.value)))

    def demand(self, read: Read) -> Demand:
        """Return the profile's position, and the speed that keeps to it."""
        position, ahead = self._profile.at((self._samples + 1) * self.servo.period_s)
        limited = self._last is not None and self._last.limited
        return Demand(self.servo.position_gain * self.servo.way_to(position) + ahead, position=position, limited=limited)

    def torque(self) -> int:
        """Return the torque that follows the profile."""
        torque = super().torque()
        self._samples += 1
        return torque

    def observe(self, *, in_charge: bool) -> int:
        """Take a set-point that has come, and judge the target and the following error."""
        self._take_set_point()
        reached = self._reached.held(self._done and self._within_window(), self._window_ms.value * 1e-3)
        self._status = TARGET_REACHED if reached and in_charge else 0
        return self._following_error.observe(in_charge=in_charge)

    def _within_window(self) -> bool:
        return abs(self.servo.way_to(self._profile.end)) <= self._window.value

    def leave(self) -> None:
        """Forget all set-points."""
        self._last = self._next = None
        self._asked = self._acknowledged = False
        self._status = 0

    def status(self, *, in_charge: bool) -> int:
        """Return bits 10, target reached, 12, set-point acknowledged, and 13, following error."""
        acknowledged = SET_POINT_ACKNOWLEDGED if self._acknowledged else 0
        return (self._status if in_charge else 0) | acknowledged | self._following_error.status
