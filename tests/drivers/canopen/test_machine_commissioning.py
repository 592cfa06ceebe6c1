"""Enabling, fault reset, brakes, the first move, homing: each step checks, and a check that fails leaves the machine at rest."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable

import numpy as np
import pytest
from machine_rig import RESOLUTION, ZERO, Rig
from scripted_nodes import PERIOD_S, ScriptedDrive

from drivers.errors import BusTimeoutError, DeviceFaultError, MotionRefusedError
from drivers.interface import Sample


@pytest.fixture
def rig() -> Rig:
    rig = Rig()
    rig.machine.start()
    return rig


def controlwords(rig: Rig, axis: int = 0) -> list[int]:
    words = [int.from_bytes(data[:2], "little") for data in rig.bus.sent(0x201 + axis)]
    return [word for k, word in enumerate(words) if k == 0 or word != words[k - 1]]


def test_enabling_walks_through_the_states_in_order(rig: Rig) -> None:
    rig.machine.enable()
    assert controlwords(rig) == [0x0000, 0x0006, 0x0007, 0x000F]
    assert [drive.power for drive in rig.drives] == ["operation enabled"] * 2
    assert [drive.value(0x6061) for drive in rig.drives] == [10, 10]


def test_a_drive_that_does_not_enable_is_named_with_its_state(rig: Rig) -> None:
    rig.drives[1].refuses_enable = True
    with pytest.raises(BusTimeoutError, match=r"not operation enabled within 2\.0 s: roll_drive is switched on"):
        rig.machine.enable()
    assert rig.at_rest()


def test_a_drive_that_keeps_another_mode_is_refused(rig: Rig) -> None:
    rig.drives[0].written = lambda *_: None
    with pytest.raises(MotionRefusedError, match=r"propeller_drive \(node 1\): stays in mode 0, mode 10 \(cyclic synchronous torque\)"):
        rig.machine.enable()


def test_a_fault_whose_cause_is_gone_is_reset_by_a_rising_edge_and_then_enabled_only_by_the_states(rig: Rig) -> None:
    drive = rig.drives[0]
    drive.fail(0x8130)
    drive.fault_cause = False
    rig.machine.exchange(ZERO)
    rig.bus.log.clear()
    rig.machine.enable()
    words = controlwords(rig)
    assert words[:3] == [0x0000, 0x0080, 0x0000]
    assert drive.power == "operation enabled"


def test_a_fault_that_a_reset_does_not_clear_is_told_with_its_cause(rig: Rig) -> None:
    rig.drives[1].fail(0x3220)
    rig.machine.exchange(ZERO)
    with pytest.raises(DeviceFaultError, match=r"roll_drive \(node 2\): fault .*EMCY 3220h: DC link undervoltage.* did not clear"):
        rig.machine.enable()
    assert rig.drives[0].power == "switch on disabled"  # nobody was enabled on the way


def test_without_an_emergency_the_error_code_object_explains_a_fault(rig: Rig) -> None:
    rig.drives[0].power, rig.drives[0].fault_cause = "fault", True
    rig.drives[0].set(0x603F, 0, 0x4310)
    rig.machine.exchange(ZERO)
    with pytest.raises(DeviceFaultError, match="error code 4310h: excess drive temperature"):
        rig.machine.enable()


@pytest.mark.parametrize(("switch", "words"), [("hold_to_run", "hold-to-run is not pressed"), ("door_closed", "the door is open")])
@pytest.mark.parametrize("method", ["enable", "home"])
def test_nothing_moves_without_permission(rig: Rig, switch: str, words: str, method: str) -> None:
    setattr(rig.io, switch, False)
    with pytest.raises(MotionRefusedError, match=words):
        getattr(rig.machine, method)()
    assert rig.at_rest()


TAKEN_BACK = {
    "hold_to_run": (lambda io: setattr(io, "hold_to_run", False), "hold-to-run is not pressed"),
    "door": (lambda io: setattr(io, "door_closed", False), "the door is open"),
    "silent io": (lambda io: setattr(io, "age_s", 0.51), r"the I/O has given no valid state for 0\.51 s, 0\.50 s are allowed"),
    "io never heard": (lambda io: setattr(io, "age_s", float("nan")), "the I/O has given no valid state"),
}


def take_back_when(rig: Rig, happens: Callable[..., object], take_back: Callable[..., object]) -> list[object]:
    """Take the permission back in the first tick in which something is so; the SYNCs on the bus by then are returned when asked."""
    synced, update, at = rig.bus.sent, rig.io.update, []

    def watch(sample: Sample) -> None:
        if not at and happens():
            at.append(len(synced(0x080)))
            take_back(rig.io)
        update(sample)

    rig.io.update = watch
    return at


@pytest.mark.slow
@pytest.mark.parametrize(("take_back", "words"), TAKEN_BACK.values(), ids=TAKEN_BACK.keys())
@pytest.mark.parametrize("stage", ["pushed", "homed", "held", "opening", "closing"])
def test_permission_taken_back_ends_every_procedure_in_the_same_tick(stage: str, take_back: Callable[..., object], words: str) -> None:
    rig = Rig(method=33)
    machine, drive = rig.machine, rig.drives[0]
    machine.start()
    if stage in ("pushed", "homed"):
        drive.homing_ticks, drive.friction = 400, 30.0
        pushing = stage == "pushed"
        happens = {
            "pushed": lambda: drive.brake_open and drive.value(0x6078) > 10,
            "homed": lambda: drive.brake_open and drive.value(0x6061) == 6 and drive.value(0x6040) == 0x1F,
        }[stage]
        at = take_back_when(rig, happens, take_back)
        with pytest.raises(MotionRefusedError, match=words):
            machine.home(check_first_move=pushing)
    else:
        machine.enable()
        if stage == "closing":
            machine.release_brakes(lambda _: ZERO)
        happens = {
            "held": lambda: True,
            "opening": lambda: any(rig.io._wanted.values()),
            "closing": lambda: not all(rig.io._wanted.values()),
        }
        at = take_back_when(rig, happens[stage], take_back)
        with pytest.raises(MotionRefusedError, match=words):
            (machine.close_brakes if stage == "closing" else machine.release_brakes)(lambda _: ZERO)
    words_sent = [int.from_bytes(data[:2], "little") for data in rig.bus.sent(0x201)]
    assert words_sent[at[0]] == 0x0002  # the very next frame is a quick stop
    if rig.io.age_s == 0.0:
        assert rig.at_rest()
    else:  # nobody knows of the brake, so no drive that had voltage loses it
        assert drive.power == "quick stop active"
        assert "held by its drive: the I/O does not say whether its brake is closed" in machine.outcome


def test_a_machine_without_io_needs_nobodys_permission() -> None:
    rig = Rig(io=False)
    rig.machine.start()
    rig.machine.sample.hold_to_run = rig.machine.sample.door_closed = False
    rig.machine.home(check_first_move=False)


def test_brakes_open_only_after_the_drives_hold(rig: Rig) -> None:
    rig.machine.enable()
    holding = np.array([0.5, -0.5])
    rig.drives[0].gravity, rig.drives[1].gravity = 100, -100  # per mille that the holding effort balances
    rig.bus.log.clear()
    rig.machine.release_brakes(lambda _: holding)
    held = rig.bus.sent(0x201)[: round(0.05 / PERIOD_S)]
    assert all(data[2:] == (100).to_bytes(2, "little") for data in held)
    assert rig.io.opened_at_sync >= len(held)
    assert all(drive.brake_open for drive in rig.drives)
    assert [drive.counts for drive in rig.drives] == [1000.0, 1000.0]


def test_a_brake_whose_feedback_does_not_follow_is_refused(rig: Rig) -> None:
    rig.machine.enable()
    rig.io.jammed = {"roll"}
    with pytest.raises(MotionRefusedError, match=r"brake of roll: not open within 1\.0 s"):
        rig.machine.release_brakes(lambda _: ZERO)
    assert rig.at_rest()


def test_brakes_of_a_silent_io_are_never_taken_for_closed(rig: Rig) -> None:
    rig.machine.enable()
    rig.machine.release_brakes(lambda _: ZERO)
    rig.io.age_s = 10.0
    with pytest.raises(MotionRefusedError, match=r"the I/O has given no valid state for 10\.00 s"):
        rig.machine.close_brakes(lambda _: ZERO)


def test_a_fault_of_any_node_ends_a_procedure(rig: Rig) -> None:
    rig.machine.enable()
    rig.encoders[0].emergency(0x5000)
    with pytest.raises(DeviceFaultError, match=r"propeller_encoder .*device hardware"):
        rig.machine.release_brakes(lambda _: ZERO)
    assert rig.at_rest()


def test_closing_the_brakes_is_the_way_back(rig: Rig) -> None:
    rig.machine.enable()
    rig.machine.release_brakes(lambda _: ZERO)
    rig.machine.close_brakes(lambda _: ZERO)
    assert rig.at_rest()
    assert rig.machine.stop_trouble == []


# ---- the first move


def test_homing_checks_each_axis_and_reports_what_it_saw(rig: Rig) -> None:
    lines = rig.machine.home()
    assert [line.split(":")[0] for line in lines] == ["propeller", "propeller", "roll", "roll"]
    assert "the right way" in lines[0]
    assert "differ by" in lines[1]
    assert rig.at_rest()


def test_only_the_axis_under_check_has_voltage_and_an_open_brake(rig: Rig) -> None:
    seen = set()
    original = ScriptedDrive.on_sync

    def watch(drive: ScriptedDrive) -> None:
        original(drive)
        seen.add(tuple((d.power == "operation enabled", d.brake_open) for d in rig.drives))

    ScriptedDrive.on_sync = watch
    try:
        rig.machine.home()
    finally:
        ScriptedDrive.on_sync = original
    assert not any((first[0] and second[0]) or (first[1] and second[1]) for first, second in seen)


def test_an_axis_that_moves_the_wrong_way_is_refused_after_the_least_travel(rig: Rig) -> None:
    rig.drives[0].direction = -1
    with pytest.raises(MotionRefusedError, match=r"propeller: moved -.* on a positive effort; motor wiring") as told:
        rig.machine.home()
    assert re.search(r"or a load that the file does not know outweighs \d\.\d\d% of the rated effort", str(told.value))
    assert rig.at_rest()
    assert abs(rig.drives[0].counts - 1000) * RESOLUTION < 4 * 3.5e-4


def test_an_axis_that_does_not_move_is_refused_and_never_pushed_harder_than_allowed(rig: Rig) -> None:
    rig.drives[0].friction = 1000
    rig.bus.log.clear()
    with pytest.raises(MotionRefusedError, match=r"propeller: moved \+0\.00e\+00 rad where 3\.50e-04 was expected within 2\.0 s at 0\.3"):
        rig.machine.home()
    targets = [int.from_bytes(data[2:], "little", signed=True) for data in rig.bus.sent(0x201)]
    assert max(targets) == 60  # 0.3 A of 5 A
    assert rig.at_rest()


def test_an_axis_that_falls_under_its_holding_effort_is_told_so_and_not_pushed(rig: Rig) -> None:
    rig.drives[0].gravity = 1
    with pytest.raises(MotionRefusedError, match=r"propeller: moves by -.* under its holding effort of 0 alone"):
        rig.machine.home()
    assert rig.at_rest()


def creeps(rig: Rig, ticks: int, counts: float) -> None:
    """Let the first axis move by so many counts in each of its first ticks with an open brake, and stand then."""
    drive, on_sync, left = rig.drives[0], rig.drives[0].on_sync, [counts] * ticks

    def creep() -> None:
        if drive.brake_open and left:
            drive.counts += left[-1]
            drive.link_counts += 13.65 * left.pop()
        on_sync()

    drive.on_sync = creep  # type: ignore[method-assign]


def test_dry_friction_that_bends_under_the_holding_effort_and_then_stands_is_no_wrong_effort(rig: Rig) -> None:
    creeps(rig, 50, 3.0)
    findings = rig.machine.home()
    assert "propeller: moved +" in findings[0]
    assert rig.at_rest()


def test_an_axis_that_creeps_on_under_its_holding_effort_is_not_pushed(rig: Rig) -> None:
    creeps(rig, 500, 3.0)
    with pytest.raises(MotionRefusedError, match=r"propeller: moves by \+.* under its holding effort of 0 alone; the hold"):
        rig.machine.home()
    assert rig.at_rest()


def test_an_axis_that_swings_on_is_told_to_come_to_rest_first(rig: Rig) -> None:
    looks = 27  # ticks from one look at it to the next, so that each sees it at the other end
    drive, on_sync, swing = rig.drives[0], rig.drives[0].on_sync, itertools.cycle([1] * looks + [-1] * looks)

    def swings() -> None:
        if drive.brake_open:
            drive.counts += 4.0 * next(swing)
        on_sync()

    drive.on_sync = swings  # type: ignore[method-assign]
    with pytest.raises(
        MotionRefusedError, match=r"propeller: 5 s after its brake opened it still moves by more than 3\.5e-04 rad in 0\.1 s; wait"
    ):
        rig.machine.home()
    assert rig.at_rest()


def test_a_holding_effort_that_balances_lets_the_check_pass(rig: Rig) -> None:
    rig.drives[0].gravity = 100
    rig.machine.home(np.array([0.5, 0.0]))
    assert rig.at_rest()


UNKNOWN_A = np.array([[-0.2, 1.0], [0.0, 0.0]])
"""By how much the load of the first axis may differ from its holding effort."""


def releases(rig: Rig) -> list[float]:
    """Return the efforts [A] with which the first axis's brake was opened, one after the other, as they will have been."""
    efforts, on_sync, drive = [], rig.drives[0].on_sync, rig.drives[0]
    before = [False]

    def watch() -> None:
        if drive.brake_open and not before[0]:
            efforts.append(round(5e-3 * int.from_bytes(drive.objects[0x6071, 0], "little", signed=True), 3))
        before[0] = drive.brake_open
        on_sync()

    drive.on_sync = watch  # type: ignore[method-assign]
    return efforts


