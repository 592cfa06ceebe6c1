"""Table of a recording's channels: their names, their units, and the other units that files may use."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from hil.errors import RecordingError

_DEG = math.pi / 180.0
_STANDARD_GRAVITY = 9.80665

TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": _DEG}
LENGTH = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
POSITION = ANGLE | LENGTH
EFFORT = {"A": 1.0, "mA": 1e-3, "V": 1.0, "mV": 1e-3, "Nm": 1.0, "N": 1.0, "kN": 1e3}
CURRENT = {"A": 1.0, "mA": 1e-3}
ACCELERATION = {"m/s^2": 1.0, "g": _STANDARD_GRAVITY}
ANGULAR_RATE = {"rad/s": 1.0, "deg/s": _DEG}
SPEED = ANGULAR_RATE | {"m/s": 1.0, "mm/s": 1e-3}
TEMPERATURE = {"degC": 1.0}
NUMBER = {"": 1.0}

SI_OF = {"ms": "s", "us": "s", "mrad": "rad", "deg": "rad", "deg/s": "rad/s", "mm/s": "m/s", "mm": "m", "um": "m", "g": "m/s^2"}
SI_OF |= {"mA": "A", "mV": "V", "kN": "N"}
"""Unit of a value after reading, where it differs from the unit in the file."""

NO_UNIT = ("", "-", "1")
"""Units by which files mark a plain number."""


@dataclass(frozen=True)
class Kind:
    """One kind of channel: its names and its units."""

    pattern: str  # a full match of the channel's name
    units: Mapping[str, float]  # unit -> factor to the unit in memory
    whole: bool = False  # counters and bit fields: whole numbers stay whole in files


KINDS = (
    Kind("time", TIME),
    Kind("reference_.+", POSITION),
    Kind("excitation_.+", EFFORT | POSITION | SPEED),
    Kind("feedforward_.+", EFFORT),
    Kind("damping_(?!share$).+", EFFORT),
    Kind("command_.+", EFFORT | POSITION | SPEED),
    Kind("velocity_offset_.+", SPEED),
    Kind("current_.+", CURRENT),
    Kind("effort_.+", EFFORT),
    Kind("position_.+", POSITION),
    Kind("link_position_.+", POSITION),
    Kind("speed_.+", SPEED),
    Kind(r"imu_(\w+_)?[xyz]", ACCELERATION),
    Kind(r"gyro_(\w+_)?[xyz]", ANGULAR_RATE),
    Kind(r"imu_(\w+_)?time", TIME),
    Kind(r"imu_(\w+_)?counter", NUMBER, whole=True),
    Kind("temperature_.+", TEMPERATURE),
    Kind("statusword_.+", NUMBER, whole=True),
    Kind("data_age_.+", TIME),
    Kind("sync_lateness", TIME),
    Kind("work_time|answer_time", TIME),
    Kind("sensor_marks", NUMBER, whole=True),
    Kind("exposure_id", NUMBER, whole=True),
    Kind("can_id|can_length|can_extended|can_remote|can_fd|byte_[0-9]+", NUMBER, whole=True),
)
_COMPILED = tuple((re.compile(kind.pattern), kind) for kind in KINDS)

_NAME = re.compile(r'[^\s,"\[\]](?:[^,"\[\]\x00-\x1f\x7f]*[^\s,"\[\]])?')


def kind_of(name: str) -> Kind | None:
    """Return the kind of a channel's name; None for other names (`estimate_*` among them), whose unit is kept unchanged."""
    return next((kind for pattern, kind in _COMPILED if pattern.fullmatch(name)), None)


def is_whole(name: str) -> bool:
    """Return whether the channel's values are whole numbers."""
    kind = kind_of(name)
    return kind is not None and kind.whole


def check_name(name: str) -> str:
    """Return `name` if every file format can hold it; raise RecordingError otherwise."""
    if not (_NAME.fullmatch(name) and name.isprintable()):
        raise RecordingError(f"channel {name!r}: a channel's name is printable text without comma, quote or square brackets")
    return name


def unit_and_factor(name: str, unit: str) -> tuple[str, float]:
    """Return the unit in memory of a channel given in `unit`, and the factor to it.

    Raises
    ------
    RecordingError
        The channel cannot be measured in that unit.
    """
    unit = "" if unit in NO_UNIT else unit
    kind = kind_of(name)
    if kind is None:
        return unit, 1.0
    if unit not in kind.units:
        wanted = " or ".join(f"[{known}]" for known in kind.units) if kind.units is not NUMBER else "no unit"
        raise RecordingError(f"channel {name}: {f'unknown unit [{unit}]' if unit else 'no unit'}; {wanted} would be right")
    return SI_OF.get(unit, unit), kind.units[unit]


def imu_channels(name: str) -> tuple[str, ...]:
    """Return the six channels of an IMU: imu_x ... gyro_z of `imu`, imu_source_x ... gyro_source_z of `imu_source`."""
    gyro = f"gyro{name.removeprefix('imu')}"
    return tuple(f"{name}_{axis}" for axis in "xyz") + tuple(f"{gyro}_{axis}" for axis in "xyz")
