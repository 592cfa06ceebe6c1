"""The proof of a brake tick by tick, and what follows where it fails: held, tried again, released, let go."""

from __future__ import annotations

import re

import pytest
from one_stop import (
    ANSWER,
    AT_MOST,
    CLOSING,
    COUNT,
    ENABLED,
    FAULT,
    MOVED,
    NAN,
    OFF,
    PUSH,
    PUSHES,
    QUICK,
    READY,
    REST,
    RETAKE,
    SETTINGS,
    SETTLING,
    STAND,
    SWING,
    SWITCHED_ON,
    TORQUE,
    TRACKING,
    VOLTAGE,
    WATCH,
    Stopping,
    T,
)

from drivers.canopen.brake_proof import BrakePush
from drivers.canopen.quick_stop import STANDING_SHARE


def test_a_drive_that_stays_in_quick_stop_is_let_go_by_its_brakes_feedback() -> None:
    stopping = Stopping().to_swinging()
    stopping.ticks(SWING)
    assert stopping.ticks(TORQUE) == [15] * TORQUE
    assert stopping.tick() == 0
    stopping.ticks(REST - 2, OFF)
    assert stopping.stop.rest is None, "a load that just exceeds a brake which nobody pushed takes long to show"
    stopping.tick()
    assert (
        stopping.words == "at rest: brake closed by its feedback, not pushed: its drive does not leave quick stop for torque, voltage off"
    )


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("linked", [True, False])
def test_a_brake_that_slips_under_the_push_is_told_and_not_tried_again(way: int, linked: bool) -> None:
    stopping = Stopping()
    if not linked:
        stopping.sample.link_position[1] = NAN
    stopping.to_pushing()
    counts = {"motor": 1, "link": 1} if linked else {"motor": 1}
    assert stopping.tick(**{side: way * MOVED for side in counts}) == 15, "so much is none"
    assert stopping.tick(**{side: way * (MOVED + 1) for side in counts}) == 2
    name = "its link" if linked else "its motor side"
    moved = f"{name} moved by {way * (MOVED + 1) * COUNT:+.1e} rad when the drive let go"
    assert stopping.stop.effort == 0.0
    assert stopping.words.endswith(f": its brake slips: {moved}")
    stopping.stop.orders_brake = False
    stopping.stop.close_again()
    assert not stopping.stop.orders_brake


@pytest.mark.parametrize(("gives", "proven"), [(1.0, True), (0.6, True), (0.4, False), (0.0, False), (-1.0, False)])
@pytest.mark.parametrize("held", [2.0, -2.0])
def test_a_push_that_the_drive_does_not_give_proves_no_brake(gives: float, proven: bool, held: float) -> None:
    stopping = Stopping(effort=held)
    stopping.gives = gives
    stopping.to_letting_go()
    stopping.ticks(WATCH, OFF)
    if not proven:
        assert stopping.stop.rest is None, "a load that just exceeds a brake which nobody pushed takes long to show"
        stopping.ticks(REST - WATCH, OFF)
    rated, asked = SETTINGS.scalings[1].rated, PUSHES + 0.25 * abs(held)
    words = re.fullmatch(
        r"at rest: brake closed by its feedback, not pushed: its drive gave (.*)% of its rated effort where (.*)% were asked, voltage off",
        stopping.words,
    )
    assert (stopping.words == "at rest: brake proven, voltage off") is proven
    if words is not None:
        assert float(words[1]) == pytest.approx(100.0 * max(gives, 0.0) * asked / rated, abs=1.0)
        assert float(words[2]) == pytest.approx(100.0 * asked / rated, abs=0.1)


def not_given(slew: float, off_by: float, held: float = 2.0) -> str:
    """What is said of a drive whose effort changes by at most that much a second, seen by a sensor that is off."""
    push, gives, k = BrakePush(0.3, held, 5.0), held, 0
    while not push.is_over(k * T):
        gives += max(-slew * T, min(slew * T, push.effort(k * T) - gives))
        push.take(k * T, gives + off_by)
        k += 1
    return push.not_given


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_drive_that_lets_go_late_has_not_pushed(way: float) -> None:
    said = re.fullmatch(r"its drive gave (.*)% of its rated effort where 16.0% were asked", not_given(5.0, 0.0, 2.0 * way))
    assert said is not None
    assert float(said[1]) == pytest.approx(-10.0, abs=2.0), "it carries half an ampere still"
    assert not_given(8.0, 0.0, 2.0 * way), "nothing is carried, and nothing is pushed"


