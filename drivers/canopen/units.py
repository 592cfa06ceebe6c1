"""Units of a drive's velocities and accelerations, by its own objects (IEC 61800-7-201, factor group) or by the machine file.

Positions on the wire are counts, whatever they are in the drive: the machine file has their resolution. With p in counts, the standard's

    position = increments F / (R G),    velocity = increments/s F / (V G) K,    acceleration = velocity/s A

have R = 608Fh and V = 6090h increments per turn of the motor, G = 6091h turns of the motor per turn of the shaft, F = 6092h position units
per turn of the shaft, K = 6096h, A = 6097h. So R, V and G drop out: velocity = K dp/dt. A unit of its own (60A9h, 60AAh) says instead what
a velocity is in. A turn is then F counts or, of a drive without F, the machine file's counts per turn of the motor times G.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from drivers.errors import ConfigurationRefusedError
from drivers.settings import AxisScaling, BusSettings, Node

if TYPE_CHECKING:
    import canopen

POSITION_UNIT, VELOCITY_UNIT, ACCELERATION_UNIT = 0x60A8, 0x60A9, 0x60AA
ENCODER_RESOLUTION, GEAR_RATIO, FEED_CONSTANT, VELOCITY_FACTOR, ACCELERATION_FACTOR = 0x608F, 0x6091, 0x6092, 0x6096, 0x6097
OLD_VELOCITY_NOTATION, OLD_VELOCITY_DIMENSION = 0x608B, 0x608C  # of DSP 402 before version 3
OBJECTS = (0x608B, 0x608C, 0x608F, 0x6091, 0x6092, 0x6094, 0x6096, 0x6097, 0x60A8, 0x60A9, 0x60AA)
"""All of them."""
OLD_RPM, OLD_INCREMENTS = 0xA4, 0xAC
OLD_VELOCITY_ENCODER_FACTOR = 0x6094
AGREES = 1e-6
"""Relative difference of factors that are the same: both come from whole numbers."""

COARSE = 0.1
"""Share of its speed that an axis may lose to whole units without a word."""

TURNS = {0xB4: 1.0, 0x10: 0.5 / math.pi, 0x40: 1.0 / 400.0, 0x41: 1.0 / 360.0, 0x42: 1.0 / 21_600.0, 0x43: 1.0 / 1_296_000.0}
"""Turns in a revolution, radian, gon, degree, minute and second of arc, by their codes (CiA 303-2)."""
METRES = {0x01: 1.0, 0xC1: 0.0254, 0xC2: 0.3048}
INCREMENTS, RPM = 0xB5, 0xC0
SECONDS = {0x03: 1.0, 0x47: 60.0, 0x48: 3600.0, 0x57: 1.0}  # s, min, h, and s^2 of accelerations

COUNTS = {"counts/s": 1.0, "0.1 counts/s": 10.0, "counts/s^2": 1.0, "10 counts/s^2": 0.1}
"""How many of the units of counts that a machine file may say are a count per second, or per second squared."""
DECLARED = {"rpm": 1.0 / 60.0, "0.1 rpm": 1e-1 / 60.0, "0.01 rpm": 1e-2 / 60.0, "0.001 rpm": 1e-3 / 60.0, "rev/s": 1.0}
"""Turns per second of the other units that a machine file may say."""
DECLARED_ACCELERATION = {"rpm/s": 1.0 / 60.0, "rev/s^2": 1.0}

Read = Callable[[int, int], int | None]
"""Returns the value of an object, None where there is none."""


class Scaling(Protocol):
    """What the machine file says of an axis: `drivers.settings.AxisScaling`, or the like."""

    @property
    def axis(self) -> str: ...  # noqa: D102
    @property
    def counts_per_motor_turn(self) -> float: ...  # noqa: D102
    @property
    def velocity_unit(self) -> str: ...  # noqa: D102
    @property
    def acceleration_unit(self) -> str: ...  # noqa: D102


@dataclass(frozen=True)
class MotionUnits:
    """How many of a drive's units a count per second is, and a count per second squared."""

    velocity: float = 1.0
    acceleration: float = 1.0


def in_data_sheet(dictionary: canopen.ObjectDictionary, writes: Iterable[tuple[int, int, int]]) -> Read:
    """Return a reading of the values that a drive has by its data sheet and what the machine file writes: (index, subindex, value)."""
    own = {(index, subindex): value for index, subindex, value in writes}

    def read(index: int, subindex: int) -> int | None:
        if (index, subindex) in own:
            return own[index, subindex]
        variable = dictionary.get_variable(index, subindex)
        value = None if variable is None else variable.default if getattr(variable, "value", None) is None else variable.value
        return value if isinstance(value, int) else None

    return read


def units_in_data_sheet(node: Node, scaling: AxisScaling) -> MotionUnits:
    """Return the units of a node by the machine file and its data sheet; errors as in `units_of`, and those of the data sheet."""
    from drivers.canopen.eds import load_object_dictionary  # the supervisor starts without what reads data sheets, unless it needs them

    return units_of(in_data_sheet(load_object_dictionary(node.eds, node.node_id), node.writes), scaling, node.name)


