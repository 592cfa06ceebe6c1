"""The watch over the motion at its bounds, with numbers that floating point holds exactly, and in the words in which it tells."""

from __future__ import annotations

import dataclasses
import math

import pytest
from scripted_nodes import machine_settings

from drivers.canopen.motion_bounds import MotionWatch
from drivers.interface import Sample
from drivers.settings import HomingSettings, MotionLimits

PERIOD_S, COUNT = 2.0**-8, 2.0**-16
SPEED, TRACKING = 0.25, 2.0**-5  # 64 counts a tick, 2048 counts
NAN = math.nan
SETTINGS = machine_settings()
HOMING: HomingSettings = dataclasses.replace(SETTINGS.homings[0], method=17, speed=2.0**-4, travel_limit=2.0**-6)  # 16 a tick; 1024 counts


class Clock:
    """As many ticks are lost as a test says."""

    missed = 0


class Watched:
    """Roll beside a propeller that stands; positions in counts."""

    def __init__(self, *, link: bool = True) -> None:
        self.clock, self.sample = Clock(), Sample(2)
        scalings = [
            dataclasses.replace(scaling, position_resolution=COUNT, link_resolution=COUNT if link else 0.0) for scaling in SETTINGS.scalings
        ]
        limits = [MotionLimits(scaling.axis, -1.0, 1.0, SPEED, TRACKING, 3) for scaling in scalings]
        self.watch = MotionWatch(limits, scalings, self.clock, PERIOD_S)
        self.sample.position[0] = self.sample.link_position[0] = 0.0
        self.link = link

    def tick(self, motor: float, link: float | None = None, lost: int = 0) -> str:
        self.clock.missed += lost
        self.sample.position[1] = motor * COUNT
        self.sample.link_position[1] = (motor if link is None else link) * COUNT if self.link else NAN
        return self.watch.check(self.sample)


@pytest.mark.parametrize("way", [1, -1])
def test_a_led_axis_may_be_half_as_fast_again_as_its_limit_and_flicker(way: int) -> None:
    watched = Watched()
    watched.watch.lead()
    assert [watched.tick(way * 97 * k) for k in range(9)] == [""] * 9
    assert watched.tick(way * (97 * 8 + 98)) == (
        f"roll: motor side: moved by {way * 98 * COUNT:+.2e} rad at once while it was led; 0.375 rad/s is allowed"
    )
    link = Watched()
    link.watch.lead()
    assert [link.tick(0, 0), link.tick(0, way * 97)] == ["", ""]
    assert link.tick(0, -way).startswith(f"roll: link encoder: moved by {-way * 98 * COUNT:+.2e} rad at once")


def test_over_ticks_that_were_lost_or_without_a_position_an_axis_may_move_on() -> None:
    for lost, gaps, most in ((1, 0, 193), (2, 0, 289), (0, 1, 193), (0, 3, 385), (1, 1, 289)):
        for beyond, sound in ((0, True), (1, False)):
            watched = Watched()
            watched.watch.lead()
            watched.tick(0)
            for _ in range(gaps):
                assert watched.tick(NAN, NAN) == ""
            assert (watched.tick(most + beyond, lost=lost) == "") is sound
    watched = Watched()
    watched.clock.missed = 7
    watched.watch.lead()
    watched.tick(0)
    assert watched.tick(98) != "", "what was lost before does not count"
    back = Watched()
    back.clock.missed = 7
    back.watch.lead()
    back.tick(0)
    assert back.tick(97, lost=-7) == "", "a clock that starts again"


@pytest.mark.parametrize("phase", ["stand", "settle", "lead"])
def test_each_phase_counts_lost_ticks_from_its_begin(phase: str) -> None:
    watched = Watched()
    watched.watch.stand()
    watched.tick(0)
    watched.clock.missed = 5
    getattr(watched.watch, phase)()
    watched.tick(0)
    assert "at once" in watched.tick(98)


def test_positions_that_do_not_come_are_bridged_as_long_as_the_file_says() -> None:
    watched = Watched()
    watched.watch.lead()
    watched.tick(0)
    assert [watched.tick(NAN, 0) for _ in range(3)] == [""] * 3
    assert watched.tick(NAN, 0) == "roll: motor side: no position for 4 ticks, timing.stale_ticks bridges 3"
    led = Watched()
    led.watch.lead()
    led.tick(0)
    assert [led.tick(0, NAN) for _ in range(50)] == [""] * 50, "the loop judges a silent link itself"
    held = Watched()
    held.watch.stand()
    held.tick(0)
    assert [held.tick(0, NAN) for _ in range(4)] == [
        "",
        "",
        "",
        "roll: link encoder: no position for 4 ticks, timing.stale_ticks bridges 3",
    ]


