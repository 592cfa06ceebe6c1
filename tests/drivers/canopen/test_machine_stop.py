"""A stop works from every state, and takes no voltage from a drive before its axis is held."""

from __future__ import annotations

import re
import struct

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from machine_rig import ZERO, Rig
from scripted_nodes import PERIOD_S, ScriptedDrive

from drivers.errors import KEEP_AWAY, MotionRefusedError


@pytest.fixture
def rig() -> Rig:
    return Rig()


@pytest.mark.parametrize("stage", ["started", "enabled", "released", "faulted", "stopped"])
def test_stop_works_from_every_state_and_again(rig: Rig, stage: str) -> None:
    machine = rig.machine
    machine.start()
    if stage in ("enabled", "released", "faulted"):
        machine.enable()
    if stage in ("released", "faulted"):
        machine.release_brakes(lambda _: ZERO)
    if stage == "faulted":
        rig.drives[0].fail(0x3210)
    if stage == "stopped":
        machine.stop()
    for _ in range(2):
        machine.stop()
        assert rig.at_rest()
        assert machine.stop_trouble == []
    assert all(node.state == 0x7F for node in rig.bus.nodes)


def words_to(rig: Rig, drive: int) -> list[int]:
    """Controlwords to a drive, each once per run of equal ones."""
    words = [struct.unpack_from("<H", data)[0] for data in rig.bus.sent(0x201 + drive)]
    return [word for k, word in enumerate(words) if k == 0 or word != words[k - 1]]


def test_stop_orders_quick_stop_then_proof_then_voltage_off_and_waits_for_the_brakes_before_the_proof(rig: Rig) -> None:
    rig.ready()
    rig.bus.log.clear()
    rig.io.delay_polls = 100
    rig.machine.stop()
    assert words_to(rig, 0) == [0x0002, 0x000F, 0x0000]
    words = [struct.unpack_from("<H", data)[0] for data in rig.bus.sent(0x201)]
    assert words.index(0x000F) > 100
    assert rig.machine.outcome == "the motors were stopped: propeller, roll at rest: brake proven, voltage off"


