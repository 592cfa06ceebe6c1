"""A bus that is late and a node that is silent: where nobody answers, nobody is accused, but not for long."""

from __future__ import annotations

import re

import pytest
from machine_rig import ZERO, Rig

from drivers.errors import BusTimeoutError
from drivers.interface import Sample

BRIDGED = 64  # two and a half of the rig's heartbeats, of 0.1 s


def mute(rig: Rig, *, drives: bool = True, encoders: bool = True, is_mute: bool = True) -> None:
    for node in (*(rig.drives if drives else ()), *(rig.encoders if encoders else ())):
        node.mute_pdo = is_mute


def tick(rig: Rig, ticks: int = 1) -> tuple[Sample, str]:
    """Make ticks as the loop does; the newest sample, and the first that the watch finds."""
    found = ""
    for _ in range(ticks):
        sample = rig.machine.exchange(ZERO)
        found = found or rig.machine.watch.check(sample)
    return sample, found


def test_ticks_that_nobody_answers_are_bridged_as_long_as_a_heartbeat_may_be_missing() -> None:
    rig = Rig().ready()
    for _ in range(3):
        mute(rig)
        sample, found = tick(rig, BRIDGED)
        assert (sample.unanswered, found) == (BRIDGED, "")
        mute(rig, is_mute=False)
        sample, found = tick(rig)
        assert (sample.unanswered, found) == (0, "")
    assert not rig.at_rest()


def test_one_more_stops_the_motors() -> None:
    rig = Rig().ready()
    tick(rig)
    mute(rig)
    says = "no node has answered for 0.254 s, 0.250 s allowed"
    with pytest.raises(BusTimeoutError, match=re.escape(says)):
        tick(rig, BRIDGED + 1)
    assert rig.machine.outcome


@pytest.mark.parametrize("who", ["drives", "encoders"])
def test_nodes_that_are_silent_while_others_answer_are_found_as_ever(who: str) -> None:
    rig = Rig().ready()
    tick(rig)
    mute(rig, drives=who == "drives", encoders=who == "encoders")
    sample, found = tick(rig, 3)
    assert (sample.unanswered, found) == (0, "")
    _, found = tick(rig)
    assert "no position for 4 ticks, timing.stale_ticks bridges 3" in found


@pytest.mark.parametrize("identifier", [0x182, 0x18C], ids=["drive", "encoder"])
def test_a_node_whose_answers_come_while_others_are_in_time_is_late_and_not_silent(identifier: int) -> None:
    rig = Rig().ready()
    tick(rig, 30)
    rig.bus.late_by_a_tick = identifier
    sample, found = tick(rig, 12)
    assert (sample.unanswered, found) == (0, "")
    assert (sample.position_late.tolist(), sample.link_late.tolist()) == (
        [False, identifier == 0x182],
        [False, identifier == 0x18C],
    )
    rig.bus.late_by_a_tick = 0
    tick(rig)
    sample, found = tick(rig)
    assert (found, sample.position_late.any(), sample.link_late.any()) == ("", False, False)


def test_a_position_that_is_late_for_longer_than_a_heartbeat_may_be_stops_the_motors() -> None:
    rig = Rig().ready()
    tick(rig, 30)
    rig.bus.late_by_a_tick = 0x182
    with pytest.raises(BusTimeoutError, match=r"roll: position too late for 0\.254 s, 0\.250 s allowed"):
        tick(rig, BRIDGED + 3)


def test_a_silent_node_is_found_between_ticks_that_nobody_answers() -> None:
    rig = Rig().ready()
    tick(rig)
    rig.drives[1].mute_pdo = True
    for _ in range(3):
        assert tick(rig)[1] == ""
        others = (rig.drives[0], *rig.encoders)
        for node in others:
            node.mute_pdo = True
        assert tick(rig, BRIDGED)[1] == ""
        for node in others:
            node.mute_pdo = False
    assert "roll: motor side: no position for 4 ticks" in tick(rig)[1]


def test_a_machine_that_starts_anew_owes_nothing_from_before() -> None:
    rig = Rig().ready()
    mute(rig)
    with pytest.raises(BusTimeoutError):
        tick(rig, BRIDGED + 1)
    mute(rig, is_mute=False)
    rig.ready()
    assert tick(rig)[0].unanswered == 0
