"""Jogging by hand: motion while an order is renewed, rest without one, no way out of a range, no more jerk than the limits allow."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.settings import AxisLimits
from hil.bench.clock import LockstepClock
from hil.bench.hand_jog import SHARE, SILENT_S, HandJog

RATE_Hz = 256.0
LIMITS = (
    AxisLimits("propeller", -2.0, 2.0, 1.0, 1.0, 5.0, 0.05),
    AxisLimits("roll", -0.3, 0.3, 0.4, 1.0, 5.0, 0.05),
)


class Hand:
    """A jog, and the wall's time, which goes by with its ticks."""

    def __init__(self, pose: tuple[float, float] = (0.0, 0.0)) -> None:
        self.now_s = 0.0
        self.jog = HandJog(LIMITS, 1.0 / RATE_Hz, lambda: self.now_s)
        self.jog.begin(np.array(pose))

    def steps(self, seconds: float, axis: int = 0, speed: float = 0.0) -> np.ndarray:
        """References (N, 2) of a while, in which an order is renewed in every tick; none where no speed is given."""
        found = []
        for _ in range(round(seconds * RATE_Hz)):
            if speed:
                self.jog.order(axis, speed)
            found.append(self.jog.step().copy())
            self.now_s += 1.0 / RATE_Hz
        return np.array(found)


def test_an_axis_goes_at_the_ordered_speed_and_the_other_stands() -> None:
    way = Hand().steps(3.0, 0, 0.1)
    assert np.diff(way[-50:, 0]) * RATE_Hz == pytest.approx(0.1, rel=1e-9)
    assert np.all(way[:, 1] == 0.0)


def test_no_more_than_a_share_of_the_speed_is_followed_within_all_limits() -> None:
    way = Hand().steps(4.0, 0, 100.0)[:, 0]
    for order, most in ((1, SHARE * LIMITS[0].speed), (2, LIMITS[0].acceleration), (3, LIMITS[0].jerk)):
        assert np.abs(np.diff(way, order)).max() * RATE_Hz**order <= most * (1.0 + 1e-6)


@pytest.mark.parametrize(("lets_go", "later_s"), [(True, 0.0), (False, SILENT_S)])
def test_it_rests_when_the_button_is_let_go_and_when_nobody_renews_the_order(lets_go: bool, later_s: float) -> None:
    """A speed v is left with a jerk j in 2 sqrt(v / j), where the acceleration's limit is not reached."""
    hand = Hand()
    hand.steps(2.0, 0, 0.1)
    if lets_go:
        hand.jog.let_go()
    way = hand.steps(2.0)[:, 0]
    moves = np.flatnonzero(np.abs(np.diff(way)) > 1e-12)
    assert (moves[-1] + 1) / RATE_Hz == pytest.approx(later_s + 2.0 * np.sqrt(0.1 / LIMITS[0].jerk), abs=3.0 / RATE_Hz)
    assert hand.jog.rests


def test_an_order_held_without_end_stops_before_the_end_of_the_range() -> None:
    hand = Hand()
    way = hand.steps(10.0, 1, 1.0)[:, 1]
    end = LIMITS[1].upper - LIMITS[1].tracking_error
    assert way.max() <= end + 1e-9
    assert way[-1] == pytest.approx(end, abs=1e-9)
    assert hand.steps(0.5, 1, 1.0)[:, 1] == pytest.approx(end, abs=1e-9)
    assert hand.steps(0.5, 1, -0.1)[-1, 1] < end


def test_an_axis_that_stands_beyond_its_margin_may_only_come_back() -> None:
    hand = Hand((0.0, 0.29))
    assert np.all(hand.steps(1.0, 1, 0.1)[:, 1] == 0.29)
    assert hand.steps(1.0, 1, -0.1)[-1, 1] < 0.25


def test_one_hand_moves_one_axis() -> None:
    hand = Hand()
    hand.steps(1.0, 0, 0.1)
    way = hand.steps(2.0, 1, 0.1)
    assert np.ptp(way[-100:, 0]) == pytest.approx(0.0, abs=1e-12)
    assert way[-1, 1] > 0.1


def test_virtual_time_for_a_watcher_passes_as_on_the_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    wall_s = virtual_s = 100.0
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        nonlocal wall_s
        slept.append(seconds)
        wall_s += seconds

    monkeypatch.setattr("hil.bench.clock.time.perf_counter", lambda: wall_s)
    monkeypatch.setattr("hil.bench.clock.time.sleep", sleep)
    clock = LockstepClock(lambda seconds: None, lambda: virtual_s, paced=True)
    clock.wait_tick()
    for _ in range(10):
        virtual_s += 0.004
        wall_s += 0.001  # the work of a tick
        clock.wait_tick()
    assert sum(slept) == pytest.approx(10 * 0.003)
    wall_s += 5.0  # the computer was busy: that is not made up for
    clock.wait_tick()
    slept.clear()
    virtual_s += 0.004
    clock.wait_tick()
    assert sum(slept) == pytest.approx(0.004)
