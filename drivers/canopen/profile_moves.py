"""Motion by a drive's own profile (IEC 61800-7-201, profile position mode): it goes to a set-point by itself, watched tick by tick."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.canopen import cia402, power_and_brakes
from drivers.canopen.configuration import MAX_PROFILE_VELOCITY
from drivers.canopen.own_limits import FOLLOWING_ERROR_WINDOW
from drivers.canopen.power_and_brakes import SETTLED_TICKS, Hold, Machine
from drivers.canopen.units import in_data_sheet, units_of
from drivers.errors import BusTimeoutError, MotionRefusedError

NEW_SET_POINT, CHANGE_AT_ONCE = 1 << 4, 1 << 5  # of the controlword
TARGET_REACHED, SET_POINT_ACKNOWLEDGED, FOLLOWING_ERROR = 1 << 10, 1 << 12, 1 << 13  # of the statusword
PROFILE_VELOCITY, PROFILE_ACCELERATION, PROFILE_DECELERATION = 0x6081, 0x6083, 0x6084
ACKNOWLEDGED_S = 0.5  # a drive takes a set-point within ticks
STANDS_S, STANDING_COUNTS = 0.25, 4.0  # without more motion than this for so long, it stands
SETTLES_S = 5.0  # beyond the profile's own time, until the drive says that its target is reached


@dataclass(frozen=True)
class Profile:
    """How a drive moves by itself, at the joint."""

    speed: float  # rad/s or m/s
    acceleration: float  # rad/s^2 or m/s^2
    following_error: float  # rad or m, at which the drive stops


def write_profile(machine: Machine, axis: int, profile: Profile) -> None:
    """Write speed, ramps and following error to the objects that the drive has, in its units."""
    sdo, per_count = machine.sdo(axis), machine.scalings[axis].position_resolution
    units = units_of(in_data_sheet(sdo.dictionary), machine.scalings[axis], sdo.who)
    speed = max(1, round(profile.speed / per_count * units.velocity))
    ramp = max(1, round(profile.acceleration / per_count * units.acceleration))
    values = (
        (MAX_PROFILE_VELOCITY, speed),
        (PROFILE_VELOCITY, speed),
        (PROFILE_ACCELERATION, ramp),
        (PROFILE_DECELERATION, ramp),
        (FOLLOWING_ERROR_WINDOW, max(1, round(profile.following_error / per_count))),
    )
    for index, value in values:
        if sdo.may_write(index):
            most = sdo.greatest(index)
            sdo.write_checked(index, 0, value if most is None else min(value, most))
            if most is not None and value > most:
                machine.notes += (f"{sdo.who}: {index:04X}h takes at most {most}, {value} was asked for: it moves or watches accordingly",)
    machine.resume_ticks()


def go_to(machine: Machine, axes: Sequence[int], targets: Sequence[float], profiles: Sequence[Profile], hold: Hold) -> None:
    """Let enabled drives in profile position mode, brakes open, go to their targets [rad or m] together, and wait until they say so.

    Raises
    ------
    BusTimeoutError
        A drive does not take its set-point, or does not report that it is there.
    MotionRefusedError
        A drive reports a following error; an axis leaves its bounds, or the permission to move was withdrawn.
    DeviceFaultError
    """
    longest_s = 0.0
    for axis, target, profile in zip(axes, targets, profiles, strict=True):
        way = abs(target - float(machine.sample.position[axis]))
        longest_s = max(longest_s, way / profile.speed + profile.speed / profile.acceleration + math.sqrt(way / profile.acceleration))
        machine.lead_to(axis, target)
        machine.set_controlword(axis, cia402.ENABLE_OPERATION)
    _tick_until(machine, axes, hold, 0, SET_POINT_ACKNOWLEDGED, ACKNOWLEDGED_S, "is not ready for a set-point")
    for axis in axes:
        machine.set_controlword(axis, cia402.ENABLE_OPERATION | NEW_SET_POINT | CHANGE_AT_ONCE)
    _tick_until(machine, axes, hold, SET_POINT_ACKNOWLEDGED, SET_POINT_ACKNOWLEDGED, ACKNOWLEDGED_S, "does not take its set-point")
    for axis in axes:
        machine.set_controlword(axis, cia402.ENABLE_OPERATION)
    _tick_until(machine, axes, hold, TARGET_REACHED, TARGET_REACHED, longest_s + SETTLES_S, "has not reached its target")
    _await_standstill(machine, axes, hold)


def _await_standstill(machine: Machine, axes: Sequence[int], hold: Hold) -> None:
    """Tick until no motor side has moved by more than a flicker for a while; a drive may report its target while it still settles."""
    deadline = machine.clock.now() + SETTLES_S
    while machine.clock.now() <= deadline:
        before = machine.sample.position.copy()
        power_and_brakes.run_for(machine, STANDS_S, hold)
        moved = np.abs(machine.sample.position - before)
        waiting = [axis for axis in axes if not moved[axis] <= STANDING_COUNTS * machine.scalings[axis].position_resolution]
        if not waiting:
            return
    names = ", ".join(machine.axes[axis] for axis in waiting)
    machine.notes += (f"{names}: not seen to stand within {SETTLES_S:g} s of reaching its target",)


def _tick_until(machine: Machine, axes: Sequence[int], hold: Hold, value: int, mask: int, patience_s: float, words: str) -> None:
    """Tick until these bits of every statusword have this value."""
    deadline = machine.clock.now() + patience_s
    for _ in range(SETTLED_TICKS):
        power_and_brakes.tick(machine, hold(machine.sample))
    while True:
        waiting = [axis for axis in axes if machine.inputs[axis].statusword & mask != value]
        for axis in waiting:
            if machine.inputs[axis].statusword & FOLLOWING_ERROR:
                raise MotionRefusedError(f"{machine.axes[axis]}: its drive reports a following error on the way to its target")
        if not waiting:
            return
        if machine.clock.now() > deadline:
            names = ", ".join(machine.axes[axis] for axis in waiting)
            raise BusTimeoutError(f"{names}: its drive {words} within {patience_s:.1f} s")
        power_and_brakes.tick(machine, hold(machine.sample))
