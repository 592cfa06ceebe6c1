"""The stop of one axis tick by tick: what it orders, for how long it waits and what it says, with numbers that are exact."""

from __future__ import annotations

import math

import numpy as np
import pytest
from one_stop import (
    ANSWER,
    CLOSING,
    COUNT,
    ENABLED,
    FAULT,
    MOVED,
    NAN,
    ODD,
    OFF,
    PUSH,
    PUSHES,
    QUICK,
    REACTION,
    READY,
    REST,
    SETTLING,
    STAND,
    SWING,
    SWITCHED_ON,
    TRACKING,
    WATCH,
    Stopping,
    T,
)


def test_a_stop_orders_quick_stop_and_brake_at_once() -> None:
    stopping = Stopping()
    stop = stopping.stop
    assert (stop.controlword, stop.effort, stop.orders_brake, stop.asks_for_torque, stop.rest) == (2, 0.0, True, False, None)
    assert (stop.axis, stop.name) == (1, "roll")


def test_each_step_of_a_stop_takes_its_time_and_the_whole_is_told() -> None:
    stopping = Stopping().to_letting_go()
    assert stopping.ticks(WATCH - 2, OFF) == [0] * (WATCH - 2)
    assert stopping.stop.rest is None
    stopping.tick()
    rest = stopping.stop.rest
    assert rest is not None
    assert (rest.axis, rest.safe, rest.held, rest.words) == ("roll", True, False, "at rest: brake proven, voltage off")
    assert stopping.steps == [("closing", STAND + 1), ("swinging", SWING), ("taking over", 2), ("pushing", PUSH), ("letting go", WATCH)]
    stopping.sample.effort[1] = 0.0
    assert stopping.ticks(100, ENABLED) == [0] * 100
    assert stopping.stop.rest is rest, "what has ended changes no more"


@pytest.mark.parametrize("held", [2.0, -2.0, 0.0])
def test_the_drive_lets_go_then_pushes_the_way_the_load_pulls(held: float) -> None:
    stopping = Stopping(effort=held).to_swinging()
    stopping.ticks(SWING + 1)
    assert stopping.stop.effort == held
    push = -math.copysign(PUSHES + 0.25 * abs(held), held)
    stopping.tick(ENABLED)
    for k in range(1, PUSH + 1):
        stopping.tick()
        share = k * T / 0.1
        expected = held * (1.0 - share) if share <= 1.0 else push * (share - 1.0) if share <= 2.0 else push * max(0.0, 3.0 - share)
        assert stopping.stop.effort == pytest.approx(expected if k < PUSH else 0.0, abs=1e-12), k


def test_what_the_drive_held_with_is_a_mean_of_what_it_held_with_in_quick_stop() -> None:
    stopping = Stopping(effort=3.0).to_swinging()
    stopping.ticks(SWING - 1)
    stopping.sample.effort[1] = 3.0 + 13.0
    stopping.tick()
    stopping.sample.effort[1] = NAN
    assert stopping.tick() == 15
    assert stopping.stop.effort == 4.0, "the first, and of each later one a thirteenth"
    other = Stopping(effort=3.0)
    other.tick(ENABLED)
    other.sample.statusword[1], other.sample.effort[1] = QUICK, 5.0
    other.until(lambda: other.stop.controlword == 15)
    assert other.stop.effort == 5.0, "before the quick stop it did not hold"


def test_an_axis_without_a_known_effort_is_taken_over_with_none() -> None:
    stopping = Stopping(effort=NAN).to_swinging()
    stopping.ticks(SWING + 1)
    assert stopping.stop.effort == 0.0
    stopping.tick(ENABLED)
    stopping.ticks(51)
    assert stopping.stop.effort == pytest.approx(-PUSHES * (51 * T / 0.1 - 1.0))


@pytest.mark.parametrize("late", [0, 1, 40])
def test_standstill_is_counted_from_the_last_motion(late: int) -> None:
    stopping = Stopping()
    for k in range(late):
        stopping.tick(motor=2 * k, link=2 * k)
    assert stopping.until(lambda: stopping.stop.controlword == 15) == STAND + 1 + SWING + 1 - (late > 0)


@pytest.mark.parametrize(("flicker", "stands"), [(1, True), (2, False)])
def test_a_held_position_may_flicker_by_a_count(flicker: int, stands: bool) -> None:
    stopping = Stopping()
    for k in range(90):
        stopping.tick(motor=flicker * (k % 2))
    assert (stopping.stop.controlword == 15) is stands


