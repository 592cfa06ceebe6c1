"""The watch over an axis that homes: slow motion is motion, and a position that has stopped coming is none."""

from __future__ import annotations

import dataclasses
import math

import pytest

from drivers.canopen.motion_bounds import MotionWatch
from drivers.interface import Sample
from drivers.settings import AxisScaling, HomingSettings, MotionLimits
from hil.machine import load_machine

RATE_HZ = 256
COARSE_rad = 2.0 * math.pi / 4096
BUS = load_machine("carm").bus
SPEED_rad_s = math.radians(2.0)  # a count in eleven ticks


class Clock:
    """No tick is lost."""

    missed = 0


def homing() -> tuple[MotionWatch, Sample]:
    scaling: AxisScaling = dataclasses.replace(BUS.scalings[0], position_resolution=COARSE_rad, link_resolution=0.0)
    settings: HomingSettings = dataclasses.replace(BUS.homings[0], method=17, speed=SPEED_rad_s, travel_limit=1.0)
    watch = MotionWatch([MotionLimits(scaling.axis, -3.0, 3.0, 1.0, 0.05, 200)], [scaling], Clock(), 1.0 / RATE_HZ)
    watch.home(0, settings)
    return watch, Sample(1)


def counted(position: float) -> float:
    return round(position / COARSE_rad) * COARSE_rad


def test_an_axis_that_homes_slower_than_a_count_a_tick_is_seen_to_move() -> None:
    watch, sample = homing()
    for tick in range(3 * RATE_HZ):
        sample.position[0] = counted(SPEED_rad_s * tick / RATE_HZ)
        assert watch.check(sample) == ""


@pytest.mark.parametrize("then", ["flickers by a count", "is not heard of"])
def test_one_that_stands_is_stopped_half_a_second_later(then: str) -> None:
    watch, sample = homing()
    for tick in range(RATE_HZ):
        sample.position[0] = counted(4.0 * SPEED_rad_s * tick / RATE_HZ)
        assert watch.check(sample) == ""
    stands, found = sample.position[0], []
    while not found or not found[-1]:
        sample.position[0] = stands + COARSE_rad * (len(found) % 2) if then == "flickers by a count" else math.nan
        found.append(watch.check(sample))
        assert len(found) < 2 * RATE_HZ
    assert "shows no motion for 0.5 s" in found[-1]
    assert len(found) == pytest.approx(0.5 * RATE_HZ, abs=12)
