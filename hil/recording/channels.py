"""Table of a recording's channels: their names, their units, and the other units that files may use."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Mapping
from dataclasses import dataclass

from hil.errors import RecordingError

_DEG = math.pi / 180.0
_STANDARD_GRAVITY = 9.80665

_TURN = 2.0 * math.pi

TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": _DEG, "rev": _TURN}
LENGTH = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "inch": 0.0254}
POSITION = ANGLE | LENGTH
CURRENT = {"A": 1.0, "mA": 1e-3, "uA": 1e-6}
VOLTAGE = {"V": 1.0, "mV": 1e-3}
TORQUE = {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2, "kNm": 1e3}
FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
EFFORT = CURRENT | VOLTAGE | TORQUE | FORCE
ACCELERATION = {"m/s^2": 1.0, "g": _STANDARD_GRAVITY, "mg": 1e-3 * _STANDARD_GRAVITY, "mm/s^2": 1e-3}
ANGULAR_RATE = {"rad/s": 1.0, "deg/s": _DEG, "mrad/s": 1e-3, "rev/s": _TURN, "rpm": _TURN / 60.0}
SPEED = ANGULAR_RATE | {"m/s": 1.0, "mm/s": 1e-3, "um/s": 1e-6, "cm/s": 1e-2, "mm/min": 1e-3 / 60.0}
TEMPERATURE = {"degC": 1.0}
NUMBER = {"": 1.0}

SI_OF = {
    unit: si
    for si, units in {
        "s": TIME, "rad": ANGLE, "m": LENGTH, "A": CURRENT, "V": VOLTAGE, "Nm": TORQUE, "N": FORCE, "m/s^2": ACCELERATION,
        "rad/s": ANGULAR_RATE, "m/s": SPEED.keys() - ANGULAR_RATE.keys(),
    }.items()
    for unit in units
    if unit != si
}  # fmt: skip
"""Unit of a value after reading, where it differs from the unit in the file."""

COUNTS, COUNTS_PER_S, PERCENT, PERMILLE = "counts", "counts/s", "%", "permille"
OF_THE_MACHINE = (COUNTS, COUNTS_PER_S, PERCENT, PERMILLE)
"""Units whose size a machine file says: an encoder's counts, parts of what a drive is rated for."""

SPELLED = {
    "s": ("sec", "secs", "second", "seconds"),
    "ms": ("msec", "msecs", "millisecond", "milliseconds"),
    "us": ("usec", "usecs", "microsecond", "microseconds"),
    "ns": ("nsec", "nanosecond", "nanoseconds"),
    "min": ("minute", "minutes"),
    "rad": ("rads", "radian", "radians"),
    "deg": ("degs", "degree", "degrees"),
    "rev": ("revs", "revolution", "revolutions", "turn", "turns", "rot", "rotation", "rotations", "r"),
    "um": ("micron", "microns", "micrometer", "micrometre"),
    "inch": ("in", "inches"),
    "A": ("a", "amp", "amps", "ampere", "amperes"),
    "mA": ("ma", "milliamp", "milliamps"),
    "Nm": ("nm", "n.m", "newtonmeter", "newtonmetre", "newton-meter", "newton-metre"),
    "mNm": ("mnm", "mn.m", "nmm", "n.mm"),
    "Ncm": ("ncm", "n.cm"),
    "m/s^2": ("m/s2", "m/s/s", "m/sec^2", "m/sec2", "ms^-2", "ms-2"),
    "mm/s^2": ("mm/s2", "mm/s/s"),
    "rad/s": ("rads/s", "rad/sec", "radians/s", "radian/s", "rads^-1", "rads-1"),
    "deg/s": ("degs/s", "deg/sec", "degree/s", "degrees/s", "dps"),
    "rev/s": ("revs/s", "rev/sec", "turn/s", "turns/s", "turns/sec", "r/s", "rps"),
    "rpm": ("rev/min", "revs/min", "r/min", "u/min", "1/min", "min^-1", "min-1", "turns/min"),
    "m/s": ("m/sec",),
    "mm/s": ("mm/sec",),
    "degC": ("c", "degc", "celsius", "degcelsius"),
    COUNTS: ("count", "cts", "cnt", "cnts", "inc", "incs", "increment", "increments", "pulses", "qc"),
    COUNTS_PER_S: ("count/s", "counts/sec", "cts/s", "inc/s", "increments/s"),
    PERCENT: ("percent", "pct"),
    PERMILLE: ("‰", "promille", "permil"),
}
"""Units as other tools write them, in lower case, without spaces and signs of multiplication."""

_SIGNS = str.maketrans({"µ": "u", "μ": "u", "°": "deg", "²": "^2", "⁻": "-", "¹": "1", " ": "", "·": "", "*": "", "⋅": ""})
_SPELLINGS = {other: unit for unit, others in SPELLED.items() for other in (unit.lower(), *others)}
_LEAST_LETTERS = 3
"""Of a unit by which a row of units is known: shorter ones may be names."""

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


def spelled(unit: str, known: Container[str]) -> str:
    """Return a unit as it is written here, where another spelling is of one of the known ones."""
    if unit in known:
        return unit
    found = _SPELLINGS.get(unit.strip().translate(_SIGNS).lower(), unit)
    return found if found in known else unit


def is_unit(text: str) -> bool:
    """Return whether a text can only be a unit, as in a row of units below a header."""
    return any(text in kind.units for kind in KINDS if text) or (
        len(text) >= _LEAST_LETTERS and text.translate(_SIGNS).lower() in _SPELLINGS
    )


def unit_and_factor(name: str, unit: str, like: str = "") -> tuple[str, float]:
    """Return the unit in memory of a channel given in `unit`, and the factor to it.

    `like` is the unit in memory that the machine's axis has; "" allows any of the channel.

    Raises
    ------
    RecordingError
        The channel cannot be measured in that unit.
    """
    unit = "" if unit in NO_UNIT else unit
    kind = kind_of(name)
    if kind is None:
        return unit, 1.0
    unit = spelled(unit, kind.units)
    offered = [known for known in kind.units if not like or SI_OF.get(known, known) == like] or list(kind.units)
    if unit not in offered:
        wanted = " or ".join(f"[{known}]" for known in offered) if kind.units is not NUMBER else "no unit"
        found = f"[{unit}] at an axis in {like}" if unit in kind.units else f"unknown unit [{unit}]" if unit else "no unit"
        raise RecordingError(f"channel {name}: {found}; {wanted} would be right")
    return SI_OF.get(unit, unit), kind.units[unit]


def imu_channels(name: str) -> tuple[str, ...]:
    """Return the six channels of an IMU: imu_x ... gyro_z of `imu`, imu_source_x ... gyro_source_z of `imu_source`."""
    gyro = f"gyro{name.removeprefix('imu')}"
    return tuple(f"{name}_{axis}" for axis in "xyz") + tuple(f"{gyro}_{axis}" for axis in "xyz")
