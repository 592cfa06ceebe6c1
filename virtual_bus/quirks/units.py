"""Quirks of units: what a drive's positions, velocities and accelerations are in, said by its own objects or by nothing."""

from __future__ import annotations

from canopen.objectdictionary import ODVariable, datatypes

from drivers.canopen.units import MotionUnits
from virtual_bus.canopen.drive import Cia402Drive
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.quirks.quirk import PutOn, Quirk, reports

VELOCITY_UNIT, ENCODER_RESOLUTION, GEAR_RATIO, FEED_CONSTANT, POSITION = 0x60A9, 0x608F, 0x6091, 0x6092, 0x6064
RPM, MILLI_RPM = 0x00B4_4700, 0xFDB4_4700  # revolutions per minute, and its power of ten
TENTH_COUNTS = MotionUnits(velocity=10.0, acceleration=0.1)  # 0.1 counts/s, and 10 counts/s^2
KINCO = MotionUnits(velocity=512.0 * 60.0 / 1875.0)  # 1 rpm is 512/1875 of the encoder's resolution
_MASK, _HALF = 0xFFFF_FFFF, 0x8000_0000
FINE = 4  # times as many increments in a turn: a maker's count of edges where the machine file has lines


def has(drive: Cia402Drive, index: int, subindex: int, value: int) -> None:
    """Give a drive an object of 32 bits that its data sheet does not have."""
    variable = ODVariable(f"{index:04X}h", index, subindex)
    variable.data_type, variable.default, variable.access_type = datatypes.UNSIGNED32, value, "rw"
    drive.objects.add(variable)


def _in(unit: int) -> PutOn:
    """Return what gives a drive a unit of velocity, which its data sheet does not have."""
    return lambda machine, drive: has(drive, VELOCITY_UNIT, 0, unit)


def _silently(units: MotionUnits) -> PutOn:
    """Return what gives a drive units of which no object speaks."""

    def put_on(machine: FaultyMachine, drive: Cia402Drive) -> None:
        drive.servo.built_in = units

    return put_on


def _positions(index: int, first: int, second: int, per_increment: float) -> PutOn:
    """Return what gives a drive an object of its factor group, and positions in the unit that follows from it.

    The entries are in turns or, as the feed constant and the resolution are, in shares of the drive's own counts of a turn.
    """

    def put_on(machine: FaultyMachine, drive: Cia402Drive) -> None:
        turn = drive.settings.counts_per_turn
        counts = {ENCODER_RESOLUTION: turn * first, FEED_CONSTANT: turn * first, GEAR_RATIO: first}[index]
        has(drive, index, 1, counts // second if index == FEED_CONSTANT else counts)
        has(drive, index, 2, 1)
        if index == GEAR_RATIO:
            has(drive, FEED_CONSTANT, 1, turn)
            has(drive, FEED_CONSTANT, 2, 1)
        reports(machine, drive, POSITION, lambda counts: (round(counts * per_increment) + _HALF & _MASK) - _HALF)

    return put_on


QUIRKS = (
    Quirk("velocity_in_rpm", "Its velocities are in whole revolutions per minute (60A9h), of which its data sheet says nothing.", "units",
          "https://us.nanotec.com/products/manual/PD6C_CANopen_USB_EN/object_dictionary%2Fod_motion_0x60A9.html", _in(RPM)),
    Quirk("velocity_in_milli_rpm", "Its velocities are in thousandths of a revolution per minute (60A9h), of which its data sheet says "
          "nothing.", "units",
          "https://doc.synapticon.com/software/42/documentation_html/object_htmls/60A9/index.html", _in(MILLI_RPM)),
    Quirk("velocity_in_tenth_counts", "Its velocities are in 0.1 counts/s, its accelerations in 10 counts/s^2; no object says so.", "units",
          "https://usermanual.wiki/Document/CANopenProgrammersManual.1637534447/html", _silently(TENTH_COUNTS)),
    Quirk("velocity_by_512_1875", "A revolution per minute is 512/1875 of its encoder's resolution; no object says so.", "units",
          "https://www.easymanua.ls/kinco/fd5-series/manual?p=190", _silently(KINCO)),
    Quirk("finer_encoder", "Its encoder has four times the increments (608Fh) of the machine file.", "units",
          "https://infosys.beckhoff.com/content/1033/ax8xxx_object/11604678155.html",
          _positions(ENCODER_RESOLUTION, FINE, 1, FINE)),
    Quirk("gear_ratio_set", "Its gear ratio (6091h) is 2:1, so its positions are half as many.", "units",
          "https://infosys.beckhoff.com/content/1033/ax8xxx_object/18797977611.html", _positions(GEAR_RATIO, 2, 1, 0.5)),
    Quirk("feed_constant_set", "Its feed constant (6092h) is half its encoder's resolution, so its positions are half as many.", "units",
          "https://infosys.beckhoff.com/content/1033/amp8000_object/18779869195.html", _positions(FEED_CONSTANT, 1, 2, 0.5)),
)  # fmt: skip