def test_a_load_within_its_range_is_found_by_halving_it_each_time_after_a_stop_with_the_brake_proven(rig: Rig) -> None:
    rig.drives[0].gravity, rig.drives[0].friction = 90.0, 20.0  # 0.45 A; 0.1 A hold it where it stands
    opened = releases(rig)
    findings = rig.machine.home(load_between=UNKNOWN_A)
    assert opened == [0.0, 0.5]
    assert re.search(r"propeller: moved \+.*, the right way; what holds it is \+0\.5 beside the file's 0$", findings[0])
    np.testing.assert_allclose(rig.machine.found_load, [0.5, 0.0])
    assert rig.at_rest()


def test_a_load_beyond_its_range_is_refused_once_the_range_is_searched_or_does_not_tell(rig: Rig) -> None:
    rig.drives[0].gravity = 300.0  # 1.5 A
    opened = releases(rig)
    with pytest.raises(
        MotionRefusedError, match=r"propeller: moves by -.*; .* the load is not the 0% .*, which its effects change by -4% to \+20%"
    ):
        rig.machine.home(load_between=UNKNOWN_A)
    assert opened[0] == 0.0
    assert len(opened) <= 4
    assert rig.at_rest()


def test_a_load_beyond_its_range_that_more_effort_slows_is_not_blamed_on_the_motor(rig: Rig) -> None:
    rig.drives[0].gravity = 240.0  # 1.2 A
    opened = releases(rig)
    with pytest.raises(
        MotionRefusedError, match=r"propeller: moves by -.* effort of 0\.875 alone; the holding effort is wrong or not given, or the load"
    ):
        rig.machine.home(load_between=UNKNOWN_A)
    assert opened == [0.0, 0.5, 0.75, 0.875]
    assert rig.at_rest()