def velocity_units(scaling: AxisScaling, settings: BusSettings) -> float:
    """Return how many of its units of velocity a count per second is, of an axis whose drive is commanded velocities; 1 of others.

    Raises
    ------
    ConfigurationRefusedError
        As in `units_of`.
    """
    drive = next((node for node in settings.nodes if node.role == "drive" and node.axis == scaling.axis), None)
    return units_in_data_sheet(drive, scaling).velocity if drive is not None and scaling.mode.endswith("velocity") else 1.0


def units_of(read: Read, scaling: Scaling, who: str) -> MotionUnits:
    """Return a drive's units: those that the machine file says, else those of its objects, else counts and seconds.

    Parameters
    ----------
    read : Read
    scaling : Scaling
    who : str
        The drive, for messages.

    Raises
    ------
    ConfigurationRefusedError
        A unit that has nothing to do with the counts, or turns of which drive and machine file have different counts.
    """
    velocity = _declared(DECLARED, scaling.velocity_unit, read, scaling, who) or _velocity_by_objects(read, scaling, who) or 1.0
    return MotionUnits(velocity, acceleration_units(read, scaling, who))


def acceleration_units(read: Read, scaling: Scaling, who: str) -> float:
    """Return how many of a drive's units of acceleration a count per second squared is; its velocities may be in a unit that is not known.

    Raises
    ------
    ConfigurationRefusedError
        As in `units_of`.
    """
    declared = _declared(DECLARED_ACCELERATION, scaling.acceleration_unit, read, scaling, who)
    return declared or _acceleration_by_objects(read, scaling, who) or 1.0


def units_or_counts(read: Read, scaling: Scaling) -> MotionUnits:
    """Return the same of an emulated device: counts and seconds where its objects say nothing of the counts."""
    try:
        return units_of(read, scaling, scaling.axis)
    except ConfigurationRefusedError:
        return MotionUnits()


def check_units(read: Read, used: MotionUnits, scaling: Scaling, who: str, *, velocities: bool = True) -> None:
    """Check that a drive has the units that machine file and data sheet say of it.

    Parameters
    ----------
    read : Read
        From the drive.
    used : MotionUnits
    scaling : Scaling
    who : str
    velocities : bool
        Whether its velocities are used, too, beside its accelerations.

    Raises
    ------
    ConfigurationRefusedError
        It says other ones, or any that nobody knows and the machine file does not declare.
    """
    checks = (
        ("velocity", "s", _velocity_by_objects, scaling.velocity_unit, used.velocity),
        ("acceleration", "s^2", _acceleration_by_objects, scaling.acceleration_unit, used.acceleration),
    )
    for what, per, by_objects, declared, have in checks if velocities else checks[1:]:
        try:
            found = by_objects(read, scaling, who)
        except ConfigurationRefusedError:
            if declared:
                continue
            raise
        if found is not None and not math.isclose(found, have, rel_tol=AGREES):
            by = "machine file" if declared else "data sheet"
            raise ConfigurationRefusedError(
                f"{who}: by its own objects its unit of {what} is 1/{found:.6g} of a count/{per}, by {by} "
                f"1/{have:.6g}; every {what} would be off by {found / have:.6g}; correct the drive, or drives.{scaling.axis}.{what}_unit"
            )


def check_positions(read: Read, scaling: Scaling, who: str) -> None:
    """Check that a turn of the motor is as many counts by a drive's own objects as by the machine file.

    A feed constant of one position unit in a turn, or an encoder of one count, says nothing: nobody has set it.

    Parameters
    ----------
    read : Read
        From the drive.
    scaling : Scaling
    who : str

    Raises
    ------
    ConfigurationRefusedError
        It is not.
    """
    filed, feed, gear = scaling.counts_per_motor_turn, _ratio(read, FEED_CONSTANT), _ratio(read, GEAR_RATIO)
    if feed and feed != 1.0:
        found, by = feed / (gear or 1.0), f"6092h{f' and 6091h, {gear:g}:1' if gear else ''}"
    else:
        resolution = _ratio(read, ENCODER_RESOLUTION) or 0.0
        found, by = resolution if resolution != 1.0 else 0.0, "608Fh"
    if filed and found and not math.isclose(found, filed, rel_tol=AGREES):
        raise ConfigurationRefusedError(
            f"{who}: a turn of its motor is {found:g} counts by its own objects ({by}), {filed:g} by the machine file "
            f"(drives.{scaling.axis}: encoder_counts_per_motor_turn); every position would be off by {found / filed:g}; correct either"
        )


