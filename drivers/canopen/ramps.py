"""Speeds and ramps by which a drive moves and stops by itself, written at the start of each session where the drive has the objects.

They are in the drive's own units (`drivers.canopen.units`). What a node's `write` in the machine file names is the file's own. Values that
an earlier master has stored do not count: the budgets of `machine check` hold for these.
"""

from __future__ import annotations

from collections.abc import Collection
from math import isfinite

from drivers.canopen.sdo import SdoNode
from drivers.canopen.units import MotionUnits, acceleration_units, check_units, in_data_sheet, units_of, whole_speed
from drivers.errors import ConfigurationRefusedError
from drivers.settings import LED_SPEED_MARGIN, AxisScaling, LoopMode, MotionLimits

MAX_PROFILE_VELOCITY, PROFILE_VELOCITY, PROFILE_ACCELERATION, PROFILE_DECELERATION, QUICK_STOP = 0x607F, 0x6081, 0x6083, 0x6084, 0x6085
FOLLOWING_ERROR_WINDOW, FOLLOWING_ERROR_TIME = 0x6065, 0x6066
RAMP_MARGIN = 10.0
"""Multiple of its limit of acceleration at which a drive in profile velocity mode may ramp: the reference keeps to the limit, and what the
feedback adds must reach the motor unramped, as the margins of `machine check` take it."""


def write_ramps(sdo: SdoNode, scaling: AxisScaling, limits: MotionLimits, writes: Collection[tuple[int, int, int]]) -> tuple[str, ...]:
    """Write how a drive moves and stops by itself.

    Parameters
    ----------
    sdo : SdoNode
    scaling : AxisScaling
    limits : MotionLimits
    writes : collection of (int, int, int)
        Index, subindex and value of what the machine file writes.

    Returns
    -------
    tuple of str
        Where a drive takes less than was asked for, one line each.

    Raises
    ------
    ConfigurationRefusedError
        A unit that is not known, or, of a ramp in torque mode, another one than the drive says.
    """
    own, torque = {(index, subindex) for index, subindex, _ in writes}, scaling.mode == "torque"
    read = in_data_sheet(sdo.dictionary, writes)
    try:
        units = MotionUnits(1.0, acceleration_units(read, scaling, sdo.who)) if torque else units_of(read, scaling, sdo.who)
    except ConfigurationRefusedError as unknown:
        if not torque:
            raise
        return (f"{unknown}; its quick stop ramp stays as it is",) if sdo.may_write(QUICK_STOP) and (QUICK_STOP, 0) not in own else ()
    per_count = scaling.position_resolution
    of = {MAX_PROFILE_VELOCITY: units.velocity, PROFILE_VELOCITY: units.velocity, FOLLOWING_ERROR_WINDOW: 1.0}
    wanted: dict[int, float] = {
        index: value / per_count * of.get(index, units.acceleration)
        for index, value in speeds_and_ramps(scaling.mode, limits).items()
        if isfinite(value)
    }
    if scaling.mode == "profile_position":
        wanted[FOLLOWING_ERROR_TIME] = 0  # ms: at once, as the loop judges the tracking error
    stated = limits.quick_stop
    if stop := read(QUICK_STOP, 0) if stated is None else stated / per_count * units.acceleration:
        wanted[QUICK_STOP] = stop
    notes: list[str] = []
    if stated is not None and (not sdo.may_write(QUICK_STOP) or sdo.read_if_present(QUICK_STOP) is None):
        notes.append(f"{sdo.who}: it has no quick stop ramp (6085h) to write; limits.{scaling.axis} says one that it must have by itself")
    for index, asked in wanted.items():
        if not sdo.may_write(index) or sdo.read_if_present(index) is None:
            continue
        if torque:  # in other modes it was checked before, with the velocities
            check_units(sdo.integer_if_there, units, scaling, sdo.who, velocities=False)
        if (index, 0) in own:
            continue
        if index in (MAX_PROFILE_VELOCITY, PROFILE_VELOCITY):
            value, coarse = whole_speed(asked, f"{sdo.who}: {index:04X}h")
            notes += coarse
        else:
            value = max(1, round(asked)) if asked else 0
        most = sdo.greatest(index)
        sdo.write_checked(index, 0, value if most is None else min(value, most))
        if most is not None and value > most:
            notes.append(f"{sdo.who}: {index:04X}h takes at most {most}, {value} was asked for: it moves or watches accordingly")
    return tuple(notes)


def speeds_and_ramps(mode: LoopMode, limits: MotionLimits) -> dict[int, float]:
    """Return speeds and ramps at the joint [rad or m, and per s], by object."""
    if mode == "profile_velocity":
        ramp = RAMP_MARGIN * limits.acceleration
        return {MAX_PROFILE_VELOCITY: LED_SPEED_MARGIN * limits.speed, PROFILE_ACCELERATION: ramp, PROFILE_DECELERATION: ramp}
    if mode == "profile_position":
        return {
            MAX_PROFILE_VELOCITY: limits.speed,
            PROFILE_VELOCITY: limits.speed,
            PROFILE_ACCELERATION: limits.acceleration,
            PROFILE_DECELERATION: limits.acceleration,
            FOLLOWING_ERROR_WINDOW: limits.tracking_error,
        }
    return {}
