"""The stop of one axis for tests that step it by hand, with numbers that are exact."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

from scripted_nodes import machine_settings

from drivers.canopen.quick_stop import AxisStop
from drivers.interface import Sample
from drivers.settings import MotionLimits

T, COUNT, TRACKING = 2.0**-8, 2.0**-16, 2.0**-5
NAN = math.nan
QUICK, ENABLED, OFF, READY, SWITCHED_ON, REACTION, FAULT, ODD = 0x17, 0x37, 0x40, 0x31, 0x33, 0x1F, 0x18, 0x25
STAND, SWING, CLOSING, SETTLING, ANSWER, TORQUE, PUSH, WATCH, VOLTAGE, RETAKE, AT_MOST = 13, 64, 256, 1280, 8, 16, 77, 26, 52, 128, 2560
"""Ticks of each wait: its time in whole ticks, rounded up."""
REST = 256  # where the brake was not pushed
PUSHES, MOVED = 0.25, 32  # A, and counts that are more than a brake may slip
SETTINGS = machine_settings()


class Stopping:
    """The stop of roll, the second of two axes, whose drive obeys in the next tick."""

    def __init__(
        self,
        *,
        braked: bool = True,
        takes_torque: bool = True,
        pushes: bool = True,
        effort: float = 2.0,
        stale_ticks: int = 3,
        holding_effort: float = math.inf,
    ) -> None:
        scaling = dataclasses.replace(SETTINGS.scalings[1], position_resolution=COUNT)
        homing = dataclasses.replace(SETTINGS.homings[1], direction_check_effort=PUSHES, direction_check_travel=MOVED * COUNT)
        limits = MotionLimits("roll", -1.0, 1.0, 0.25, TRACKING, stale_ticks, holding_effort=holding_effort)
        self.stop = AxisStop(1, scaling, limits, homing, T, braked=braked, takes_torque=takes_torque, pushes=pushes)
        self.sample = Sample(2)
        self.sample.brakes_open[:] = (True, False)
        self.sample.position[:] = self.sample.link_position[:] = 0.0
        self.sample.statusword[:] = (OFF, QUICK)
        self.sample.effort[:] = (9.0, effort)
        self.fresh = True
        self.gives = 1.0
        """Share of the effort that it is told which the drive gives, and measures."""

    def tick(self, status: int | None = None, *, motor: float | None = None, link: float | None = None, ticks: int = 1) -> int:
        """Let a tick pass, with those that were missed before it; positions in counts stay. Return the controlword that follows."""
        if status is not None:
            self.sample.statusword[1] = status
        if motor is not None:
            self.sample.position[1] = motor * COUNT
        if link is not None:
            self.sample.link_position[1] = link * COUNT
        if self.sample.statusword[1] == ENABLED and not math.isnan(self.sample.effort[1]):
            self.sample.effort[1] = self.gives * self.stop.effort
        self.stop.step(self.sample, io_is_fresh=self.fresh, ticks=ticks)
        return self.stop.controlword

    def slips(self, counts: float, status: int | None = None) -> int:
        """Let one tick pass in which both sides of the axis are that far; return the controlword."""
        return self.tick(status, motor=counts, link=counts)

    def ticks(self, number: int, status: int | None = None) -> list[int]:
        return [self.tick(status) for _ in range(number)]

    def to_swinging(self) -> Stopping:
        """Its drive holds it in quick stop, its brake is closed, and it stands."""
        assert self.ticks(STAND + 1, QUICK) == [2] * (STAND + 1)
        return self

    def to_pushing(self) -> Stopping:
        self.to_swinging()
        assert self.ticks(SWING) == [2] * SWING
        assert self.tick() == 15
        assert self.tick(ENABLED) == 15
        return self

    def to_letting_go(self) -> Stopping:
        self.to_pushing()
        assert self.ticks(PUSH) == [15] * PUSH
        assert self.tick() == 0
        return self

    @property
    def words(self) -> str:
        assert self.stop.rest is not None
        return self.stop.rest.words

    @property
    def steps(self) -> list[tuple[str, float]]:
        """In ticks."""
        assert self.stop.rest is not None
        return [(name, seconds / T) for name, seconds in self.stop.rest.steps]

    def until(self, ends: Callable[[], bool], at_most: int = 4000) -> int:
        """Tick until something is so, and return how many it took."""
        for number in range(1, at_most):
            self.tick()
            if ends():
                return number
        raise AssertionError("it never was")