@pytest.mark.parametrize(("swing", "stands"), [(204, True), (205, False)])
def test_a_link_may_swing_by_a_tenth_of_the_tracking_error(swing: int, stands: bool) -> None:
    stopping = Stopping()
    for k in range(90):
        stopping.tick(link=swing * (k % 2))
    assert (stopping.stop.controlword == 15) is stands


def test_only_the_last_quarter_of_a_second_of_a_swing_counts() -> None:
    stopping = Stopping()
    stopping.tick(link=5000)
    stopping.tick(link=0)
    assert stopping.until(lambda: len(stopping.stop._steps) == 1) == SWING - 1


@pytest.mark.parametrize("open_", [True, None])
def test_a_brake_that_nobody_reports_closed_leaves_the_drive_holding_after_a_second(open_: bool | None) -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = open_ is True
    stopping.fresh = open_ is not None
    assert stopping.until(lambda: stopping.stop.rest is not None) == CLOSING
    reported = "its brake reports open" if open_ else "the I/O does not say whether its brake is closed"
    assert stopping.words == f"held by its drive: {reported} 1 s after it was told to close, it stands"
    assert stopping.stop.rest is not None
    assert (stopping.stop.rest.safe, stopping.stop.rest.held, stopping.steps) == (False, True, [("closing", CLOSING)])
    assert stopping.ticks(50) == [2] * 50
    stopping.stop.orders_brake = False
    stopping.stop.close_again()
    assert (stopping.stop.orders_brake, stopping.stop.rest) == (True, None)
    stopping.sample.brakes_open[1], stopping.fresh = False, True
    assert stopping.until(lambda: stopping.stop.controlword == 15) == 1 + SWING + 1


def test_an_axis_that_creeps_has_five_seconds_to_stand() -> None:
    stopping = Stopping()
    number = 0
    while stopping.stop.rest is None:
        number += 1
        stopping.tick(motor=number // 2 * 2, link=number // 2 * 2)
    assert number == SETTLING
    assert stopping.words == "not proven at rest: its drive is told to hold it and IT MOVES: it had not come to stand"
    stopping.ticks(SWING)
    assert stopping.words == "held by its drive: it had not come to stand", "then, but now it does"
    for _ in range(3):
        stopping.tick(motor=NAN, link=NAN)
    assert stopping.words == "held by its drive: it had not come to stand"
    stopping.tick()
    assert stopping.words.startswith("not proven at rest: its drive is told to hold it and nobody knows whether it moves: ")


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (ENABLED, "its drive does not obey the quick stop and may push: take its supply away"),
        (READY, "its drive reports ready to switch on, in which it holds nothing"),
        (REACTION, "its drive reports fault reaction active, after which it holds nothing"),
        (ODD, "its drive does not answer"),
        (-1, "its drive does not answer"),
    ],
)
def test_a_drive_that_does_not_hold_is_given_up_after_a_second(status: int, words: str) -> None:
    stopping = Stopping()
    stopping.sample.statusword[1] = status
    assert stopping.until(lambda: stopping.stop.rest is not None) == CLOSING
    assert stopping.words == f"not proven at rest: {words}; its brake reports closed; it stands"
    assert stopping.stop.rest is not None
    assert (stopping.stop.rest.safe, stopping.stop.rest.held, stopping.stop.controlword, stopping.stop.effort) == (False, False, 2, 0.0)
    bare = Stopping(braked=False)
    bare.sample.statusword[1] = status
    bare.until(lambda: bare.stop.rest is not None)
    assert bare.words == f"not proven at rest: {words}; the bench commands no brake of it; it stands"


@pytest.mark.parametrize(
    ("motor", "link", "words"),
    [
        (True, False, "its motor side shows motion, its link none"),  # another device sends its positions, or its coupling is off
        (True, True, "IT MOVES"),
        (False, True, "IT MOVES"),  # behind a gear that slips the motor side stands
    ],
)
def test_which_side_shows_motion_is_told(motor: bool, link: bool, words: str) -> None:
    stopping = Stopping()
    stopping.sample.statusword[1] = READY
    for at in range(CLOSING):
        stopping.tick(motor=at % 7 * 1000 * motor, link=at % 7 * 1000 * link)
    assert stopping.words.endswith(f"its brake reports closed; {words}") or stopping.words.endswith(f"its brake reports open; {words}")


def test_a_state_is_believed_for_as_long_as_lost_frames_are_bridged() -> None:
    stopping = Stopping().to_swinging()
    stopping.ticks(SWING - 5)
    stopping.stop.orders_brake = False
    assert stopping.ticks(3, -1) == [2] * 3
    assert not stopping.stop.orders_brake
    stopping.tick(-1)
    assert stopping.stop.orders_brake, "begun anew"


