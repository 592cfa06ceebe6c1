"""What a machine and how far its training recordings go say of how large places, orders and lags of an effect may be beforehand.

Nothing is known of a place but where it may be, so beforehand it is anywhere in a range R. A range costs what a normal distribution of
R / sqrt(2 pi) does: log(R / (sqrt(2 pi) s)) where recordings show the place with a deviation s (MacKay 2003, ch. 28). How near zero it is
says nothing: zero is where somebody began to count.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isfinite, pi, sqrt

import numpy as np

from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns
from virtual_bus.effects.effect import Parameter

RANGE_AS_DEVIATION = 1.0 / sqrt(2.0 * pi)
"""Deviation, over its width, of a normal distribution that costs as much as a range."""

ACTS_FROM = (("end_stop", "at_position"),)
"""Places beyond which an effect acts. Where no recording goes it does nothing, so it is where they go."""

IS_NONE_AT = (("cable_spring", "theta0"),)
"""Places at which an effect that acts everywhere is none: anywhere the joint may go, however little of that was visited. A cable and a
weight on a lever that fit a few degrees alike would else be told apart by how few they are. One that is slack further away, as a hose may
be, is fitted at that end with wrong numbers."""

REPLACES_THE_FILES = (("imu_bandwidth", "fc"),)
"""Numbers that take the place of the machine file's: what they do is in proportion to the difference. Counted from nothing, a lag that
changes by a twelfth would be known twelve times as well as a delay that does the same, and so much the less likely beforehand."""

NARROWEST = 1e-6
"""Of a range, in units of its ends or of 1: an axis that stood still has a place nowhere else, but differences of positions must show."""

SMALLEST = 1e-12


@dataclass(frozen=True)
class Travel:
    """Of one axis.

    Attributes
    ----------
    low, high : float
        Positions of the joint between which it was [rad or m].
    ratio : float
        Motor positions per joint position.
    lower, upper : float
        Where it may go; infinite where the machine file does not say.
    turns : bool
        Whether it is an angle.
    """

    low: float
    high: float
    ratio: float = 1.0
    lower: float = -inf
    upper: float = inf
    turns: bool = True

    @property
    def length(self) -> float:
        return self.high - self.low

    def where_it_may_go(self) -> tuple[float, float]:
        """Ends of the joint's range, with all of what was visited; where it has no limit what is missing to a turn."""
        low = min(self.lower, self.low) if isfinite(self.lower) else self.low
        high = max(self.upper, self.high) if isfinite(self.upper) else self.high
        missing = max(2.0 * pi - (high - low), 0.0) if self.turns else 0.0
        is_open = [not isfinite(self.lower), not isfinite(self.upper)]
        each = missing / max(sum(is_open), 1)
        return low - each * is_open[0], high + each * is_open[1]


@dataclass(frozen=True)
class Visited:
    """How far the training recordings go.

    Attributes
    ----------
    time_s : float
        The longest.
    travels : mapping of axis to Travel
        In the machine's order.
    low_passes_Hz : mapping of IMU to float
        Of those whose readings the machine file has filtered.
    """

    time_s: float
    travels: dict[str, Travel] = field(default_factory=dict)
    low_passes_Hz: dict[str, float] = field(default_factory=dict)

    @classmethod
    def by(cls, runs: FreeRuns) -> Visited:
        groups, machine = runs.sets[TRAIN].groups, runs.machine
        positions = np.concatenate([group.position for group in groups])
        travels = {
            limits.axis: Travel(float(q.min()), float(q.max()), drive.ratio, limits.lower, limits.upper, limits.unit == "rad")
            for limits, drive, q in zip(machine.limits, machine.plant.drives, positions.T, strict=True)  # all in the order of axes
        }
        corners = {imu.name: imu.accelerometer_bandwidth_Hz or imu.gyro_bandwidth_Hz for imu in machine.plant.imus}
        filtered = {name: corner for name, corner in corners.items() if corner}
        return cls(max(float(np.ptp(group.time_s)) for group in groups), travels, filtered)

    def one_over_a_radian(self) -> float:
        """The order [cycles per turn] that turns a wave's phase by a radian along the longest way of any motor."""
        return 1.0 / max(max(travel.length * travel.ratio for travel in self.travels.values()), SMALLEST)

    def what_changes(self, effect: EffectAt, parameter: Parameter, value: float) -> float:
        """What of a parameter is not in the machine file.

        A low pass in place of the file's own does what the difference of their lags does: of a corner f beside the file's f0 that is the
        share f (1/f - 1/f0).
        """
        own = self.low_passes_Hz.get(effect.at, 0.0)
        if (effect.effect, parameter.name) not in REPLACES_THE_FILES or not own:
            return value
        return value * (1.0 - value / own)

    def range_of_a_place(self, effect: EffectAt, parameter: Parameter) -> tuple[float, float] | None:
        """Between which positions a place may be beforehand, wherever the catalogue's bounds are; None of what is no place of an axis."""
        travel, name = self.travels.get(effect.at), (effect.effect, parameter.name)
        if travel is None or name not in (*ACTS_FROM, *IS_NONE_AT):
            return None
        low, high = (travel.low, travel.high) if name in ACTS_FROM else travel.where_it_may_go()
        missing = max(NARROWEST * max(abs(low), abs(high), 1.0) - (high - low), 0.0)
        return low - 0.5 * missing, high + 0.5 * missing