@pytest.mark.parametrize("off_by", [0.0, 0.3, -0.3])
@pytest.mark.parametrize("held", [2.0, -2.0, 0.0])
def test_a_sound_drive_whose_sensor_is_off_has_pushed(off_by: float, held: float) -> None:
    assert not_given(100.0, off_by / 0.8 * (0.3 + 0.25 * abs(held)), held) == ""


def test_a_drive_that_measures_no_effort_is_believed_its_push() -> None:
    stopping = Stopping(effort=NAN).to_letting_go()
    stopping.ticks(WATCH, OFF)
    assert stopping.words == "at rest: brake proven, voltage off"


@pytest.mark.parametrize("side", ["motor", "link"])
@pytest.mark.parametrize("way", [1, -1])
def test_one_side_alone_swings_by_as_much_as_a_standing_axis_may_and_its_brake_is_not_accused(side: str, way: int) -> None:
    stopping = Stopping().to_pushing()
    most = int(STANDING_SHARE * TRACKING / COUNT)
    for k in range(40):
        assert stopping.tick(**{side: way * most * (-1) ** k}) == 15
    assert stopping.tick(**{side: way * (most + 1)}) == 2
    name = {"link": "its link", "motor": "its motor side"}[side]
    assert f": {name} alone moved by {way * (most + 1) * COUNT:+.1e} rad" in stopping.words
    assert "slips" not in stopping.words


def test_sides_that_move_apart_do_not_slip() -> None:
    stopping = Stopping().to_pushing()
    assert stopping.tick(motor=3 * MOVED, link=-3 * MOVED) == 15


def test_a_brake_that_slips_in_the_tick_in_which_its_drive_takes_over_is_not_pushed() -> None:
    stopping = Stopping().to_swinging()
    stopping.ticks(SWING + 1)
    assert stopping.slips(MOVED + 1, ENABLED) == 2
    assert stopping.ticks(3, QUICK) == [2] * 3
    assert stopping.stop.effort == 0.0
    assert stopping.steps == [("closing", STAND + 1), ("swinging", SWING), ("taking over", 2)]


def test_a_proof_that_begins_anew_elsewhere_does_not_compare_with_where_it_was() -> None:
    stopping = Stopping().to_pushing()
    stopping.tick(OFF, link=10 * MOVED, motor=10 * MOVED)
    stopping.sample.statusword[1] = QUICK
    stopping.until(lambda: stopping.stop.controlword == 15)
    assert stopping.stop.rest is None


def test_how_far_a_link_swung_before_is_no_slip() -> None:
    stopping = Stopping()
    stopping.sample.position[1] = NAN
    for k in range(STAND + 1 + SWING):
        stopping.tick(link=100 * (-1) ** k)
    while stopping.stop.controlword == 2:
        stopping.tick(link=100)
    stopping.tick(ENABLED)
    assert stopping.tick(link=100 + MOVED) == 15
    assert stopping.tick(link=-100 - MOVED) == 15
    assert stopping.tick(link=-100 - MOVED - 1) == 2


@pytest.mark.parametrize("phase", ["swinging", "taking over", "pushing"])
@pytest.mark.parametrize("what", ["brake opens", "brake unknown", "drive off"])
def test_a_proof_whose_brake_opens_or_whose_drive_lets_go_begins_anew(phase: str, what: str) -> None:
    stopping = Stopping().to_swinging()
    stopping.ticks({"swinging": 5, "taking over": SWING + 1, "pushing": SWING + 1}[phase])
    if phase == "pushing":
        stopping.ticks(10, ENABLED)
    stopping.stop.orders_brake = False
    if what == "brake opens":
        stopping.sample.brakes_open[1] = True
    stopping.fresh = what != "brake unknown"
    stopping.tick(OFF if what == "drive off" else None)
    assert (stopping.stop.orders_brake, stopping.stop.rest) == (True, None)
    assert stopping.tick() == (0 if what == "drive off" else 2)


def test_an_axis_whose_position_is_lost_is_held_unproven_and_tried_again() -> None:
    stopping = Stopping().to_pushing()
    for _ in range(3):
        assert stopping.tick(motor=NAN, link=NAN) == 15
    assert stopping.tick() == 2
    assert stopping.words == (
        "not proven at rest: its drive is told to hold it and nobody knows whether it moves: "
        "its position is not known, so its brake cannot be proven"
    )
    stopping.stop.orders_brake = False
    stopping.stop.close_again()
    assert stopping.stop.orders_brake