def test_a_drive_that_has_never_answered_is_not_taken_for_one_without_voltage() -> None:
    """Though frames may be lost for longer than the axis has stood."""
    stopping = Stopping(stale_ticks=40)
    assert stopping.ticks(30, -1) == [2] * 30


def test_frames_are_lost_from_the_last_that_came_whatever_it_said() -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = True
    stopping.ticks(CLOSING - 1, 0)
    stopping.tick(-1)
    assert stopping.words.startswith("not proven at rest: its drive reports not ready to switch on, in which it holds nothing; ")


@pytest.mark.parametrize("status", [OFF, FAULT])
def test_an_axis_that_is_found_without_voltage_is_watched_and_needs_no_proof(status: int) -> None:
    stopping = Stopping()
    assert stopping.ticks(STAND, status) == [2] * STAND
    assert stopping.ticks(1 + REST) == [0] * (1 + REST)
    assert stopping.words == "at rest: brake closed by its feedback, no voltage" + (", its drive in fault" if status == FAULT else "")
    assert stopping.stop.rest is not None
    assert stopping.stop.rest.safe
    assert stopping.steps == [("closing", STAND + 1), ("watching", REST)]
    bare = Stopping(braked=False)
    bare.ticks(STAND + 1 + WATCH, status)
    assert bare.words.startswith("at rest: it stands without a brake of the bench's, no voltage")


@pytest.mark.parametrize("what", ["moves", "opens"])
def test_an_axis_without_voltage_that_moves_or_whose_brake_opens_is_stopped_anew(what: str) -> None:
    stopping = Stopping()
    stopping.ticks(STAND + 2, OFF)
    stopping.stop.orders_brake = False
    if what == "opens":
        stopping.sample.brakes_open[1] = True
    stopping.tick(link=300 if what == "moves" else 0)
    assert (stopping.stop.orders_brake, stopping.stop.rest) == (True, None)


def test_an_axis_without_a_brake_is_let_go_when_it_stands() -> None:
    stopping = Stopping(braked=False).to_swinging()
    assert stopping.until(lambda: stopping.stop.controlword == 0) == SWING + 1
    stopping.ticks(WATCH - 1, OFF)
    assert stopping.words == "at rest: it stands without a brake of the bench's, voltage off"


def test_a_drive_in_another_mode_is_asked_for_torque_before_it_pushes() -> None:
    stopping = Stopping(takes_torque=False).to_swinging()
    assert stopping.until(lambda: stopping.stop.asks_for_torque) == SWING
    assert stopping.ticks(20) == [2] * 20
    stopping.stop.torque_mode(True)
    assert not stopping.stop.asks_for_torque
    assert stopping.tick() == 2
    assert stopping.tick() == 15
    refused = Stopping(takes_torque=False).to_swinging()
    refused.ticks(SWING)
    refused.stop.torque_mode(False)
    assert refused.words == "held by its drive: its drive does not change to torque mode, so nothing can push against its brake"
    refused.stop.orders_brake = False
    refused.stop.close_again()
    assert not refused.stop.orders_brake, "what cannot be proven is not tried again"


def test_the_communication_of_a_drive_that_answers_no_sync_is_stopped_once() -> None:
    stopping = Stopping()
    ordered = []
    for _ in range(4 * ANSWER):
        stopping.tick(-1)
        ordered.append(stopping.stop.orders_node)
        stopping.stop.orders_node = 0
    assert ordered == [0] * (ANSWER - 1) + [0x02] + [0] * (3 * ANSWER)


def test_a_drive_that_answers_in_time_is_left_to_talk() -> None:
    stopping = Stopping()
    stopping.ticks(ANSWER - 1, -1)
    stopping.ticks(ANSWER, QUICK)
    assert stopping.stop.orders_node == 0


def let_go() -> Stopping:
    """A drive that takes no effort has lost its voltage over a closed brake."""
    stopping = Stopping(pushes=False).to_swinging()
    assert stopping.ticks(SWING) == [2] * SWING
    assert stopping.tick() == 0
    stopping.tick(OFF)
    return stopping


def take_back(stopping: Stopping) -> None:
    """The axis moves when the voltage goes, and the drive takes it back."""
    stopping.slips(100.0 + stopping.sample.link_position[1] / COUNT, OFF)
    for status in (OFF, READY, SWITCHED_ON, ENABLED):
        stopping.tick(status)


def test_what_a_drive_without_effort_has_wound_up_against_its_brake_is_let_go_once() -> None:
    stopping = let_go()
    take_back(stopping)
    assert stopping.stop.rest is None
    stopping.to_swinging()
    stopping.ticks(SWING + 1, QUICK)
    stopping.ticks(REST, OFF)
    assert stopping.words == "at rest: brake closed by its feedback, not pushed: its drive takes no effort, voltage off"


