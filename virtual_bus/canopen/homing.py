"""Homing methods of a CiA 402 drive (IEC 61800-7-201, clause 7): by a reference found in motion, or at the present position."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

PRESENT_POSITION = (35, 37)
INDEX_PULSE = {33: -1, 34: +1}  # direction of the search
LIMIT_SWITCH = {17: -1, 18: +1}
NEGATIVE, POSITIVE = 1, 2  # limit switches, as in the digital inputs (60FDh)
SUPPORTED_METHODS = frozenset({*PRESENT_POSITION, *INDEX_PULSE, *LIMIT_SWITCH})


class HomingState(Enum):
    """Progress of a homing run."""

    IDLE = "idle"
    SEARCHING = "searching"
    LEAVING = "leaving the switch"
    STOPPING = "stopping"
    ATTAINED = "attained"
    FAILED = "failed"


@dataclass(frozen=True)
class Reference:
    """Index pulse of the encoder and the two limit switches, in absolute motor counts.

    A switch is active at and beyond its position. None: not wired.
    """

    counts_per_turn: int
    negative_switch: int | None
    positive_switch: int | None

    def switches(self, counts: int) -> int:
        """Return which limit switches are active: bit 0 the negative one, bit 1 the positive one."""
        negative, positive, active = self.negative_switch, self.positive_switch, 0
        if negative is not None and counts <= negative:
            active = NEGATIVE
        if positive is not None and counts >= positive:
            active |= POSITIVE
        return active

    def at_negative_switch(self, counts: int) -> bool:
        """Return whether the negative limit switch is active."""
        return bool(self.switches(counts) & NEGATIVE)

    def at_positive_switch(self, counts: int) -> bool:
        """Return whether the positive limit switch is active."""
        return bool(self.switches(counts) & POSITIVE)

    def index_between(self, before: int, after: int) -> int | None:
        """Return the index pulse passed on the way, None when there was none."""
        turns_before, turns_after = before // self.counts_per_turn, after // self.counts_per_turn
        if turns_before == turns_after:
            return None
        return max(turns_before, turns_after) * self.counts_per_turn


class Homing:
    """The homing runs of a drive. `update` is called once per sample and returns how fast to move.

    Attributes
    ----------
    reference : Reference
        Index pulse and switches, as they are wired.
    """

    def __init__(self, reference: Reference) -> None:
        self.reference = reference
        self.state = HomingState.IDLE
        self.home_counts = 0  # absolute count that is home, once ATTAINED
        self._method = 0
        self._last = 0

    @property
    def running(self) -> bool:
        """Whether a homing run is under way."""
        return self.state in (HomingState.SEARCHING, HomingState.LEAVING, HomingState.STOPPING)

    def reset(self) -> None:
        """Forget the last homing run."""
        self.state = HomingState.IDLE

    def start(self, method: int, counts: int) -> None:
        """Begin at the present absolute count."""
        self._method, self._last = method, counts
        if method in PRESENT_POSITION:
            self.home_counts = counts
            self.state = HomingState.ATTAINED
        elif method in INDEX_PULSE:
            self.state = HomingState.SEARCHING
        elif self._switch_position() is None:
            self.state = HomingState.FAILED  # the method needs a switch that is not wired
        else:
            self.state = HomingState.LEAVING if self._at_switch(counts) else HomingState.SEARCHING

    def interrupt(self) -> None:
        """End the run without a home: the master took the start bit back, or halted."""
        if self.running:
            self.state = HomingState.IDLE

    def update(self, counts: int, search_speed: float, zero_speed: float, standing: bool) -> float:
        """Return the speed [counts/s] to move with, from the present absolute count."""
        speed = self._next_speed(counts, search_speed, zero_speed, standing)
        self._last = counts
        return speed

    def _next_speed(self, counts: int, search_speed: float, zero_speed: float, standing: bool) -> float:
        if self.state is HomingState.STOPPING:
            if standing:
                self.state = HomingState.ATTAINED
            return 0.0
        if self._method in INDEX_PULSE:
            return self._seek_index(counts, zero_speed)
        return self._seek_switch(counts, search_speed, zero_speed)

    def _seek_index(self, counts: int, zero_speed: float) -> float:
        direction = INDEX_PULSE[self._method]
        blocked = self.reference.at_negative_switch(counts) if direction < 0 else self.reference.at_positive_switch(counts)
        if self.state is not HomingState.SEARCHING or blocked:
            self.state = HomingState.FAILED if self.state is HomingState.SEARCHING else self.state
            return 0.0
        index = self.reference.index_between(self._last, counts)
        if index is not None:
            return self._found(index)
        return direction * zero_speed

    def _seek_switch(self, counts: int, search_speed: float, zero_speed: float) -> float:
        direction = LIMIT_SWITCH.get(self._method, 0)
        if self.state is HomingState.SEARCHING:
            if not self._at_switch(counts):
                return direction * search_speed
            self.state = HomingState.LEAVING
        if self.state is HomingState.LEAVING:
            switch = self._switch_position()
            if self._at_switch(counts) or switch is None:
                return -direction * zero_speed
            return self._found(switch)
        return 0.0

    def _found(self, home: int) -> float:
        self.home_counts = home
        self.state = HomingState.STOPPING
        return 0.0

    def _switch_position(self) -> int | None:
        return self.reference.negative_switch if LIMIT_SWITCH[self._method] < 0 else self.reference.positive_switch

    def _at_switch(self, counts: int) -> bool:
        return self.reference.at_negative_switch(counts) if LIMIT_SWITCH[self._method] < 0 else self.reference.at_positive_switch(counts)