def test_a_link_that_falls_when_the_voltage_goes_is_taken_back_at_once() -> None:
    stopping = Stopping().to_letting_go()
    assert stopping.slips(MOVED, OFF) == 0
    assert stopping.slips(MOVED + 1) == 0
    assert [stopping.tick(), stopping.tick(READY), stopping.tick(SWITCHED_ON)] == [6, 7, 15]
    assert stopping.stop.effort == 0.0
    assert stopping.tick(ENABLED) == 2
    moved = f"its link moved by {(MOVED + 1) * COUNT:+.1e} rad"
    assert stopping.words.endswith(f": its brake slips: {moved} when the voltage went; its brake reports closed")
    lost = Stopping().to_letting_go()
    lost.tick(OFF, link=1000)
    assert lost.until(lambda: lost.stop.rest is not None) == RETAKE
    assert lost.words.startswith(
        "not proven at rest: its drive reports switch on disabled, in which it holds nothing; its brake reports closed; "
    )
    fault = Stopping().to_letting_go()
    fault.tick(OFF, link=1000)
    fault.tick(FAULT)
    assert fault.words.startswith("not proven at rest: its drive reports fault, in which it holds nothing")


def test_a_drive_that_keeps_its_voltage_is_told() -> None:
    stopping = Stopping().to_letting_go()
    stopping.sample.statusword[1] = SWITCHED_ON
    assert stopping.until(lambda: stopping.stop.rest is not None) == VOLTAGE - 1
    assert stopping.words == "not proven at rest: its drive keeps its voltage (switched on); its brake reports closed"
    assert stopping.stop.rest is not None
    assert not stopping.stop.rest.safe


def test_an_operator_who_releases_a_held_axis_has_it_let_go_whatever_it_does() -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = True
    stopping.stop.release()
    assert stopping.until(lambda: stopping.stop.rest is not None) == CLOSING, "what is not held is not released"
    stopping.stop.release()
    assert stopping.stop.rest is None
    assert stopping.tick() == 0
    assert stopping.tick(OFF, link=5000) == 0
    stopping.ticks(WATCH)
    assert stopping.stop.rest is not None
    assert stopping.words == "at rest: released by the operator, voltage off"


def test_a_held_drive_that_lets_go_is_stopped_anew_after_its_time_to_answer() -> None:
    stopping = Stopping()
    stopping.sample.brakes_open[1] = True
    stopping.until(lambda: stopping.stop.rest is not None)
    stopping.stop.orders_brake = False
    assert stopping.ticks(ANSWER - 1, ENABLED) == [2] * (ANSWER - 1)
    assert not stopping.stop.orders_brake
    stopping.tick()
    assert (stopping.stop.orders_brake, stopping.stop.rest) == (True, None)


def test_a_motion_that_has_ended_by_itself_is_proven_from_where_it_is() -> None:
    stopping = Stopping()
    stopping.stop.prove(1.5)
    assert (stopping.stop.controlword, stopping.stop.effort, stopping.stop.orders_brake) == (15, 1.5, False)
    assert stopping.ticks(SWING, ENABLED) == [15] * SWING
    assert stopping.stop.effort == 1.5
    stopping.tick()
    assert stopping.stop.effort == 1.5
    bare = Stopping(braked=False)
    bare.stop.prove(1.5)
    assert (bare.stop.controlword, bare.stop.effort, bare.stop.orders_brake) == (2, 0.0, True)


def test_a_feedback_that_flickers_does_not_keep_a_stop_from_ending() -> None:
    stopping = Stopping()
    number = 0
    while stopping.stop.rest is None:
        number += 1
        stopping.sample.brakes_open[1] = number % 40 == 0
        stopping.tick()
    assert AT_MOST < number <= AT_MOST + SETTLING + 1
    assert stopping.words.startswith("held by its drive: ")


def test_a_proof_for_which_nobody_answers_is_given_up_after_ten_seconds() -> None:
    stopping = Stopping(takes_torque=False).to_swinging()
    stopping.stop.orders_brake = False
    assert stopping.until(lambda: stopping.stop.orders_brake) == AT_MOST + 1 - (STAND + 1)
    assert stopping.until(lambda: stopping.stop.rest is not None) == SETTLING
    assert stopping.words == "held by its drive: it stands"