def test_a_brake_that_slips_twice_is_held_by_its_drive() -> None:
    stopping = let_go()
    take_back(stopping)
    stopping.to_swinging()
    stopping.ticks(SWING + 1, QUICK)
    stopping.tick(OFF)
    take_back(stopping)
    assert ": its brake slips: its link moved by" in stopping.words


# ---- when it came to a standstill -----------------------------------------------------------------------
def creeps(stopping: Stopping, ticks: int, side: str = "both") -> None:
    """Let an axis go on by two counts a tick, more than a flicker."""
    for _ in range(ticks):
        motor, link = stopping.sample.position[1] / COUNT + 2.0, stopping.sample.link_position[1] / COUNT + 2.0
        stopping.tick(QUICK, motor=motor if side != "link" else None, link=link if side != "motor" else None)


def test_an_axis_that_comes_to_stand_in_its_hold_is_told_with_that_time() -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = True
    creeps(stopping, CLOSING + 100)
    assert stopping.words.endswith("it had not come to stand")
    stopping.ticks(500)
    stopping.sample.brakes_open[1] = False
    stopping.stop.close_again()
    stopping.until(lambda: stopping.stop.controlword == 15)
    stopping.sample.statusword[1] = ENABLED
    stopping.until(lambda: stopping.stop.controlword == 0)
    stopping.sample.statusword[1] = OFF
    stopping.until(lambda: stopping.stop.rest is not None)
    assert stopping.words == "at rest: brake proven, voltage off"
    assert stopping.stop.rest is not None
    assert stopping.stop.rest.stood_s / T == pytest.approx(CLOSING + 100, abs=1)


@pytest.mark.parametrize("ticks", [2, 4])
def test_ticks_that_were_missed_are_times_of_the_stop_like_others(ticks: int) -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = True
    for k in range(40):
        stopping.tick(QUICK, motor=3.0 * k, link=3.0 * k, ticks=ticks)
    for position in (NAN, 3.0 * 39, NAN, 3.0 * 39):
        stopping.tick(QUICK, motor=position, link=position, ticks=ticks)
    stopping.until(lambda: stopping.stop.rest is not None)
    assert stopping.stop.rest is not None
    assert stopping.stop.rest.stood_s / T == pytest.approx(40 * ticks, abs=ticks)


def test_an_axis_whose_motor_encoder_shows_nothing_has_stood_since_its_link_has() -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = True
    width = 0.1 * TRACKING / COUNT  # in which a link may swing that stands
    creeps(stopping, 300, side="link")
    stopping.until(lambda: stopping.stop.rest is not None and stopping.stop.rest.words.endswith("it stands"))
    assert stopping.stop.rest is not None
    assert 300 - width / 2.0 - 1 <= stopping.stop.rest.stood_s / T <= 300


def test_what_a_link_alone_may_have_moved_by_is_told_beside_that_none_was_seen() -> None:
    stopping = Stopping()
    stopping.sample.position[1] = NAN
    stopping.sample.brakes_open[1] = True
    creeps(stopping, 100, side="link")
    stopping.until(lambda: stopping.stop.rest is not None)
    rest = stopping.stop.rest
    assert rest is not None
    assert (rest.stood_s, rest.within) == (0.0, f"{0.1 * TRACKING:.1e} rad")
    assert 200 * COUNT < 0.1 * TRACKING


def test_an_axis_that_moves_once_more_has_stood_since_then() -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = True
    stopping.ticks(CLOSING + 50)
    assert stopping.stop.rest is not None
    assert stopping.stop.rest.stood_s == 0.0, "no encoder has shown motion"
    creeps(stopping, MOVED // 2)
    stopping.ticks(200)
    assert stopping.stop.rest.stood_s == 0.0, "that is less than counts as a motion"
    creeps(stopping, 20)
    stopping.ticks(200)
    assert stopping.stop.rest.stood_s / T == pytest.approx(CLOSING + 50 + MOVED // 2 + 200 + 20, abs=1)


def test_a_structure_that_swings_on_behind_a_motor_side_that_stands_is_no_motion_of_the_axis() -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = True
    creeps(stopping, 50)
    rested, width = stopping.sample.link_position[1] / COUNT, 0.1 * TRACKING / COUNT
    for k in range(400):
        stopping.tick(QUICK, link=rested + 1.5 * width * np.exp(-k / 100.0) * np.sin(0.1 * k))
    stopping.sample.brakes_open[1] = False
    stopping.until(lambda: stopping.stop.rest is not None)
    assert stopping.stop.rest is not None
    assert stopping.stop.rest.stood_s / T == pytest.approx(50, abs=1)