def test_an_effort_at_the_end_of_the_range_is_not_tried_twice(rig: Rig) -> None:
    rig.drives[0].gravity = -60.0
    opened = releases(rig)
    with pytest.raises(
        MotionRefusedError, match=r"propeller: moves by \+.* under its holding effort of 0 alone; .* change by \+0% to \+20%"
    ):
        rig.machine.home(load_between=np.maximum(UNKNOWN_A, 0.0))
    assert opened == [0.0]
    assert rig.at_rest()


def test_dry_friction_that_bends_at_the_end_of_the_range_and_then_stands_is_no_wrong_effort(rig: Rig) -> None:
    creeps(rig, 50, 3.0)
    opened = releases(rig)
    assert "propeller: moved +" in rig.machine.home(load_between=np.maximum(UNKNOWN_A, 0.0))[0]
    assert opened == [0.0]


def test_a_reversed_motor_that_a_load_moves_is_not_pushed_harder_than_once(rig: Rig) -> None:
    rig.drives[0].gravity, rig.drives[0].direction = 90.0, -1
    opened = releases(rig)
    with pytest.raises(
        MotionRefusedError, match=r"propeller: moves by -.* under its holding effort of 0\.5 alone; .* acts the other way .*sign, or"
    ):
        rig.machine.home(load_between=UNKNOWN_A)
    assert opened == [0.0, 0.5]
    assert rig.at_rest()


