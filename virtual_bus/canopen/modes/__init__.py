"""Modes of operation of the emulated CiA 402 drive: one class each, all with the face of `mode.Mode`."""

from __future__ import annotations

from collections.abc import Callable

from virtual_bus.canopen.homing import Homing
from virtual_bus.canopen.modes.cyclic import CyclicPosition, CyclicTorque, CyclicVelocity
from virtual_bus.canopen.modes.homing import HomingMode
from virtual_bus.canopen.modes.mode import Mode
from virtual_bus.canopen.modes.position_profile import ProfilePosition
from virtual_bus.canopen.modes.velocity_profile import ProfileVelocity
from virtual_bus.canopen.servo import Servo


def modes_of(servo: Servo, homing: Callable[[], Homing]) -> dict[int, Mode]:
    """Return the modes, by their values of 6060h, that a device has all objects for; `homing` returns its present homing runs."""
    kinds = (Mode, ProfilePosition, ProfileVelocity, CyclicPosition, CyclicVelocity, CyclicTorque)
    modes = [*(kind(servo) for kind in kinds), HomingMode(servo, homing)]
    return {mode.number: mode for mode in modes if all(index in servo.objects for index in mode.needs)}
