"""A drive that is told to stop and to hold: which motions are a hold, and that one which is not costs it its voltage."""

from __future__ import annotations

import dataclasses
import math

import pytest
from one_stop import CLOSING, COUNT, NAN, OFF, QUICK, SETTINGS, Stopping, T

from drivers.canopen.hold import ANSWER_S, CREEP_S, OUTSIDE_TICKS, Hold

SPEED, DECELERATION, WINDOW = 1.0, 2.0, 0.05
LIMITS = dataclasses.replace(SETTINGS.motions[1], speed=SPEED, acceleration=DECELERATION, tracking_error=WINDOW, quick_stop=None)
ANSWER = math.ceil(ANSWER_S / T)


def first_outside(positions: list[float], link: list[float] | None = None, limits: object = LIMITS) -> tuple[int, str]:
    """The tick at which a hold is none any more, and the words; -1 where it is one to the end."""
    hold = Hold(limits, "rad", T, 1.0)  # type: ignore[arg-type]
    for number, motor in enumerate(positions):
        if words := hold.step(motor, NAN if link is None else link[number], NAN, 1):
            return number, words
    return -1, ""


def way(speed: float, acceleration: float, seconds: float = 2.0, *, rests: bool = True) -> list[float]:
    """Positions of a motion with this speed until the drive answers, then with this acceleration, to rest or for ever."""
    found, now, at = [], speed, 0.0
    for k in range(round(seconds / T)):
        found.append(at)
        at += now * T
        if k >= ANSWER and (now != 0.0 or not rests):
            slower = now + acceleration * T
            now = 0.0 if rests and slower * now <= 0.0 else slower
    return found


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("speed", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("deceleration", [DECELERATION, 10.0 * DECELERATION])
def test_a_stop_within_the_limit_of_acceleration_is_a_hold(sign: float, speed: float, deceleration: float) -> None:
    assert first_outside(way(sign * speed, -sign * deceleration)) == (-1, "")


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("speed", [0.001, 0.3, 1.0])
@pytest.mark.parametrize("push", [0.0, 0.5, 4.0])
def test_an_axis_that_goes_on_is_seen_where_it_is_a_window_beyond_its_stop(sign: float, speed: float, push: float) -> None:
    tick, words = first_outside(way(sign * speed, sign * push, 30.0, rests=False))
    if speed == 0.001 and push == 0.0:
        assert tick == -1, "a creep"
        return
    since = (tick - OUTSIDE_TICKS + 1 - ANSWER) * T
    ramp = min(since, speed / DECELERATION)
    beyond = speed * since + 0.5 * push * since**2 - speed * ramp + 0.5 * DECELERATION * ramp**2
    assert beyond == pytest.approx(WINDOW, abs=2.0 * (speed + push * since) * T)
    assert f"its motor side is {sign * WINDOW:+.0e}"[:18] in words


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_axis_that_is_pushed_back_is_seen_a_window_before_its_furthest_place(sign: float) -> None:
    positions = way(sign * 1.0, -sign * 4.0, rests=False)
    tick, _ = first_outside(positions)
    furthest = max(sign * position for position in positions)
    assert furthest - sign * positions[tick - OUTSIDE_TICKS + 1] == pytest.approx(WINDOW, abs=4.0 * T)


def test_a_link_that_swings_by_less_than_the_window_is_held() -> None:
    swing = [0.45 * WINDOW * math.sin(2.0 * math.pi * 4.0 * k * T) for k in range(2000)]
    assert first_outside([0.0] * 2000, swing) == (-1, "")


def test_either_encoder_alone_shows_that_an_axis_is_not_held() -> None:
    falls = way(0.0001, 1.0, rests=False)
    assert first_outside([0.0] * len(falls), falls)[1].startswith("its link is +5")
    assert first_outside(falls, [0.0] * len(falls))[1].startswith("its motor side is +5")


def test_a_counter_that_is_set_and_a_frame_that_is_damaged_are_no_motion() -> None:
    positions = [0.0] * 1000
    positions[200] = 3.0
    assert first_outside(positions)[0] == -1
    assert first_outside([0.0] * 100 + [3.0] * 500)[0] == -1
    fast = [0.0] * 100 + [10.0 * SPEED * k * T for k in range(100)]
    assert first_outside(fast)[0] > 0, "step after step it is one"


def test_missing_positions_are_bridged() -> None:
    positions = way(1.0, -DECELERATION)
    assert first_outside([NAN if 3 <= k % 20 < 9 else position for k, position in enumerate(positions)]) == (-1, "")
    assert first_outside([NAN] * 500) == (-1, "")


def test_an_axis_that_creeps_is_held_where_it_is_and_one_that_creeps_faster_is_not() -> None:
    a_tenth = 0.1 * WINDOW / CREEP_S
    assert first_outside([0.9 * a_tenth * k * T for k in range(40_000)])[0] == -1
    assert first_outside([1.2 * a_tenth * k * T for k in range(40_000)])[0] > 0


def test_a_slower_ramp_that_the_machine_file_states_is_borne() -> None:
    slow = dataclasses.replace(LIMITS, quick_stop=0.5)
    assert first_outside(way(1.0, -0.5, 4.0), limits=slow)[0] == -1
    assert first_outside(way(1.0, -0.5, 4.0))[0] > 0


# ---- effort ---------------------------------------------------------------------------------------------
MOST = 2.0
HOLDING = dataclasses.replace(LIMITS, holding_effort=MOST)
RAMP_S = SPEED / DECELERATION


def seen_after(effort: float, seconds: float = 60.0, hold: Hold | None = None) -> float:
    """Seconds from the end of the ramp until an axis that stands under this effort is no longer held; NaN: it is to the end."""
    hold = hold or Hold(HOLDING, "rad", T, 5.0)
    for number in range(1, round(seconds / T) + 1):
        if hold.step(0.0, 0.0, effort, 1):
            return number * T - RAMP_S
    return NAN


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("effort", [2.5, 4.0, 8.0])
def test_more_effort_than_any_pose_takes_is_no_hold_after_the_time_of_a_low_pass(sign: float, effort: float) -> None:
    assert seen_after(sign * effort) == pytest.approx(-CREEP_S * math.log(1.0 - MOST / effort), abs=0.02)
    assert math.isnan(seen_after(sign * 0.999 * MOST))


def test_the_words_say_the_effort_and_what_holds() -> None:
    hold = Hold(HOLDING, "rad", T, 5.0)
    words = [hold.step(0.0, 0.0, -8.0, 1) for _ in range(1000)][-1]
    assert words == "it gives up to -160% of its rated effort, at most 40% hold the axis at any pose"
    assert hold.step(0.0, 0.0, NAN, 1) == words, "a frame that is lost takes nothing back"


def test_the_words_of_an_effort_that_comes_and_goes_are_its_own() -> None:
    hold = Hold(HOLDING, "rad", T, 5.0)
    words = [hold.step(0.0, 0.0, -0.5 if number % 2 else 8.0, 1) for number in range(3001)]
    assert {each for each in words if each} == {"it gives up to +160% of its rated effort, at most 40% hold the axis at any pose"}


def test_what_a_drive_is_left_with_for_two_seconds_of_a_stop_is_no_push() -> None:
    hold = Hold(HOLDING, "rad", T, 1.0)
    braked = round((RAMP_S + 1.0) / T)
    assert not any(hold.step(0.0, 0.0, 8.0 if number < braked else 1.5, 1) for number in range(5000))


def test_efforts_of_lost_ticks_count_and_those_of_a_former_hold_do_not() -> None:
    hold = Hold(HOLDING, "rad", T, 1.0)
    by_two = next(number for number in range(5000) if hold.step(0.0, 0.0, 8.0, 2))
    assert 2.0 * by_two * T == pytest.approx(RAMP_S - CREEP_S * math.log(0.75), abs=0.05)
    hold.begin()
    assert seen_after(8.0, hold=hold) == pytest.approx(-CREEP_S * math.log(0.75), abs=0.02)
    assert math.isnan(seen_after(8.0, hold=Hold(LIMITS, "rad", T, 1.0))), "no limit, no judgement"
    assert math.isnan(seen_after(NAN))


# ---- the stop of an axis --------------------------------------------------------------------------------
def pushed(stopping: Stopping, ticks: int, status: int) -> list[int]:
    """Move the axis by 60 counts a tick, 0.23 rad/s, and return the controlwords."""
    begins = int(stopping.sample.position[1] / COUNT)
    return [stopping.tick(status, motor=begins + 60 * k, link=begins + 60 * k) for k in range(1, ticks + 1)]


@pytest.mark.parametrize("brake", ["closed", "open", "none"])
def test_a_drive_that_pushes_loses_its_voltage_whatever_the_brake_says(brake: str) -> None:
    stopping = Stopping(braked=brake != "none")
    stopping.sample.brakes_open[1] = brake == "open"
    words = pushed(stopping, 60, QUICK)
    assert words[:34] == [2] * 34
    assert words[-1] == 0
    assert stopping.stop.effort == 0.0
    pushed(stopping, CLOSING, OFF)
    if brake == "closed":
        assert stopping.stop.rest is None, "a weak brake may need its time"
        assert stopping.until(lambda: stopping.stop.rest is not None) < 2.0 / T
        assert stopping.stop.rest is not None
        assert stopping.stop.rest.safe
        assert stopping.words.startswith("at rest: brake closed by its feedback, not pushed: its drive did not hold it, its ")
    else:
        assert stopping.words.startswith("not proven at rest: its drive did not hold it, its ")
        assert stopping.words.endswith("; IT MOVES")
    assert ", voltage off" in stopping.words
    assert stopping.stop.rest is not None
    assert not stopping.stop.rest.held
    assert stopping.ticks(10, QUICK)[-1] in (0, 2)


def test_a_held_axis_that_is_pushed_later_is_held_no_more() -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = True
    stopping.until(lambda: stopping.stop.rest is not None)
    assert stopping.words.startswith("held by its drive: ")
    pushed(stopping, 60, QUICK)
    assert (stopping.stop.rest, stopping.stop.controlword) == (None, 0)
    pushed(stopping, CLOSING, OFF)
    assert stopping.words.startswith("not proven at rest: its drive did not hold it, ")


@pytest.mark.parametrize(("effort", "holds"), [(4.7, True), (8.0, False), (-8.0, False)])
def test_a_drive_that_pushes_an_axis_which_stands_loses_its_voltage(effort: float, holds: bool) -> None:
    stopping = Stopping(effort=effort, holding_effort=4.8)
    stopping.sample.brakes_open[1] = True
    taken = any(stopping.tick(QUICK) == 0 for _ in range(round(10.0 / T)))
    assert taken is not holds
    if holds:
        assert stopping.words.startswith("held by its drive: ")
    else:
        stopping.ticks(CLOSING + 1, OFF)
        rated = SETTINGS.scalings[1].rated
        assert stopping.words == (
            f"not proven at rest: its drive did not hold it, it gives up to {effort / rated:+.0%} of its rated effort, "
            f"at most {4.8 / rated:.0%} hold the axis at any pose, voltage off; its brake reports open; it stands"
        )


def test_a_drive_that_keeps_its_voltage_is_reset_and_that_is_told() -> None:
    stopping = Stopping()
    pushed(stopping, 60, QUICK)
    assert stopping.stop.orders_node == 0x81
    stopping.until(lambda: stopping.stop.rest is not None)
    assert ", and keeps its voltage (quick stop active); " in stopping.words
    silent = Stopping()
    for k in range(100):
        silent.tick(-1, motor=NAN, link=60 * k)
    assert ", and does not answer; " in silent.words
    assert not silent.stop.rest.safe  # type: ignore[union-attr]


def test_an_axis_whose_drive_has_no_voltage_is_not_accused() -> None:
    stopping = Stopping()
    pushed(stopping, CLOSING + 1, OFF)
    assert "did not hold" not in stopping.words


@pytest.mark.parametrize(("left", "told"), [(2.0, ""), (1.6, ""), (1.4, "+30%"), (0.0, "+0%"), (-2.0, "-43%")])
def test_a_drive_that_gives_less_than_holds_the_axis_is_told_though_no_encoder_moves(left: float, told: str) -> None:
    """Torque lost behind frozen encoders looks so, and an axis that somebody supports: between them the words leave the choice."""
    stopping = Stopping(effort=2.0)
    stopping.sample.brakes_open[1] = True
    stopping.until(lambda: stopping.stop.rest is not None)
    held = stopping.words
    stopping.ticks(100)
    assert stopping.words == held
    stopping.sample.effort[1] = left
    stopping.ticks(200)
    rated = SETTINGS.scalings[1].rated
    now = f"{left / rated:+.0%}"
    eased = f"; its drive gives {now} of its rated effort, it gave {2.0 / rated:+.0%}: something else carries it, or nothing"
    assert stopping.words == held + (eased if told else "")
    assert not stopping.stop.alarm
    stopping.sample.effort[1] = 2.0
    stopping.ticks(200)
    assert stopping.words == held, "it carries the axis again"
