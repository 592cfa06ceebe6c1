"""Profile velocity mode (IEC 61800-7-201): the drive ramps its speed to a target by itself."""

from __future__ import annotations

from virtual_bus.canopen.modes.mode import MODE_BIT_12, TARGET_REACHED, Following, Read, present
from virtual_bus.canopen.modes.profile import Limits, ramped
from virtual_bus.canopen.motion import Dwell
from virtual_bus.canopen.servo import NO_LIMIT, Demand, Servo


class ProfileVelocity(Following):
    """Target velocity within 607Fh, approached with 6083h and 6084h."""

    number = 3
    supported_bit = 2
    needs = (0x6083, 0x60FF)
    observes = True

    def __init__(self, servo: Servo) -> None:
        super().__init__(servo)
        entry = servo.entry
        self._target, self._fastest = entry(0x60FF), entry(0x607F, NO_LIMIT)
        self._acceleration, self._deceleration = entry(0x6083), entry(0x6084 if servo.objects.get(0x6084) else 0x6083)
        slow = round(servo.standstill_counts_s * servo.units.velocity)
        self._window, self._window_ms, self._threshold, self._threshold_ms = (
            entry(0x606D, slow),
            entry(0x606E),
            entry(0x606F, slow),
            entry(0x6070),
        )
        self._speed = 0.0  # of the ramp
        self._reached, self._moving = Dwell(servo.period_s), Dwell(servo.period_s)
        self._status = 0

    def start(self) -> None:
        """Ramp from the present speed on."""
        self.servo.take_over()
        self._speed = self.servo.speed_counts_s
        self._reached.restart()

    def demand(self, read: Read) -> Demand:
        """Return the ramp's next speed."""
        servo, asked, fastest = self.servo, read(self._target), read(self._fastest)
        target = min(max(asked, -fastest), fastest)
        limits = Limits(servo.counts_s(fastest), servo.counts_s2(read(self._acceleration)), servo.counts_s2(read(self._deceleration)))
        return Demand(ramped(self._speed, servo.counts_s(target), limits, servo.period_s), limited=target != asked)

    def torque(self) -> int:
        """Return the torque that follows the ramp."""
        demand = self.demand(present)
        self._speed = demand.speed
        return self.servo.follow(demand)

    def observe(self, *, in_charge: bool) -> int:
        """Compare the speed with its target and with standstill."""
        speed = self.servo.speed_counts_s * self.servo.units.velocity
        near = abs(self._target.value - speed) <= self._window.value
        reached = self._reached.held(near, self._window_ms.value * 1e-3)
        moving = self._moving.held(abs(speed) > self._threshold.value, self._threshold_ms.value * 1e-3)
        self._status = (TARGET_REACHED if reached else 0) | (0 if moving else MODE_BIT_12)
        return 0

    def status(self, *, in_charge: bool) -> int:
        """Return bit 10, target reached, and bit 12, speed zero."""
        return self._status if in_charge else self._status & MODE_BIT_12
