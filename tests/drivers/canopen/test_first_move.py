"""The first move of an axis: which motion under its holding effort alone is a standstill that swings, and which is none."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from scripted_nodes import machine_settings

from drivers.canopen.first_move_and_homing import check_first_move
from drivers.errors import MotionRefusedError
from drivers.interface import Sample

T, TRAVEL, AGREEMENT, PUSH = 2.0**-8, 3.5e-4, 1.7e-3, 0.3
SETTINGS = machine_settings()
HOMING = dataclasses.replace(
    SETTINGS.homings[1],
    direction_check_travel=TRAVEL,
    agreement_tolerance=AGREEMENT,
    direction_check_effort=PUSH,
    direction_check_timeout_s=2.0,
)
HOLDING = np.array([0.0, 2.0])


class Axis:
    """Roll of a machine whose both encoders show a motion by itself, and half a milliradian for each tenth of an ampere of a push."""

    def __init__(self, motion: Callable[[float], float]) -> None:
        self.axes, self.scalings, self.period_s = ("propeller", "roll"), SETTINGS.scalings, T
        self.sample, self.time_s, self.motion = Sample(2), 0.0, motion
        self.pushed_s = math.nan
        self.clock = SimpleNamespace(now=lambda: self.time_s)
        self.watch = SimpleNamespace(check=lambda sample: "")
        self.refusal, self.judged = lambda: "", lambda sample: ""

    def exchange(self, command: np.ndarray) -> Sample:
        push = float(command[1] - HOLDING[1])
        if push > 0.0 and not self.pushed_s <= self.time_s:
            self.pushed_s = self.time_s
        self.time_s += T
        self.sample.position[1] = self.sample.link_position[1] = self.motion(self.time_s) + 5e-3 * push
        return self.sample


def first_move(motion: Callable[[float], float]) -> tuple[float, str]:
    axis = Axis(motion)
    words = check_first_move(axis, 1, HOMING, HOLDING)  # type: ignore[arg-type]
    return axis.pushed_s, words


@pytest.mark.parametrize("slowest_Hz", [4.0, 8.0, 10.0, 22.0])
@pytest.mark.parametrize("phase", [0.0, 0.7, math.pi / 2.0, 2.5])
def test_an_axis_that_swings_and_stands_is_pushed_after_two_periods_of_its_slowest_mode(slowest_Hz: float, phase: float) -> None:
    swing = 0.9 * TRAVEL
    pushed_s, words = first_move(lambda t: swing * math.sin(2.0 * math.pi * slowest_Hz * t + phase))
    assert pushed_s == pytest.approx(0.5, abs=2.0 * T)
    assert "the right way" in words


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_axis_that_slides_on_is_refused_though_a_tenth_of_a_second_hardly_shows_it(sign: float) -> None:
    slide = sign * 0.7 * TRAVEL / 0.1
    with pytest.raises(MotionRefusedError, match="the holding effort is wrong"):
        first_move(lambda t: slide * t)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_slide_is_seen_behind_a_swing_that_hides_it_every_tenth_of_a_second(sign: float) -> None:
    """One that swings at 10 Hz, and slides while it swings back: samples 0.1 s apart are of one phase."""
    slide = sign * 0.8 * TRAVEL / 0.1
    with pytest.raises(MotionRefusedError, match="moves by"):
        first_move(lambda t: slide * t + 2.0 * TRAVEL * math.sin(20.0 * math.pi * t))


def test_friction_that_bends_and_stands_is_pushed_from_where_it_stands() -> None:
    pushed_s, words = first_move(lambda t: AGREEMENT * 0.9 * (1.0 - math.exp(-t / 0.1)))
    assert 0.5 < pushed_s < 1.0
    assert "the right way" in words
    creeps = 0.99 * AGREEMENT
    with pytest.raises(MotionRefusedError):
        first_move(lambda t: creeps * t / 0.4)
