"""A stop works from every state, and takes no voltage from a drive before its axis is held."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from machine_rig import ZERO, Rig
from scripted_nodes import PERIOD_S, ScriptedDrive


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


def test_stop_orders_quick_stop_before_voltage_off_and_waits_for_the_brakes_in_between(rig: Rig) -> None:
    rig.ready()
    rig.bus.log.clear()
    rig.io.delay_polls = 10
    rig.machine.stop()
    words = [struct.unpack_from("<H", data)[0] for data in rig.bus.sent(0x201)]
    quick_stops = words.index(0x0000)
    assert words[:quick_stops] == [0x0002] * quick_stops
    assert quick_stops >= 10
    assert set(words[quick_stops:]) == {0x0000}


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
    assert seen.count(("quick stop active", 0.0)) == pytest.approx(0.05 / PERIOD_S, abs=2)
    assert seconds < 0.2


def test_an_axis_without_a_brake_that_never_stands_does_not_hold_up_the_stop_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    _, seconds = quick_stop_of_a_turning_axis(0.0, monkeypatch)
    assert 0.6 < seconds < 0.7


def test_an_axis_without_a_brake_whose_position_is_lost_is_not_taken_for_standing(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(io=False)
    rig.machine.start()
    rig.machine.enable()
    rig.drives[0].mute_pdo = True
    start = rig.bus.time_s
    rig.machine.stop()
    assert rig.bus.time_s - start > 0.6


def test_a_brake_that_jams_open_does_not_hold_up_the_stop_for_ever(rig: Rig) -> None:
    rig.ready()
    rig.io.jammed = {"roll"}
    start = rig.bus.time_s
    rig.machine.stop()
    assert rig.bus.time_s - start < 1.0
    assert all(drive.power == "switch on disabled" for drive in rig.drives)


def test_voltage_stays_on_while_nobody_knows_whether_the_brakes_have_closed(rig: Rig) -> None:
    rig.ready()
    rig.io.age_s = 10.0
    start = rig.bus.time_s
    rig.machine.stop()
    assert rig.bus.time_s - start > 0.5


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
