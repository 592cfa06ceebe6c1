"""What the supervisor keeps in mind, as entries of fixed size: rings of the last values, counts of them, and what was found first.

A type here describes an entry once. It is made as an object, which Python reads and writes fast, or as an entry of a structured array,
which compiled code does (`hil.bench.compiled_supervising`); the laws (`laws.py`) are the same text for both.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from math import inf, nan
from typing import NamedTuple

import numpy as np

from drivers.canopen.units import velocity_units
from drivers.settings import AxisScaling, BusSettings, MotionLimits
from drivers.supervisor.laws import (
    ASKED_TORQUE,
    ASKED_VELOCITY,
    ASKED_WAY,
    EFFORT,
    FAST_SYNCS,
    LINK_POSITION,
    MODE,
    POSITION,
    SILENT_AT_LEAST_S,
    SPEED_MARGIN,
    SPEED_STEPS,
    STATUS,
    SYNC,
    SYNC_SILENT_PERIODS,
    TORQUE_MODE,
    Entry,
)

ENCODER = np.dtype(
    [
        ("is_there", "?"),
        ("resolution", "f8"),  # rad or m per count
        ("fastest", "f8"),  # rad/s or m/s that it may show
        ("furthest", "f8"),  # rad or m of a step that is one
        # what was seen
        ("was_read", "?"),
        ("counts", "i8"),  # last reading
        ("seen_at_s", "f8"),
        ("moved", "f8"),  # rad or m since torque was switched on
        ("jumped", "?"),  # with the last reading
        ("readings", "i8"),  # how many steps the rings hold
        ("newest", "i8"),  # place of the newest of them
        ("steps", "f8", SPEED_STEPS),  # rad or m
        ("speeds", "f8", SPEED_STEPS),  # rad/s or m/s: each step by the time that it took
        ("too_fast", "i8", SPEED_STEPS),  # 1: faster than it may be
        ("too_fast_steps", "i8"),  # how many of them
        # since it is to hold
        ("held_at_s", "f8"),
        ("held_from", "f8"),  # rad or m
        ("held_speed", "f8"),
        ("held_way", "f8"),  # the furthest place on its way to rest
        ("led_from", "f8"),  # how far it had moved when the axis was to be led no more
    ],
    align=True,
)
"""The motion of one encoder: its last steps, and how far it went since torque was switched on."""

AXIS = np.dtype(
    [
        ("number", "i8"),
        ("period_s", "f8"),
        ("sign", "f8"),
        ("lower", "f8"),  # rad or m
        ("upper", "f8"),
        ("speed", "f8"),  # rad/s or m/s
        ("tracking_error", "f8"),  # rad or m
        ("deceleration", "f8"),
        ("ramp_s", "f8"),  # of the speed limit
        ("holding_permille", "f8"),
        ("torque_permille", "i8"),
        ("fastest_counts_s", "f8"),
        ("counts_per_unit", "f8"),  # counts/s in a unit of the drive's velocities
        ("goes_by_profile", "?"),  # of position
        ("link_zero_counts", "i8"),
        # what was seen
        ("motor", ENCODER),
        ("link", ENCODER),
        ("link_at", "f8"),  # rad or m
        ("statusword", "i8"),  # -1 before one has come
        ("is_powered", "?"),
        ("is_enabled", "?"),
        ("holds", "?"),
        ("brake_open", "?"),
        ("mode", "i8"),
        ("torques", "i8", SPEED_STEPS),  # asked for, per mille
        ("newest_torque", "i8"),
        ("off", "i8", SPEED_STEPS),  # measured beyond what was asked for, per mille; 0: none
        ("newest_off", "i8"),
        ("off_steps", "i8"),  # how many are
        ("pushed", "f8"),  # per mille: mean effort of a hold
        ("since_s", "f8"),  # when that hold began
        ("unanswered", "i8"),  # SYNCs since the last position
        ("was_asked", "?"),  # for a position
        ("target", "i8"),  # counts, asked for last
        ("is_led_from", "?"),  # whether the encoders know where the axis was to be led no more
        # what follows
        ("is_to_stop", "?"),
        ("is_to_reset", "?"),
    ],
    align=True,
)
"""Limits of an axis, and what is known of it."""

FIELD = np.dtype(
    [
        ("can_id", "i8"),  # of the frame, in its first field; -1 in others
        ("kind", "i8"),  # what it says, by `drivers.supervisor.laws`
        ("axis", "i8"),
        ("shift", "i8"),
        ("length", "i8"),  # bytes that a frame must have
        ("mask", "i8"),
        ("half", "i8"),  # of the range of its values
        ("sign", "i8"),  # the bit that says minus; 0: none does
        ("is_last", "?"),  # of its frame
    ],
    align=True,
)
"""Where a value lies in the data of a frame; the fields of a frame follow each other."""

MOST_NOTED = 64
"""Frames that are noted before they are judged, where they are; those of nine ticks of two axes."""

NOTED = np.dtype(
    {"names": ["can_id", "length", "word", "time_s"], "formats": ["<i4", "u1", "<i8", "<f8"], "offsets": [0, 7, 8, 16], "itemsize": 24}
)
"""A frame that came, as `struct` packs it: its identifier, its bytes with their number before them, and its time."""
NOTED_FORMAT = "i3x9pd"

MACHINE = np.dtype(
    [
        ("period_s", "f8"),
        ("silent_s", "f8"),  # without a SYNC that are too many
        ("sync_s", "f8", FAST_SYNCS + 1),
        ("newest_sync", "i8"),
        ("syncs", "i8"),  # how many the ring holds
        ("ended_at_s", "f8"),  # the permission
        ("commanded_at_s", "f8"),
        ("commands", "?"),  # whether something is to be commanded now
        # what was found first
        ("law", "i8"),
        ("axis", "i8"),
        ("much", "f8"),
        ("most", "f8"),
        ("noted", NOTED, MOST_NOTED),
    ],
    align=True,
)
"""What is known of the whole machine."""

_STATUSWORD, _POSITION, _LINK_POSITION, _CURRENT, _TORQUE = 0x6041, 0x6064, 0x6004, 0x6078, 0x6077
_ASKED = {0x6071: ASKED_TORQUE, 0x60B2: ASKED_TORQUE, 0x60FF: ASKED_VELOCITY, 0x607A: ASKED_WAY}
_SIGNED = (_POSITION, _CURRENT, _TORQUE, *_ASKED)


class Memory(NamedTuple):
    """All that a session begins with."""

    machine: Entry
    axes: list[Entry]
    fields: list[Entry]
    places: dict[int, int]  # of the first field of each frame that says something, by its identifier


def entry(of: np.dtype) -> Entry:
    """Return an entry as an object, with zeros."""
    found = _objects(of)()
    for name in of.names or ():
        setattr(found, name, _zero(of[name]))
    return found


@functools.cache
def _objects(of: np.dtype) -> type:
    """Return the class of entries as objects, whose slots Python reaches without a dictionary."""
    return type("Entry", (), {"__slots__": of.names})


def _zero(of: np.dtype) -> object:
    if of.names is not None:
        return entry(of)
    return np.zeros((), of).tolist()


def memory_of(settings: BusSettings) -> Memory:
    """Return the memory of a machine of which nothing is known yet."""
    machine = entry(MACHINE)
    machine.period_s = settings.sync_period_s
    machine.silent_s = max(SYNC_SILENT_PERIODS * settings.master_heartbeat_period_s, SILENT_AT_LEAST_S)
    machine.ended_at_s, machine.commanded_at_s = inf, -inf
    machine.newest_sync = -1
    units = [velocity_units(scaling, settings) for scaling in settings.scalings]
    axes = [axis_of(*each, settings.sync_period_s) for each in zip(settings.scalings, settings.motions, units, strict=True)]
    for number, axis in enumerate(axes):
        axis.number = number
    frames = frames_of(settings)
    fields = [field for each in frames.values() for field in each]
    places, place = {}, 0
    for can_id, each in frames.items():
        if each:
            places[can_id], each[0].can_id = place, can_id
            each[-1].is_last = True
        place += len(each)
    return Memory(machine, axes, fields, places)


def axis_of(scaling: AxisScaling, limits: MotionLimits, units_per_count: float, period_s: float) -> Entry:
    """Return an axis of which nothing is known yet."""
    axis = entry(AXIS)
    axis.period_s, axis.sign = period_s, scaling.sign
    axis.lower, axis.upper, axis.speed, axis.tracking_error = limits.lower, limits.upper, limits.speed, limits.tracking_error
    axis.deceleration = min(limits.acceleration, limits.quick_stop or limits.acceleration)
    axis.ramp_s = limits.speed / axis.deceleration
    axis.holding_permille = limits.holding_effort / scaling.rated * 1000.0
    axis.torque_permille = min(32767, round(scaling.limit / scaling.rated * 1000.0))
    axis.motor = encoder_of(scaling.position_resolution, limits)
    axis.link = encoder_of(scaling.link_resolution, limits)
    axis.fastest_counts_s, axis.counts_per_unit = axis.motor.fastest / scaling.position_resolution, 1.0 / units_per_count
    axis.goes_by_profile = scaling.mode == "profile_position"
    axis.link_zero_counts, axis.link_at = scaling.link_zero_counts, nan
    axis.mode = TORQUE_MODE if scaling.mode == "torque" else 0
    axis.statusword = axis.newest_torque = axis.newest_off = -1
    axis.since_s = inf
    return axis


def encoder_of(resolution: float, limits: MotionLimits) -> Entry:
    """Return an encoder of which nothing is known yet; without a resolution there is none."""
    encoder = entry(ENCODER)
    encoder.is_there, encoder.resolution = resolution != 0.0, resolution
    encoder.fastest, encoder.furthest = SPEED_MARGIN * limits.speed, limits.tracking_error
    encoder.newest = -1
    encoder.held_at_s = -inf
    return encoder


def frames_of(settings: BusSettings) -> dict[int, list[Entry]]:
    """Return what each frame says, by its identifier: SYNC and what the drives are asked first."""
    axis_numbers = {scaling.axis: number for number, scaling in enumerate(settings.scalings)}
    asked, said = {}, {}
    for node in settings.nodes:
        axis = axis_numbers[node.axis]
        for pdo in node.rpdos:
            places = places_of(pdo.entries)
            asked[pdo.cob_id] = [field(kind, axis, *places[index]) for index, kind in _ASKED.items() if index in places]
        for pdo in node.tpdos:
            places = places_of(pdo.entries)
            says = {_STATUSWORD: STATUS, _CURRENT if _CURRENT in places else _TORQUE: EFFORT, _POSITION: POSITION}
            if settings.scalings[axis].link_resolution:
                says[_LINK_POSITION] = LINK_POSITION
            said[pdo.cob_id] = [field(kind, axis, *places[index]) for index, kind in says.items() if index in places]
    for node in settings.nodes:
        if node.role == "drive":
            request = 0x600 + node.node_id
            said[request] = [field(MODE, axis_numbers[node.axis], 32, 8, False), *said.get(request, [])]
    return {settings.sync_cob_id: [field(SYNC, 0, 0, 0, False)]} | {
        can_id: fields
        for can_id, fields in (asked | {other: said[other] for other in said if other not in asked}).items()
        if can_id != settings.sync_cob_id
    }


def places_of(entries: Iterable[tuple[int, int, int]]) -> dict[int, tuple[int, int, bool]]:
    """Return where the objects lie that a PDO maps, by their index: from which bit, how many, and whether they have a sign."""
    found: dict[int, tuple[int, int, bool]] = {}
    shift = 0
    for index, _, bits in entries:
        found.setdefault(index, (shift, bits, index in _SIGNED))
        shift += bits
    return found


def field(kind: int, axis: int, shift: int, bits: int, signed: bool) -> Entry:
    """Return a field of a frame."""
    found = entry(FIELD)
    found.can_id, found.kind, found.axis, found.shift, found.length = -1, kind, axis, shift, (shift + bits + 7) // 8
    found.mask, found.half = (1 << bits) - 1, 1 << bits >> 1
    found.sign = found.half if signed else 0
    return found