def test_a_load_that_friction_holds_is_pushed_by_as_much_more_as_the_file_lets_it_pull(rig: Rig) -> None:
    rig.drives[0].gravity, rig.drives[0].friction = 50.0, 55.0  # 0.25 A held by 0.275 A: it takes 0.525 A, the check's push is 0.3 A
    with pytest.raises(MotionRefusedError, match=r"where 3\.50e-04 was expected within 2\.0 s at 0\.3 above its holding effort"):
        rig.machine.home()
    rig.machine.start()
    rig.bus.log.clear()
    rig.machine.home(load_between=UNKNOWN_A)
    pushes = [int.from_bytes(data[2:], "little", signed=True) for data in rig.bus.sent(0x201)]
    assert 105 <= max(pushes) < 120, "twice the check's push, no more"
    assert rig.machine.found_load[0] == pytest.approx(0.225, abs=0.02), "what the push took beyond the check's is load"


def test_a_link_encoder_that_counts_backwards_is_found(rig: Rig) -> None:
    rig.encoders[1].direction = -1
    with pytest.raises(MotionRefusedError, match=r"roll: the motor side moved .* the link encoder counts the wrong way"):
        rig.machine.home()
    assert rig.at_rest()


def test_the_check_can_be_left_out_where_nothing_may_move(rig: Rig) -> None:
    rig.machine.home(check_first_move=False)
    assert [drive.counts for drive in rig.drives] == [0.0, 0.0]  # homed where they stood
    assert rig.io.history == []
