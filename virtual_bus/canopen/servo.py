"""Motor, counter and own control loops of a drive: what all its modes of operation work with."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol, cast

from drivers.canopen import units
from virtual_bus.canopen.motion import VelocityGains, VelocityLoop
from virtual_bus.canopen.objects import Objects, Value, key_of
from virtual_bus.canopen.pdo import dummy_entry
from virtual_bus.errors import EmulatorError
from virtual_bus.settings import EmulatedDrive

STANDSTILL_SHARE = 0.5  # of the slowest homing speed; a slower motor counts as standing
TURNS_OF_A_SLOW_SEARCH = 4  # of the motor in a second, the speed of homing where a data sheet has none (6099h)
NO_LIMIT = 0xFFFF_FFFF  # a window of this width watches nothing, a greatest speed of this size limits nothing
_INTEGER32 = 0x04
_MOST_PERMILLE = 0xFFFF  # of 6072h
_HALF_TURN, _TURN, _MASK = 0x8000_0000, 0x1_0000_0000, 0xFFFF_FFFF  # of a counter of 32 bits
_LOWEST, _HIGHEST = -_HALF_TURN, _HALF_TURN - 1


class Number(Protocol):
    """An entry of the dictionary that holds an integer."""

    value: int


class Demand(NamedTuple):
    """What a mode of operation asks of the servo for one sample, in the drive's counts."""

    speed: float  # counts/s: what the velocity loop follows
    torque: int = 0  # per mille of rated: added behind the velocity loop
    position: float | None = None  # counts: what the position loop follows, in a mode that has one
    limited: bool = False  # whether a limit has cut the demand