def whole_speed(units: float, what: str) -> tuple[int, tuple[str, ...]]:
    """Return a limit of speed in whole units of a drive, rounded down, and a note where it loses more than `COARSE`.

    Parameters
    ----------
    units : float
        The speed in the drive's units, above 0.
    what : str
        Drive and object, for messages.

    Raises
    ------
    ConfigurationRefusedError
        One unit is more.
    """
    whole = math.floor(units * (1.0 + AGREES))
    if whole < 1:
        raise ConfigurationRefusedError(f"{what} takes no speed as low as {units:.3g} of its units; set a finer unit of velocity")
    coarse = whole < (1.0 - COARSE) * units
    return whole, (f"{what} takes whole units: {whole}, where {units:.3g} are asked for; it moves that much slower",) if coarse else ()


def _velocity_by_objects(read: Read, scaling: Scaling, who: str) -> float | None:
    """Return the velocity unit that a drive's own objects say; None where they say nothing."""
    if word := read(VELOCITY_UNIT, 0):
        return _by_word(word, read, scaling, f"{who}: its velocity unit (60A9h)", "velocity_unit")
    dimension = read(OLD_VELOCITY_DIMENSION, 0)
    if dimension == OLD_RPM:
        return _per_turn(read, scaling, who) * 60.0 / 10.0 ** (read(OLD_VELOCITY_NOTATION, 0) or 0)
    factor = _ratio(read, OLD_VELOCITY_ENCODER_FACTOR)
    for index, value, known in ((OLD_VELOCITY_DIMENSION, dimension, (0, OLD_INCREMENTS)), (OLD_VELOCITY_ENCODER_FACTOR, factor, (1,))):
        if value is not None and value not in known:
            raise ConfigurationRefusedError(
                f"{who}: {index:04X}h is {value:g}, a unit of velocity that is not known here; say drives.{scaling.axis}.velocity_unit"
            )
    return _ratio(read, VELOCITY_FACTOR)


def _acceleration_by_objects(read: Read, scaling: Scaling, who: str) -> float | None:
    """Return the acceleration unit that a drive's own objects say, of velocities in the unit that they or the machine file say."""
    if word := read(ACCELERATION_UNIT, 0):
        return _by_word(word, read, scaling, f"{who}: its acceleration unit (60AAh)", "acceleration_unit")
    factor = _ratio(read, ACCELERATION_FACTOR)
    if factor is None and scaling.acceleration_unit:
        return None
    velocity = _declared(DECLARED, scaling.velocity_unit, read, scaling, who) or _velocity_by_objects(read, scaling, who)
    return velocity if factor is None else factor * (velocity or 1.0)


def _ratio(read: Read, index: int) -> float | None:
    """Return the first entry over the second."""
    first, second = read(index, 1), read(index, 2)
    return first / second if first and second else None


def _by_word(word: int, read: Read, scaling: Scaling, what: str, key: str) -> float:
    """Return how many units are a count per second, by a unit of four bytes: power of ten, numerator, denominator, nothing."""
    prefix, numerator, denominator = _power(word), word >> 16 & 0xFF, word >> 8 & 0xFF
    position = read(POSITION_UNIT, 0) or INCREMENTS << 16
    counts, count = position >> 16 & 0xFF, _power(position)
    per = SECONDS.get(denominator, math.nan)
    if numerator == RPM:
        numerator, per = 0xB4, 60.0 * per
    if math.isfinite(per):
        for sizes in (TURNS, METRES):
            if numerator in sizes and counts in sizes:
                return sizes[counts] * count * per / (sizes[numerator] * prefix)
        if numerator == counts == INCREMENTS:
            return count * per / prefix
        if numerator in TURNS and counts == INCREMENTS:
            return _per_turn(read, scaling, what) * count * per / (TURNS[numerator] * prefix)
    raise ConfigurationRefusedError(
        f"{what} is {word:08X}h, which says nothing of the counts; set it to turns, or say drives.{scaling.axis}.{key}"
    )


def _power(word: int) -> float:
    """Return the power of ten in the highest byte of a unit."""
    exponent = word >> 24 & 0xFF
    return 10.0 ** (exponent - 256 if exponent > 127 else exponent)


def _declared(units: dict[str, float], unit: str, read: Read, scaling: Scaling, who: str) -> float:
    """Return how many of a unit a count per second is; 0 where the machine file says none."""
    if not unit:
        return 0.0
    return COUNTS[unit] if unit in COUNTS else _per_turn(read, scaling, who) / units[unit]


def _per_turn(read: Read, scaling: Scaling, what: str) -> float:
    """Return the turns in a count.

    Raises
    ------
    ConfigurationRefusedError
        Drive and machine file have different counts in a turn: positions would be as wrong as velocities.
    """
    filed = scaling.counts_per_motor_turn * (_ratio(read, GEAR_RATIO) or 1.0)
    fed = _ratio(read, FEED_CONSTANT) or filed
    if not filed:
        raise ConfigurationRefusedError(f"{what} is in turns, of which the machine file says no counts")
    if not math.isclose(fed, filed, rel_tol=AGREES):
        raise ConfigurationRefusedError(
            f"{what} is in turns, of {fed:g} counts by its feed constant (6092h), of {filed:g} by the machine file (drives.{scaling.axis}: "
            "encoder_counts_per_motor_turn); correct either"
        )
    return 1.0 / fed
