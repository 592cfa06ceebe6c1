"""What became of a machine, from logs whose motion is known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from virtual_bus.canopen.power_state import PowerState
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.faults.outcome import SWING_S, outcome_of, standstill_of

PERIOD_S = 1e-3
STANDING = (4e-3,)
"""rad by which an axis may swing that stands."""
OFF, ENABLED = int(PowerState.SWITCH_ON_DISABLED), int(PowerState.OPERATION_ENABLED)


def braking(speed: float, deceleration: float, onset_s: float, end_s: float, brake: float = 1.0, drive: int = OFF) -> MotionLog:
    """One axis that goes at constant speed to the onset and brakes to rest from there."""
    log = MotionLog(("roll",))
    for time_s in np.arange(0.0, end_s, PERIOD_S):
        braked_s = min(max(time_s - onset_s, 0.0), speed / deceleration)
        position = speed * (min(time_s, onset_s) + braked_s) - 0.5 * deceleration * braked_s**2
        log.add(float(time_s), [position], [speed - deceleration * braked_s], [0.0], [brake], [drive])
    return log


def test_time_and_travel_of_a_constant_deceleration() -> None:
    outcome = outcome_of(braking(0.4, 1.6, 1.0, 4.0), 1.0, STANDING)
    roll = outcome.of("roll")
    assert outcome.at_rest
    assert roll.rest_s == pytest.approx(0.4 / 1.6, abs=2 * PERIOD_S)
    assert roll.travel == pytest.approx(0.4**2 / (2 * 1.6), rel=1e-3)
    assert roll.furthest == pytest.approx(roll.travel)
    assert roll.fastest == pytest.approx(0.4)
    assert outcome.watched_s == pytest.approx(3.0, abs=2 * PERIOD_S)


@pytest.mark.parametrize(
    ("brake", "drive", "ending"),
    [
        (1.0, OFF, "held by its brake"),
        (0.0, ENABLED, "held by its drive"),
        (1.0, ENABLED, "held by both"),
        (0.0, OFF, "at rest, held by nothing"),
        (0.2, OFF, "held by its brake"),
    ],
)
def test_what_holds_an_axis_at_rest_is_named(brake: float, drive: int, ending: str) -> None:
    assert outcome_of(braking(0.4, 1.6, 1.0, 4.0, brake, drive), 1.0, STANDING).of("roll").ending == ending


def test_an_axis_that_was_still_only_just_before_the_end_is_not_at_rest() -> None:
    outcome = outcome_of(braking(0.4, 1.6, 1.0, 2.0), 1.0, STANDING)
    assert not outcome.at_rest
    assert math.isnan(outcome.of("roll").rest_s)
    assert outcome.of("roll").ending == "moving"


@pytest.mark.parametrize(
    ("drive", "amplitude", "ending"), [(ENABLED, 1.9e-3, "held by its drive"), (ENABLED, 2.1e-3, "moving"), (OFF, 1.9e-3, "moving")]
)
def test_an_axis_that_its_drive_shakes_in_its_place_is_held(drive: int, amplitude: float, ending: str) -> None:
    log, rate = MotionLog(("roll",)), 40.0
    for time_s in np.arange(0.0, 4.0, PERIOD_S).tolist():
        log.add(time_s, [amplitude * math.sin(rate * time_s)], [amplitude * rate * math.cos(rate * time_s)], [1.0], [0.0], [drive])
    assert outcome_of(log, 1.0, STANDING).of("roll").ending == ending


def test_a_swing_counts_along_its_path() -> None:
    log = MotionLog(("roll",))
    for time_s in np.arange(0.0, 4.0, PERIOD_S):
        log.add(float(time_s), [math.sin(2.0 * math.pi * time_s)], [2.0 * math.pi * math.cos(2.0 * math.pi * time_s)], [0.0], [0.0], [OFF])
    roll = outcome_of(log, 0.0, STANDING).of("roll")
    assert roll.travel == pytest.approx(16.0, rel=1e-2)
    assert roll.furthest == pytest.approx(1.0, rel=1e-4)


def test_a_time_after_the_log_is_refused() -> None:
    with pytest.raises(ValueError, match="ends before"):
        outcome_of(braking(0.4, 1.6, 1.0, 2.0), 3.0, STANDING)


def test_standstill_is_where_the_rest_of_a_braking_is_no_motion_any_more() -> None:
    moved, deceleration = 5e-4, 1.6
    left_s = math.sqrt(2.0 * moved / deceleration)
    took = standstill_of(braking(0.4, deceleration, 1.0, 4.0), "roll", 1.0, moved, from_stop=False)
    assert took.time_s == pytest.approx(0.4 / deceleration - left_s, abs=2 * PERIOD_S)
    assert took.travel == pytest.approx(0.4**2 / (2.0 * deceleration) - moved, abs=1e-4)


def test_a_turning_point_is_no_standstill_and_one_that_never_comes_is_endless() -> None:
    log = MotionLog(("roll",))
    for time_s in np.arange(0.0, 4.0, PERIOD_S):
        log.add(float(time_s), [math.sin(2.0 * math.pi * time_s)], [0.0], [0.0], [0.0], [OFF])
    assert standstill_of(log, "roll", 1.0, 5e-4, from_stop=False).time_s == math.inf
    assert standstill_of(braking(0.4, 0.1, 1.0, 4.0), "roll", 1.0, 5e-4, from_stop=False).time_s == math.inf


def test_time_from_the_stop_begins_where_a_drive_is_told_to() -> None:
    log = braking(0.4, 1.6, 1.0, 4.0, drive=ENABLED)
    stopped = MotionLog(("roll",))
    for k, time_s in enumerate(log.time_s.tolist()):
        drive = ENABLED if time_s < 1.1 - 1e-9 else int(PowerState.QUICK_STOP_ACTIVE)
        stopped.add(time_s, [float(log.position[k, 0])], [0.0], [0.0], [1.0], [drive])
    from_fault = standstill_of(stopped, "roll", 1.0, 5e-4, from_stop=False)
    from_stop = standstill_of(stopped, "roll", 1.0, 5e-4, from_stop=True)
    assert from_fault.time_s - from_stop.time_s == pytest.approx(0.1, abs=2 * PERIOD_S)
    assert SWING_S > 1 / 8