def test_an_axis_that_slipped_and_is_released_is_not_taken_back() -> None:
    stopping = Stopping().to_pushing()
    stopping.slips(MOVED + 1)
    assert stopping.stop.rest is not None
    stopping.stop.release()
    assert stopping.tick(QUICK) == 2, "an axis that moves is not released"
    stopping.ticks(SWING)
    stopping.stop.release()
    assert stopping.tick() == 0
    assert stopping.tick(OFF, link=9000) == 0
    assert stopping.ticks(WATCH - 2) == [0] * (WATCH - 2)
    assert stopping.words == "at rest: released by the operator, voltage off"


def test_only_the_last_quarter_of_a_second_counts_for_a_single_encoder_too() -> None:
    stopping = Stopping()
    stopping.sample.link_position[1] = NAN
    stopping.tick(motor=5000)
    stopping.tick(motor=0)
    assert stopping.until(lambda: len(stopping.stop._steps) == 1) == SWING - 1


def test_a_drive_that_is_not_ready_yet_has_no_voltage() -> None:
    stopping = Stopping()
    stopping.ticks(STAND + 1 + REST, 0)
    assert stopping.words == "at rest: brake closed by its feedback, no voltage"


def test_an_axis_that_is_let_go_is_safe_where_it_stands_or_its_brake_is_closed() -> None:
    for braked, moves, safe in ((True, True, True), (True, False, True), (False, False, True), (False, True, False)):
        stopping = Stopping(braked=braked)
        if braked:
            stopping.to_letting_go()
        else:
            stopping.to_swinging().ticks(SWING + 1)
        assert stopping.stop.effort == 0.0
        for k in range(WATCH):
            stopping.tick(OFF, motor=2 * k if moves else 0)
        assert stopping.stop.rest is not None
        assert stopping.stop.rest.safe is safe, (braked, moves)


def test_a_drive_that_keeps_its_voltage_is_not_safe() -> None:
    stopping = Stopping().to_letting_go()
    stopping.sample.statusword[1] = SWITCHED_ON
    stopping.until(lambda: stopping.stop.rest is not None)
    assert stopping.stop.rest is not None
    assert stopping.stop.rest.safe is False


@pytest.mark.parametrize("silent", [3, 4])
def test_a_link_encoder_that_falls_silent_during_the_proof_leaves_the_drive_holding(silent: int) -> None:
    """Until then the link was judged; where the motor side stood before nobody has marked."""
    stopping = Stopping().to_pushing()
    stopping.ticks(10)
    for _ in range(silent - 1):
        assert stopping.tick(link=NAN) == 15
    stopping.tick(link=NAN, motor=20)
    assert stopping.stop.controlword == (2 if silent > 3 else 15)
    if silent > 3:
        assert stopping.words.endswith(": its position is not known, so its brake cannot be proven")
        stopping.stop.close_again()
        stopping.sample.statusword[1] = QUICK
        assert stopping.until(lambda: stopping.stop.controlword == 15) > SWING, "and then it is proven by the motor side"
    else:
        assert [stopping.tick(link=0), stopping.tick(link=NAN), stopping.tick(), stopping.tick()] == [15] * 4, "a packet is enough"


def test_a_link_encoder_that_speaks_first_during_the_proof_was_not_seen_before_it() -> None:
    stopping = Stopping()
    stopping.sample.link_position[1] = NAN
    stopping.to_pushing()
    assert stopping.tick(link=5000) == 2
    assert stopping.words.endswith(": its position is not known, so its brake cannot be proven")


def test_a_drive_that_loses_its_hold_in_quick_stop_has_no_torque_told() -> None:
    stopping = Stopping().to_pushing()
    stopping.ticks(60)
    assert stopping.stop.effort != 0.0
    stopping.sample.brakes_open[1] = True
    stopping.tick()
    stopping.tick()
    assert (stopping.stop.controlword, stopping.stop.effort) == (2, 0.0)


def test_a_proof_that_fails_in_its_last_tick_has_failed() -> None:
    stopping = Stopping().to_swinging()
    stopping.ticks(SWING - 1)
    stopping.sample.brakes_open[1] = True
    stopping.tick()
    assert stopping.tick() == 2
    late = Stopping().to_pushing()
    late.ticks(PUSH - 1)
    late.slips(MOVED + 1)
    assert late.words.endswith("when the drive let go")