@pytest.mark.parametrize("encoder", ["motor side", "link encoder"])
def test_an_encoder_that_answers_late_is_silent_from_its_last_late_answer_on(encoder: str) -> None:
    motor, link = (NAN, 0.0) if encoder == "motor side" else (0.0, NAN)
    watched = Watched()
    watched.watch.stand()
    watched.tick(0)
    late = watched.sample.position_late if encoder == "motor side" else watched.sample.link_late
    late[1] = True
    assert [watched.tick(motor, link) for _ in range(50)] == [""] * 50
    late[1] = False
    assert [watched.tick(motor, link) for _ in range(3)] == [
        "",
        "",
        f"roll: {encoder}: no position for 4 ticks, timing.stale_ticks bridges 3",
    ]


def test_over_ticks_that_nobody_answers_no_axis_is_silent_and_each_may_move_on() -> None:
    for beyond in (0, 1):
        watched = Watched()
        watched.watch.lead()
        watched.tick(0)
        watched.sample.unanswered = 1
        assert [watched.tick(NAN, NAN) for _ in range(9)] == [""] * 9
        watched.sample.unanswered = 0
        assert (watched.tick(96 * 10 + 1 + beyond) == "") is not bool(beyond)


@pytest.mark.parametrize("way", [1, -1])
def test_a_led_axis_whose_encoders_part(way: int) -> None:
    watched = Watched()
    watched.watch.lead()
    for at in range(0, 2049, 64):
        assert watched.tick(way * at, 0) == ""
    assert watched.tick(way * 2049, 0) == (
        f"roll: its motor side moved by {way * 2049 * COUNT:+.2e} rad, its link encoder by +0.00e+00 while it was led; they may differ by "
        "3.12e-02: one of them is frozen, counts the wrong way, or the gear between them slips"
    )
    watched.watch.lead()
    assert watched.tick(way * 2049, 0) == "", "each phase begins with what it sees"


@pytest.mark.parametrize("way", [1, -1])
def test_an_axis_that_should_stand(way: int) -> None:
    watched = Watched()
    watched.watch.stand()
    watched.tick(0)
    assert [watched.tick(way * at) for at in (65, 130, 195, 204)] == [""] * 4
    assert (
        watched.tick(way * 205) == f"roll: motor side: moved by {way * 205 * COUNT:+.2e} rad while it should stand; 3.13e-03 rad is allowed"
    )
    fast = Watched()
    fast.watch.stand()
    fast.tick(0)
    assert (
        fast.tick(way * 66)
        == f"roll: motor side: moved by {way * 66 * COUNT:+.2e} rad at once while it should stand; 0.25 rad/s is allowed"
    )
    apart = Watched()
    apart.watch.stand()
    apart.tick(0)
    assert [apart.tick(way * 65, -way * 65), apart.tick(way * 102, -way * 102)] == ["", ""]
    assert "they may differ by 3.13e-03" in apart.tick(way * 103, -way * 102)
    one = Watched(link=False)
    one.watch.stand()
    assert [one.tick(way * at) for at in (0, 65, 130, 195, 204)] == [""] * 5
    assert one.tick(way * 205) != ""


def test_an_axis_that_settles_may_swing_as_far_as_in_a_run() -> None:
    watched = Watched()
    watched.watch.settle()
    for at in range(0, 2049, 64):
        assert watched.tick(at) == ""
    assert "3.12e-02 rad is allowed" in watched.tick(2049)
    jumps = Watched()
    jumps.watch.settle()
    jumps.tick(0)
    assert jumps.tick(98).startswith("roll: motor side: moved by +1.50e-03 rad at once"), "its counter is nobody's to set"


@pytest.mark.parametrize("way", [1, -1])
def test_the_range_binds_the_link_always_and_the_motor_side_of_a_homed_axis(way: int) -> None:
    edge = 65536
    watched = Watched()
    watched.watch.lead()
    assert [watched.tick(way * at, way * at) for at in (edge, edge + 64)] == ["", ""], "nobody knows where it is"
    homed = Watched()
    homed.watch.homed(1)
    homed.watch.lead()
    assert homed.tick(way * edge, 0) == ""
    assert homed.tick(way * (edge + 1), 0) == f"roll: position {way * (1 + COUNT):.4f} rad is outside -1.0000 to 1.0000 rad"
    homed.watch.forget()
    assert homed.tick(way * (edge + 2), 0) == ""
    link = Watched()
    link.watch.lead()
    assert link.tick(0, way * (edge + 2048)) == "", "the load winds up the gear by as much as the tracking error"
    assert (
        link.tick(0, way * (edge + 2049)) == f"roll: link position {way * (1 + TRACKING + COUNT):.4f} rad is outside -1.0000 to 1.0000 rad"
    )
    assert link.tick(0, NAN) == ""