class Servo:
    """The cascade of a drive: a position's demand gives a speed, the lag behind it a torque, within the limits of torque and current.

    Attributes
    ----------
    permille : int
        Torque of the present sample, per mille of the rated value.
    limited : bool
        Whether a limit acts in this sample (statusword, bit 11).
    released : bool
        Whether the motor has been free, or held by its brake, until now.
    built_in : MotionUnits, optional
        Units of which no object of the device speaks, in force from the next restart on.
    origin, absolute, offset : int
        Motor counts: where the counter began, where it is, and what is added to show the position actual value.
    speed_counts_s : float
        Differences of the counter, smoothed by a first-order filter.
    """

    def __init__(self, objects: Objects, settings: EmulatedDrive, period_s: float) -> None:
        self.objects, self.period_s = objects, period_s
        self.position_gain = settings.position_gain
        per_count = settings.position_resolution * 1000.0 / settings.rated
        gains = VelocityGains(settings.velocity_gain * per_count, settings.velocity_integral_gain * per_count)
        self._settings = settings
        self._speed_share = settings.speed_filter  # of the newest difference
        self._last: int | None = None  # where the counter was one sample ago
        self.speed_counts_s = 0.0
        self.units = units.MotionUnits()
        self.built_in: units.MotionUnits | None = None
        self._read_units()
        for index in units.OBJECTS:
            for subindex in range(3):
                objects.effects[key_of(index, subindex)] = lambda value: self._read_units()
        slow = objects.get(0x6099, 2)
        slowest = settings.counts_per_turn // TURNS_OF_A_SLOW_SEARCH if slow is None else self.counts_s(slow.value)
        self.standstill_counts_s = STANDSTILL_SHARE * slowest
        self.loop = VelocityLoop(gains, period_s, self.standstill_counts_s, settings.torque_sections)
        self.position, self._velocity = self.entry(0x6064), self.entry(0x606C)
        self.position_demand, self.velocity_demand, self.following_error = self.entry(0x6062), self.entry(0x606B), self.entry(0x60F4)
        limit = min(int(1000.0 * settings.limit / settings.rated), _MOST_PERMILLE)
        self._max_torque, self._max_current = self.entry(0x6072, limit), self.entry(0x6073, limit)
        self._lowest, self._highest = objects.get(0x607D, 1), objects.get(0x607D, 2)
        self.permille, self.released = 0, True
        self.limited = False
        self.origin = self.absolute = self.offset = 0
        self._deceleration = math.inf

    def entry(self, index: int, value: int = 0) -> Number:
        """Return an object, or one of this value that nobody sees where the device's data sheet has none."""
        if (entry := self.objects.get(index)) is None:
            entry = dummy_entry(_INTEGER32)
            entry.value = value
        if not entry.is_integer:
            raise EmulatorError(f"{self._settings.eds}: no data sheet of a CiA 402 drive: {index:04X}h is no integer")
        return cast("Number", entry)

    # ---- units ----------------------------------------------------------------------------------------
    def _read_units(self) -> None:
        """Take the units of the device's own objects; those that say nothing of its counts are counts and seconds here."""

        def read(index: int, subindex: int) -> int | None:
            entry = self.objects.get(index, subindex)
            return entry.value if entry is not None and isinstance(entry.value, int) else None

        self.units = self.built_in or units.units_or_counts(read, self._settings)

    def counts_s(self, velocity: Value) -> float:
        """Return the speed [counts/s] that an object in the device's unit of velocity holds."""
        return int(velocity) / self.units.velocity

    def counts_s2(self, acceleration: Value) -> float:
        """Return the acceleration [counts/s^2] that an object holds, one unit at least."""
        return max(1, int(acceleration)) / self.units.acceleration

    # ---- the counter ----------------------------------------------------------------------------------
    def place(self, counts: int) -> None:
        """Stand at this absolute count, which the counter calls zero."""
        self.origin = self.absolute = counts
        self.restart()

    def restart(self) -> None:
        """Call the present position zero."""
        self.offset = -self.absolute
        self._last, self.speed_counts_s = None, 0.0
        self._read_units()

    def latch(self, counts: int) -> int:
        """Take the counter's reading at this sample, from where it began, and return where it is in absolute counts."""
        self.absolute = absolute = self.origin + counts
        if (last := self._last) is not None:
            self.speed_counts_s += self._speed_share * ((absolute - last) / self.period_s - self.speed_counts_s)
        self._last = absolute
        position, velocity = absolute + self.offset, round(self.speed_counts_s * self.units.velocity)
        self.position.value = position if _LOWEST <= position <= _HIGHEST else wrap_32(position)
        self._velocity.value = velocity if _LOWEST <= velocity <= _HIGHEST else wrap_32(velocity)
        return absolute

    def take_home(self, home_counts: int) -> None:
        """Show the home offset (607Ch) at this absolute count."""
        self.offset = self.objects.number(0x607C) - home_counts
        self.position.value = wrap_32(self.absolute + self.offset)

    # ---- torque ---------------------------------------------------------------------------------------
    @property
    def limit(self) -> int:
        """Greatest torque, per mille of rated: 6072h or 6073h, the smaller one."""
        torque, current = self._max_torque.value, self._max_current.value
        return torque if torque < current else current

    def release(self) -> None:
        """Give no torque: the motor is free, or held by its brake."""
        self.permille = 0
        self.released = True

    def take_over(self, feedforward_permille: int = 0) -> None:
        """Let the velocity loop begin at the present speed, its integral at the present torque less what is fed forward.

        Of a released motor it begins at zero: what is fed forward acts at once.
        """
        self.loop.start(self.speed_counts_s, self._left_by(feedforward_permille))

    def _left_by(self, feedforward_permille: int) -> int:
        return 0 if self.released else self.permille - feedforward_permille

    def follow(self, demand: Demand) -> int:
        """Return the torque that follows a demand, which is shown in 6062h and 606Bh."""
        limit = self.limit
        torque = round(self.loop.follow(demand.speed, self.speed_counts_s, demand.torque, limit))
        self._show(demand.speed, demand.position)
        self.limited = demand.limited or abs(torque) >= limit
        return torque

    def foreseen(self, demand: Demand, *, takes_over: bool) -> int:
        """Return what `follow` would return for this demand, after `take_over` if the mode has yet to; nothing changes."""
        start = float(self._left_by(demand.torque)) if takes_over else None
        return round(self.loop.foreseen(demand.speed, self.speed_counts_s, demand.torque, self.limit, start_permille=start))

    def move(self, speed: float, ramp: float) -> int:
        """Return the torque that brings the motor to a speed [counts/s] along a ramp [counts/s^2]."""
        limit = self.limit
        torque = round(self.loop.torque(speed, min(ramp, 1e12), self.speed_counts_s, limit))
        self._show(self.loop.set_counts_s)
        self.limited = abs(torque) >= limit
        return torque

    def start_braking(self, option: int) -> None:
        """Begin a stop of 605Ah to 605Eh: 1 along 6084h, 2 along 6085h, 3 and 4 as hard as the limits allow."""
        ramp = {1: self.objects.number(0x6084), 2: self.objects.number(0x6085)}.get(option, 0)
        self._deceleration = self.counts_s2(ramp) if ramp else math.inf
        self.loop.start(self.speed_counts_s if math.isfinite(self._deceleration) else 0.0, self.permille)

    def brake(self) -> int:
        """Return the torque of the stop that has begun, and at its end of standing still."""
        return self.move(0.0, self._deceleration)

    def _show(self, speed: float, position: float | None = None) -> None:
        self.velocity_demand.value = wrap_32(round(speed * self.units.velocity))
        self.position_demand.value = self.position.value if position is None else wrap_32(round(position))
        if position is None:
            self.following_error.value = 0

    def show_no_demand(self) -> None:
        """Show, where neither loop acts, speed zero and the position where the motor is."""
        self._show(0.0)

    def way_to(self, position: float) -> float:
        """Return the way [counts] from the position actual value, over the end of the counter of 32 bits where it is shorter."""
        way = position - self.position.value
        return way if -_HALF_TURN <= way < _HALF_TURN else (way + _HALF_TURN) % _TURN - _HALF_TURN

    def within_software_limits(self, position: int) -> int:
        """Return the position nearest to this one within 607Dh, which limits nothing unless its minimum is below its maximum."""
        if self._lowest is None or self._highest is None:
            return position
        lowest, highest = int(self._lowest.value), int(self._highest.value)
        return min(max(position, lowest), highest) if lowest < highest else position


def wrap_32(value: int) -> int:
    """Return the value of a signed counter of 32 bits."""
    return (value + _HALF_TURN & _MASK) - _HALF_TURN
