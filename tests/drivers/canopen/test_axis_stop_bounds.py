"""The stop of one axis tick by tick: what it orders, for how long it waits and what it says, with numbers that are exact."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import pytest
from scripted_nodes import machine_settings

from drivers.canopen.axis_stop import AxisStop
from drivers.interface import Sample
from drivers.settings import MotionLimits

T, COUNT, TRACKING = 2.0**-8, 2.0**-16, 2.0**-5
NAN = math.nan
QUICK, ENABLED, OFF, READY, SWITCHED_ON, REACTION, FAULT, ODD = 0x17, 0x37, 0x40, 0x31, 0x33, 0x1F, 0x18, 0x25
STAND, SWING, CLOSING, SETTLING, ANSWER, TORQUE, PUSH, WATCH, VOLTAGE, RETAKE, AT_MOST = 13, 32, 256, 1280, 8, 16, 77, 26, 52, 128, 2560
"""Ticks of each wait: its time in whole ticks, rounded up."""
PUSHES, MOVED = 0.25, 32  # A, and counts that are more than a brake may slip
SETTINGS = machine_settings()


class Stopping:
    """The stop of roll, the second of two axes, whose drive obeys in the next tick."""

    def __init__(self, *, braked: bool = True, takes_torque: bool = True, effort: float = 2.0, stale_ticks: int = 3) -> None:
        scaling = dataclasses.replace(SETTINGS.scalings[1], position_resolution=COUNT)
        homing = dataclasses.replace(SETTINGS.homings[1], direction_check_effort=PUSHES, direction_check_travel=MOVED * COUNT)
        limits = MotionLimits("roll", -1.0, 1.0, 0.25, TRACKING, stale_ticks)
        self.stop = AxisStop(1, scaling, limits, homing, T, braked=braked, takes_torque=takes_torque)
        self.sample = Sample(2)
        self.sample.brakes_open[:] = (True, False)
        self.sample.position[:] = self.sample.link_position[:] = 0.0
        self.sample.statusword[:] = (OFF, QUICK)
        self.sample.effort[:] = (9.0, effort)
        self.fresh = True

    def tick(self, status: int | None = None, *, motor: float | None = None, link: float | None = None) -> int:
        """Let one tick pass; positions in counts stay. Return the controlword that follows."""
        if status is not None:
            self.sample.statusword[1] = status
        if motor is not None:
            self.sample.position[1] = motor * COUNT
        if link is not None:
            self.sample.link_position[1] = link * COUNT
        self.stop.step(self.sample, io_is_fresh=self.fresh)
        return self.stop.controlword

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
    for k in range(60):
        stopping.tick(motor=flicker * (k % 2))
    assert (stopping.stop.controlword == 15) is stands


@pytest.mark.parametrize(("swing", "stands"), [(204, True), (205, False)])
def test_a_link_may_swing_by_a_tenth_of_the_tracking_error(swing: int, stands: bool) -> None:
    stopping = Stopping()
    for k in range(60):
        stopping.tick(link=swing * (k % 2))
    assert (stopping.stop.controlword == 15) is stands


def test_only_the_last_eighth_of_a_second_of_a_swing_counts() -> None:
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
    at = 0
    while stopping.stop.rest is None:
        at += 2
        stopping.tick(motor=at, link=at)
    assert at == 2 * SETTLING
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
    assert stopping.ticks(1 + WATCH) == [0] * (1 + WATCH)
    assert stopping.words == "at rest: brake closed by its feedback, no voltage" + (", its drive in fault" if status == FAULT else "")
    assert stopping.stop.rest is not None
    assert stopping.stop.rest.safe
    assert stopping.steps == [("closing", STAND + 1), ("watching", WATCH)]
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


def test_a_drive_that_stays_in_quick_stop_is_let_go_by_its_brakes_feedback() -> None:
    stopping = Stopping().to_swinging()
    stopping.ticks(SWING)
    assert stopping.ticks(TORQUE) == [15] * TORQUE
    assert stopping.tick() == 0
    stopping.ticks(WATCH - 1, OFF)
    assert (
        stopping.words == "at rest: brake closed by its feedback, not pushed: its drive does not leave quick stop for torque, voltage off"
    )


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("encoder", ["link", "motor"])
def test_a_brake_that_slips_under_the_push_is_told_and_not_tried_again(way: int, encoder: str) -> None:
    stopping = Stopping()
    if encoder == "motor":
        stopping.sample.link_position[1] = NAN
    stopping.to_pushing()
    assert stopping.tick(**{encoder: way * MOVED}) == 15, "so much is none"
    assert stopping.tick(**{encoder: way * (MOVED + 1)}) == 2
    name = "its link" if encoder == "link" else "its motor side"
    moved = f"{name} moved by {way * (MOVED + 1) * COUNT:+.1e} rad when the drive let go"
    assert stopping.stop.effort == 0.0
    assert stopping.words.endswith(f": its brake slips: {moved}")
    stopping.stop.orders_brake = False
    stopping.stop.close_again()
    assert not stopping.stop.orders_brake


def test_a_brake_that_slips_in_the_tick_in_which_its_drive_takes_over_is_not_pushed() -> None:
    stopping = Stopping().to_swinging()
    stopping.ticks(SWING + 1)
    assert stopping.tick(ENABLED, link=MOVED + 1) == 2
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
    for k in range(STAND + 1 + SWING):
        stopping.tick(link=100 * (-1) ** k)
    stopping.tick()
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
    assert stopping.tick(OFF, link=MOVED) == 0
    assert stopping.tick(link=MOVED + 1) == 0
    assert [stopping.tick(), stopping.tick(READY), stopping.tick(SWITCHED_ON)] == [6, 7, 15]
    assert stopping.stop.effort == 0.0
    assert stopping.tick(ENABLED) == 2
    assert stopping.words.endswith(f"its link moved by {(MOVED + 1) * COUNT:+.1e} rad when the voltage went; its brake reports closed")
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
    stopping.tick(link=MOVED + 1)
    assert stopping.stop.rest is not None
    stopping.stop.release()
    assert stopping.tick() == 0
    assert stopping.tick(OFF, link=9000) == 0
    assert stopping.ticks(WATCH - 2) == [0] * (WATCH - 2)
    assert stopping.words == "at rest: released by the operator, voltage off"


def test_only_the_last_eighth_of_a_second_counts_for_a_single_encoder_too() -> None:
    stopping = Stopping()
    stopping.sample.link_position[1] = NAN
    stopping.tick(motor=5000)
    stopping.tick(motor=0)
    assert stopping.until(lambda: len(stopping.stop._steps) == 1) == SWING - 1


def test_a_drive_that_is_not_ready_yet_has_no_voltage() -> None:
    stopping = Stopping()
    stopping.ticks(STAND + 1 + WATCH, 0)
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
    late.tick(link=MOVED + 1)
    assert late.words.endswith("when the drive let go")
