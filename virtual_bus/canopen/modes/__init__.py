"""Modes of operation of the emulated CiA 402 drive: one class each, all with the face of `mode.Mode`."""

from __future__ import annotations

from collections.abc import Callable

from virtual_bus.canopen.homing import Homing
from virtual_bus.canopen.modes.cyclic import CyclicPosition, CyclicTorque, CyclicVelocity
from virtual_bus.canopen.modes.homing import HomingMode
from virtual_bus.canopen.modes.mode import Mode
from virtual_bus.canopen.modes.position_profile import ProfilePosition
from virtual_bus.canopen.modes.velocity_profile import ProfileVelocity
from virtual_bus.canopen.objects import Objects
from virtual_bus.canopen.servo import Servo


def modes_of(servo: Servo, homing: Callable[[], Homing]) -> dict[int, Mode]:
    """Return the modes, by their values of 6060h; `homing` returns the device's present homing runs.

    They are those that its data sheet supports (6502h, where it says any) and has all objects for.
    """
    supported = servo.objects.number(0x6502)
    kinds = (Mode, ProfilePosition, ProfileVelocity, CyclicPosition, CyclicVelocity, CyclicTorque)
    modes = [*(kind(servo) for kind in kinds), HomingMode(servo, homing)]
    return {mode.number: mode for mode in modes if _is_there(mode, servo.objects, supported)}


def _is_there(mode: Mode, objects: Objects, supported: int) -> bool:
    declared = not supported or mode.supported_bit < 0 or bool(supported >> mode.supported_bit & 1)
    return declared and all(index in objects for index in mode.needs)