def test_no_drive_loses_its_voltage_during_a_stop_before_its_brake_has_closed(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.ready()
    rig.io.delay_polls = 20  # brakes take longer than the drives' standstill
    seen = []
    original = ScriptedDrive.on_sync

    def watch(drive: ScriptedDrive) -> None:
        original(drive)
        seen.append((drive.power, drive.brake_open))

    monkeypatch.setattr(ScriptedDrive, "on_sync", watch)
    rig.machine.stop()
    assert seen.count(("quick stop active", True)) > 20
    assert seen[-1] == ("switch on disabled", False)
    assert ("switch on disabled", True) not in seen


def quick_stop_of_a_turning_axis(ramp: float, monkeypatch: pytest.MonkeyPatch) -> tuple[list[tuple[str, float]], float]:
    """One axis without a brake turns by 20 counts a tick and is stopped: its (power, speed) tick by tick, and how long the stop took."""
    rig = Rig(io=False)
    rig.machine.start()
    rig.machine.enable()
    drive = rig.drives[0]
    drive.brake_open, drive.speed, drive.ramp = True, 20.0, ramp
    seen = []
    original = ScriptedDrive.on_sync

    def watch(node: ScriptedDrive) -> None:
        original(node)
        if node is drive:
            seen.append((node.power, node.speed))

    monkeypatch.setattr(ScriptedDrive, "on_sync", watch)
    start = rig.bus.time_s
    rig.machine.stop()
    assert [d.power for d in rig.drives] == ["switch on disabled"] * 2
    return seen, rig.bus.time_s - start


def test_an_axis_without_a_brake_keeps_its_voltage_until_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, seconds = quick_stop_of_a_turning_axis(1.0, monkeypatch)
    assert all(speed == 0.0 for power, speed in seen if power == "switch on disabled")
    assert seen.count(("quick stop active", 0.0)) > 0.05 / PERIOD_S
    assert seconds < 0.5


def test_an_axis_without_a_brake_that_never_stands_is_not_held_and_that_is_said() -> None:
    rig = Rig(io=False)
    rig.machine.start()
    rig.machine.enable()
    rig.drives[0].brake_open, rig.drives[0].speed = True, 20.0
    rig.machine.stop()
    assert rig.drives[0].power == "switch on disabled"
    assert re.fullmatch(
        "KEEP AWAY, PRESS THE EMERGENCY STOP: propeller not proven at rest: its drive did not hold it, its motor side is .* are allowed, "
        "voltage off; the bench commands no brake of it; IT MOVES; roll at rest: it stands without a brake of the bench's, voltage off",
        rig.machine.outcome,
    )


def test_an_axis_without_a_brake_whose_position_is_lost_is_not_taken_for_standing(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(io=False)
    rig.machine.start()
    rig.machine.enable()
    rig.drives[0].mute_pdo = rig.encoders[0].mute_pdo = True
    rig.machine.stop()
    assert (
        "propeller not proven at rest: its drive does not answer (its node is stopped); the bench commands no brake of it; nobody"
        in rig.machine.outcome
    )


LOAD = 100.0
"""Per mille of rated torque that gravity takes: without a brake the scripted axis falls by 0.5 mrad within three ticks."""


@pytest.fixture
def loaded() -> Rig:
    """Both axes held by their drives against gravity, brakes open."""
    rig = Rig()
    for drive in rig.drives:
        drive.ramp = 1e9  # its velocity loop stops and holds
    rig.machine.start()
    rig.machine.enable()
    for drive in rig.drives:
        drive.gravity = LOAD
    held = np.full(2, 0.5)  # A of 5 A rated: what gravity takes
    rig.machine.release_brakes(lambda _: held)
    rig.bus.log.clear()
    return rig


def fallen(rig: Rig, drive: int = 1) -> float:
    """How far an axis has gone from where it was homed [rad]."""
    return abs(rig.drives[drive].counts - 1000.0) * rig.settings.scalings[drive].position_resolution


def test_a_terminal_that_is_gone_does_not_keep_a_stop_from_its_end(loaded: Rig) -> None:
    def fail() -> None:
        raise OSError("the terminal is gone")

    loaded.io.jammed, loaded.attendant.on_say = {"roll"}, fail
    loaded.machine.stop()
    assert "holding: the terminal is gone" in loaded.machine.stop_trouble
    assert "roll held by its drive" in loaded.machine.outcome


@pytest.mark.parametrize("how", ["stop", "end of a motion"])
def test_a_brake_that_reports_closed_and_does_not_hold_is_found_before_the_voltage_goes(loaded: Rig, how: str) -> None:
    loaded.io.jammed, loaded.io.lies = {"roll"}, {"roll"}
    if how == "stop":
        loaded.machine.stop()
    else:
        with pytest.raises(MotionRefusedError, match=r"^roll held by its drive: its brake slips: its link moved by"):
            loaded.machine.close_brakes(lambda _: np.full(2, 0.5))
    assert [drive.power for drive in loaded.drives] == ["switch on disabled", "quick stop active"]
    assert 0x0000 not in words_to(loaded, 1)
    assert fallen(loaded) < 0.02
    assert "roll held by its drive: its brake slips" in loaded.machine.outcome
    assert len(loaded.attendant.said) == 1


def test_a_link_encoder_that_is_frozen_does_not_prove_a_brake_that_slips(loaded: Rig) -> None:
    loaded.io.jammed, loaded.io.lies = {"roll"}, {"roll"}
    loaded.encoders[1].direction = 0  # shows one position for ever
    loaded.machine.stop()
    assert loaded.drives[1].power == "quick stop active"
    assert 0x0000 not in words_to(loaded, 1)
    assert "roll held by its drive: its motor side alone moved by" in loaded.machine.outcome


@pytest.mark.parametrize("stage", ["jammed", "silent I/O"])
def test_a_brake_that_nobody_reports_closed_leaves_the_drive_holding(loaded: Rig, stage: str) -> None:
    if stage == "jammed":
        loaded.io.jammed = {"roll"}
    else:
        loaded.io.age_s = 10.0
    loaded.machine.stop()
    loaded.machine.close()
    assert loaded.drives[1].power == "quick stop active"
    assert 0x0000 not in words_to(loaded, 1)
    assert fallen(loaded) < 1e-4
    said = "its brake reports open" if stage == "jammed" else "the I/O does not say whether its brake is closed"
    assert f"held by its drive: {said} 1 s after it was told to close, it stands" in loaded.machine.outcome
    resets = {data[1] for data in loaded.bus.sent(0x000) if data[0] in (0x80, 0x82)}
    assert 2 not in resets, "a node that holds an axis is left alone"


def test_a_brake_that_closes_late_is_proven_late_and_the_hold_ends(loaded: Rig) -> None:
    loaded.io.jammed = {"roll"}
    loaded.attendant.seconds = 60.0
    loaded.attendant.on_say = loaded.io.jammed.clear
    loaded.machine.stop()
    assert loaded.at_rest()
    assert loaded.machine.outcome == "the motors were stopped: propeller, roll at rest: brake proven, voltage off"
    assert len(loaded.attendant.said) == 2, "that it is held, and that it is no more"


def test_an_operator_who_has_supported_the_axis_ends_the_hold(loaded: Rig) -> None:
    loaded.io.jammed = {"roll"}
    loaded.attendant.seconds = 60.0
    loaded.attendant.on_say = lambda: setattr(loaded.attendant, "confirms", ["roll"])
    loaded.machine.stop()
    assert loaded.drives[1].power == "switch on disabled"
    assert "roll at rest: released by the operator, voltage off" in loaded.machine.outcome or "roll not" in loaded.machine.outcome


def test_a_drive_without_transition_16_is_let_go_by_its_brakes_feedback_and_that_is_said(loaded: Rig) -> None:
    loaded.drives[1].resumes = False
    loaded.machine.stop()
    assert loaded.at_rest()
    assert "roll at rest: brake closed by its feedback, not pushed: its drive does not leave quick stop" in loaded.machine.outcome


def test_a_voltage_that_went_is_taken_back_when_the_axis_falls(loaded: Rig) -> None:
    loaded.drives[1].resumes = False
    loaded.io.jammed, loaded.io.lies = {"roll"}, {"roll"}
    loaded.machine.stop()
    assert loaded.drives[1].power == "quick stop active"
    assert "roll held by its drive: its brake slips: its link moved by" in loaded.machine.outcome
    assert fallen(loaded) < 0.06


def test_a_drive_in_fault_holds_nothing_and_what_is_known_of_the_brake_is_said(loaded: Rig) -> None:
    loaded.drives[1].fail(0x3210)
    loaded.machine.stop()
    assert "roll at rest: brake closed by its feedback, no voltage, its drive in fault" in loaded.machine.outcome


def test_a_drive_in_fault_with_a_jammed_brake_moves_and_nothing_else_is_said(loaded: Rig) -> None:
    loaded.io.jammed = {"roll"}
    loaded.drives[1].fail(0x3210)
    loaded.machine.stop()
    assert (
        "roll not proven at rest: its drive reports fault, in which it holds nothing; its brake reports open; IT MOVES"
        in loaded.machine.outcome
    )
    assert "were stopped" not in loaded.machine.outcome


def test_a_drive_that_does_not_obey_is_not_said_to_be_stopped(loaded: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loaded.drives[1], "_transition", lambda word: None)
    loaded.machine.stop()
    assert "roll not proven at rest: its drive does not obey the quick stop and may push" in loaded.machine.outcome


def test_a_bench_that_finds_a_drive_holding_proves_the_brake_before_anything_else(loaded: Rig) -> None:
    loaded.io.jammed = {"roll"}
    loaded.machine.stop()
    loaded.machine.close()
    loaded.bus.log.clear()
    with pytest.raises(MotionRefusedError, match="found under voltage at the start, and roll held by its drive: its brake reports open"):
        loaded.machine.start()
    assert 0x0000 not in words_to(loaded, 1)
    loaded.machine.close()
    loaded.io.jammed.clear()
    loaded.machine.start()
    loaded.machine.close()
    assert loaded.at_rest()
    assert fallen(loaded) < 1e-4


@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(
    jams=st.sets(st.sampled_from(["propeller", "roll"])),
    lies=st.booleans(),
    stale=st.booleans(),
    load=st.sampled_from([-150.0, 0.0, 150.0]),
    resumes=st.booleans(),
    stage=st.sampled_from(["enabled", "released"]),
    delay=st.integers(0, 60),
)
def test_no_voltage_is_taken_from_an_axis_that_a_brake_does_not_hold(
    jams: set[str], lies: bool, stale: bool, load: float, resumes: bool, stage: str, delay: int
) -> None:
    rig = Rig()
    for drive in rig.drives:
        drive.ramp, drive.resumes = 1e9, resumes
    rig.machine.start()
    rig.machine.enable()
    for drive in rig.drives:
        drive.gravity = load
    if stage == "released":
        rig.machine.release_brakes(lambda _: np.full(2, load / 200.0))
    rig.io.jammed, rig.io.lies, rig.io.delay_polls = jams, jams if lies else set(), delay
    rig.io.age_s = 10.0 if stale else 0.0
    rig.machine.stop()
    rig.machine.close()
    for axis, drive in zip(("propeller", "roll"), rig.drives, strict=True):
        if drive.brake_open and load:
            assert drive.power == "quick stop active"
            assert f"{axis} at rest" not in rig.machine.outcome
        assert abs(drive.counts - 1000.0) * rig.settings.scalings[0].position_resolution < 0.08


def test_a_stopped_machine_starts_again_without_a_new_link(rig: Rig) -> None:
    rig.ready()
    rig.machine.stop()
    rig.ready()
    assert np.isfinite(rig.machine.exchange(ZERO).position).all()


def test_close_resets_communication_so_that_nodes_forget_the_bench(rig: Rig) -> None:
    rig.ready()
    rig.machine.close()
    resets = [data for data in rig.bus.sent(0x000) if data[0] == 0x82]
    assert resets[-4:] == [bytes((0x82, node_id)) for node_id in (1, 2, 11, 12)]


def test_a_stop_that_breaks_off_claims_nothing_and_takes_every_axis_for_held(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.ready()

    def dead(*_: object) -> None:
        raise OSError("the bus is dead")

    monkeypatch.setattr(rig.bus, "send", dead)
    rig.machine.stop()
    assert rig.machine.outcome == f"{KEEP_AWAY}: propeller, roll nobody knows whether it stands: the stop broke off"
    assert [(rest.axis, rest.safe, rest.held) for rest in rig.machine.rests] == [("propeller", False, True), ("roll", False, True)]
    assert any("the bus is dead" in trouble for trouble in rig.machine.stop_trouble)