@pytest.mark.parametrize("axis", [0, 1, None])
def test_a_counter_that_is_to_be_set_may_jump_once(axis: int | None) -> None:
    watched = Watched()
    watched.watch.stand(sets_counter=axis)
    watched.tick(0)
    assert (watched.tick(5000, 0) == "") is (axis == 1)
    if axis == 1:
        assert watched.tick(5010, 0) == ""
        assert "at once" in watched.tick(0, 0)
        link = Watched()
        link.watch.stand(sets_counter=1)
        link.tick(0)
        assert "link encoder: moved" in link.tick(0, 5000)


def test_an_axis_that_homes() -> None:
    watched = Watched()
    watched.watch.home(1, HOMING)
    assert [watched.tick(33 * k) for k in range(5)] == [""] * 5
    assert watched.tick(5000, 132) == "", "its counter is set once"
    assert watched.tick(5034, 166) == (
        f"roll: motor side: moved by {34 * COUNT:+.2e} rad at once while it homed by method 17; 0.125 rad/s is allowed"
    )
    link = Watched()
    link.watch.home(1, HOMING)
    assert [link.tick(0), link.tick(33, 65), link.tick(66, 130)] == [""] * 3, "behind its gear it swings as fast as the axis may"
    assert "link encoder: moved by +1.01e-03 rad at once while it homed by method 17; 0.25 rad/s" in link.tick(99, 196)
    far = Watched()
    far.watch.home(1, HOMING)
    for at in range(0, 1025, 32):
        assert far.tick(at) == ""
    assert far.tick(1025) == (f"roll: motor side: moved by {1025 * COUNT:+.2e} rad while it homed by method 17; 1.56e-02 rad is allowed")
    out = Watched()
    out.watch.homed(1)
    out.watch.home(1, HOMING)
    assert out.tick(80000) == "", "nobody knows its range yet"


@pytest.mark.parametrize(("lost", "ticks"), [(0, 128), (1, 64)])
def test_an_axis_that_homes_and_does_not_move_is_told_after_half_a_second(lost: int, ticks: int) -> None:
    watched = Watched()
    watched.watch.home(1, HOMING)
    assert [watched.tick(0), watched.tick(2)] == ["", ""], "more than a flicker"
    assert [watched.tick(3 - k % 2, lost=lost) for k in range(ticks)] == [""] * ticks
    assert watched.tick(2, lost=lost) == (
        "roll: its motor side shows no motion for 0.5 s while it homed by method 17; brake, motor or encoder"
    )
    never = Watched()
    never.watch.home(1, HOMING)
    assert [never.tick(0, lost=lost) for _ in range(ticks)] == [""] * ticks
    assert never.tick(0, lost=lost).startswith("roll: its motor side shows no motion for 0.5 s")
    moving = Watched()
    moving.watch.home(1, HOMING)
    assert [moving.tick(k // 64) for k in range(640)] == [""] * 640, "a count from time to time"
    held = Watched()
    held.watch.stand()
    assert [held.tick(0) for _ in range(300)] == [""] * 300


def test_all_others_stand_while_one_homes() -> None:
    watched = Watched()
    watched.watch.home(0, HOMING)
    watched.tick(0)
    assert "roll: motor side: moved by +1.01e-03 rad at once while it should stand" in watched.tick(66)


def test_before_the_first_position_as_many_ticks_are_bridged() -> None:
    watched = Watched()
    watched.watch.stand()
    assert [watched.tick(NAN, 0) for _ in range(3)] == [""] * 3
    assert "no position for 4 ticks" in watched.tick(NAN, 0)


def test_a_step_at_the_very_speed_is_allowed() -> None:
    watched = Watched()
    half = [dataclasses.replace(scaling, position_resolution=2.0 * COUNT, link_resolution=0.0) for scaling in SETTINGS.scalings]
    limits = [MotionLimits(scaling.axis, -1.0, 1.0, SPEED, TRACKING, 3) for scaling in half]
    watched.watch = MotionWatch(limits, half, watched.clock, PERIOD_S)
    watched.watch.lead()
    assert [watched.tick(0), watched.tick(96 + 3)] == ["", ""]
    assert "at once" in watched.tick(96 + 3 + 100)


def test_every_axis_has_limits_a_scaling_and_readings() -> None:
    limits = [MotionLimits("roll", -1.0, 1.0, SPEED, TRACKING, 3)]
    with pytest.raises(ValueError, match="longer"):
        MotionWatch(limits, SETTINGS.scalings, Clock(), PERIOD_S)
    watched = Watched()
    watched.watch.lead()
    watched.sample = Sample(3)
    with pytest.raises(ValueError, match="longer"):
        watched.watch.check(watched.sample)
