"""The frames of one tick at their bounds: what is sent when, what is taken for an answer, and what is told of the rest."""

from __future__ import annotations

import dataclasses
import errno
import math
import struct
from collections.abc import Callable

import can
import numpy as np
import pytest
from one_tick import ALL, NODES, PATIENCE_S, PERIOD_S, SYNC, Frame, Machine, Wire, answer, but
from scripted_nodes import machine_settings

from drivers.canopen.cyclic import STALE_FRAMES_MAX, CyclicExchange
from drivers.errors import BusError, MotionRefusedError
from drivers.interface import Sample

# ---- what is sent


def test_commands_go_out_rounded_to_what_the_wire_carries_and_the_sample_says_so() -> None:
    machine = Machine()
    sample = machine.tick(efforts=(1.0012, -99.0))
    assert machine.wire.log == [(0x201, b"\0\0" + struct.pack("<h", 200)), (0x202, b"\0\0" + struct.pack("<h", -1600)), (SYNC, b"")]
    assert sample.commanded == pytest.approx([1.0, -8.0])


@pytest.mark.parametrize("takes_bytes", [False, True])
def test_a_transmit_queue_that_is_full_for_a_moment_loses_no_command(takes_bytes: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    refusals, send = [can.CanOperationError("no buffer space", errno.ENOBUFS), can.CanOperationError("Transmit buffer full")], Wire.send

    def refusing(wire: Wire, message: can.Message) -> None:
        if refusals:
            raise refusals.pop()
        send(wire, message)

    def of_bytes(wire: Wire, can_id: int, data: bytes) -> None:
        refusing(wire, can.Message(arbitration_id=can_id, is_extended_id=False, data=data))

    monkeypatch.setattr(Wire, *(("send_frame", of_bytes) if takes_bytes else ("send", refusing)), raising=False)
    machine = Machine().ticks(1)
    assert [can_id for can_id, _ in machine.wire.log] == [0x201, 0x202, SYNC]
    refusals += [can.CanOperationError("the interface went down")]
    with pytest.raises(BusError, match="wire: frame 201 could not be sent: the interface went down"):
        machine.tick()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_no_number_is_named_by_its_axis_and_nothing_is_sent(axis: int, value: float) -> None:
    machine = Machine()
    with pytest.raises(MotionRefusedError, match=rf"^{('propeller', 'roll')[axis]}: the command is {value}; no number, no motion$"):
        machine.tick(efforts=(value, 0.0) if axis == 0 else (0.0, value))
    assert machine.wire.log == []


def test_every_axis_has_a_command() -> None:
    for efforts, is_what in (((0.0,), "shorter"), ((0.0, 0.0, 0.0), "longer")):
        with pytest.raises(ValueError, match=is_what):
            Machine().tick(efforts=efforts)


@pytest.mark.parametrize(
    ("period_s", "ticks"), [(0.02, [0, 5, 10]), (PERIOD_S, list(range(12))), (PERIOD_S / 3, list(range(12))), (0.0, [])]
)
def test_the_heartbeat_goes_out_no_later_than_its_period_from_the_first_tick_on(period_s: float, ticks: list[int]) -> None:
    machine = Machine(master_heartbeat_period_s=period_s)
    machine.network.start_heartbeat(127, 1.0)
    machine.ticks(12)
    syncs = np.cumsum([can_id == SYNC for can_id, _ in machine.wire.log])
    assert [int(syncs[k]) for k, (can_id, _) in enumerate(machine.wire.log) if can_id == 0x77F] == ticks


def test_a_tick_waits_then_lets_others_do_their_part_then_sends_sync_and_says_when_answers_are_overdue() -> None:
    machine, seen = Machine(), []
    machine.clock.lateness_s = 1e-4

    def others() -> None:
        seen.append((machine.clock.now(), len(machine.wire.log)))

    overdue_s = machine.cyclic.run((0.0, 0.0), machine.sample, others)
    assert seen == [(PERIOD_S, 2)]
    assert overdue_s == PERIOD_S + PATIENCE_S
    assert machine.sample.lateness_s == 1e-4
    assert Machine().cyclic.missing == [], "nobody was asked yet"
    machine.ticks(2)
    assert machine.cyclic.syncs == 3


# ---- what is taken


def test_answers_fill_the_sample_and_end_the_wait() -> None:
    machine = Machine()
    sample = machine.tick(answer(0x181, 100), answer(0x182, 200), answer(0x18B, 300), answer(0x18C, 400, 1e-4))
    resolution, link = 2 * math.pi / (4096 * 150), 2 * math.pi / 2**23
    assert sample.position == pytest.approx([100 * resolution, 200 * resolution])
    assert sample.link_position == pytest.approx([300 * link, 400 * link])
    assert sample.statusword.tolist() == [0x0637, 0x0637]
    assert machine.clock.now() == PERIOD_S + 1e-4
    assert machine.cyclic.missing == []


@pytest.mark.parametrize("awake_s", [0.0, 2.0**-10, 1.0])
def test_an_answer_may_take_its_time_and_no_longer(awake_s: float) -> None:
    for delay_s, came in ((PATIENCE_S, True), (PATIENCE_S + 1e-6, False)):
        machine = Machine(awake_s=awake_s)
        recv = machine.wire.recv

        def look(timeout: float | None = None, machine: Machine = machine, recv: Callable[..., can.Message | None] = recv) -> object:
            message = recv(timeout)
            if message is None and not timeout:
                machine.wire.time_s += PATIENCE_S / 64  # to look takes time
            return message

        machine.wire.recv = look
        sample = machine.tick(*but(0x182), answer(0x182, 0, delay_s))
        assert np.isfinite(sample.position[1]) == came
        assert machine.cyclic.missing == ([] if came else ["roll_drive: TPDO 1 (182h)"])


def test_answers_are_polled_awake_for_a_while_and_then_awaited_asleep() -> None:
    machine, timeouts = Machine(awake_s=PATIENCE_S / 2), []
    recv = machine.wire.recv

    def look(timeout: float | None = None) -> can.Message | None:
        message = recv(timeout)
        if machine.wire.log[-1:] == [(SYNC, b"")]:
            timeouts.append(timeout)
        if message is None and timeout == 0.0:
            machine.wire.time_s += PATIENCE_S / 8  # to look takes time
        return message

    machine.tick()
    machine.wire.recv = look
    machine.wire.script.append(but(0x182))
    machine.cyclic.run((0.0, 0.0), machine.sample, lambda: timeouts.clear())
    assert timeouts == [0.0] * 3 + [0.0] * 4 + [PATIENCE_S / 2]


def test_a_row_holds_nothing_of_the_row_before() -> None:
    machine = Machine().ticks(2)
    sample = machine.tick((0.0, 0x700, b""))
    for values in (sample.position, sample.link_position, sample.effort):
        assert np.isnan(values).all()
    assert sample.statusword.tolist() == [-1, -1]
    assert not sample.position_late.any()


def test_a_malformed_answer_is_none_and_a_longer_one_is_remarked() -> None:
    machine = Machine().ticks(2)
    sample = machine.tick(*but(0x181), (0.0, 0x181, b"\x37\x06"))
    assert np.isnan(sample.position[0])
    says = "propeller_drive: TPDO 1 (181h)"
    assert machine.cyclic.missing == [f"{says} (PDO of 2 bytes where 8 are mapped)"]
    assert machine.network.first_malformed == f"{says}: PDO of 2 bytes where 8 are mapped"
    machine.cyclic.forget_remarks()
    machine.ticks(1)
    assert machine.cyclic.remarks == []
    delay_s, can_id, data = answer(0x18B)
    machine.tick(*but(0x18B), (delay_s, can_id, data + b"\0"))
    assert machine.cyclic.remarks == [
        "propeller_encoder: TPDO 1 (18Bh): 1 frames were longer than the 4 bytes that it maps; the rest was ignored"
    ]
    machine.cyclic.forget_remarks()
    assert machine.cyclic.remarks == []


def test_unanswered_syncs_are_remarked_once_a_node_has_answered_at_all() -> None:
    machine = Machine()
    machine.tick(*but(0x18C))
    assert machine.cyclic.remarks == [], "it may not be running yet"
    machine.ticks(2)
    for _ in range(3):
        machine.tick(*but(0x18C))
    assert machine.cyclic.remarks == ["roll_encoder: TPDO 1 (18Ch): 3 SYNCs were not answered in time since bring-up"]


@pytest.mark.parametrize("lost", [1, 2, 5])
def test_after_answers_were_lost_the_one_at_its_usual_time_is_the_newest(lost: int) -> None:
    machine = Machine()
    machine.wire.usual = [*but(0x182), answer(0x182, 0, 1e-3)]
    machine.ticks(40)
    for _ in range(lost):
        machine.tick(*but(0x182))
    sample = machine.tick(*but(0x182), answer(0x182, 5, 1e-3))
    assert np.isfinite(sample.position[1])
    machine.tick()
    assert machine.clock.now() == machine.clock.tick_s + 1e-3, "nothing is owed any more, and the tick ends with its last answer"
    machine.tick(*but(0x182))
    spread_s = 0.1 * PERIOD_S
    assert np.isfinite(machine.tick(*but(0x182), answer(0x182, 5, 1e-3 + 0.9 * spread_s)).position[1])
    machine.tick(*but(0x182))
    sample = machine.tick(*but(0x182), answer(0x182, 5, 1e-3 - 1.1 * spread_s))
    assert np.isnan(sample.position[1]), "it may answer an earlier SYNC"
    assert sample.position_late.tolist() == [False, True]


def test_the_usual_time_of_an_answer_is_that_of_the_last_sixteen() -> None:
    """It moves by a sixteenth of each difference: after one answer a spread later, by a sixteenth of the spread."""
    spread_s = 0.1 * PERIOD_S
    for late, known in ((1.03, True), (1.10, False)):
        machine = Machine()
        machine.wire.usual = [*but(0x182), answer(0x182, 0, 0.5e-3)]
        machine.ticks(200)
        machine.tick(*but(0x182), answer(0x182, 0, 0.5e-3 + spread_s))
        machine.tick(*but(0x182))
        sample = machine.tick(*but(0x182), answer(0x182, 0, 0.5e-3 + late * spread_s))
        assert np.isfinite(sample.position[1]) == known


def test_two_answers_are_owed_one_and_this_syncs() -> None:
    machine = Machine().ticks(3)
    machine.tick(*but(0x182))
    sample = machine.tick(*but(0x182), answer(0x182, 1, 1e-4), answer(0x182, 2, 2e-4))
    assert sample.position[1] == pytest.approx(2 * 2 * math.pi / (4096 * 150))
    assert machine.network.intruder == ""
    machine.tick(answer(0x182), *but(0x182))
    assert machine.cyclic.missing == []


def test_answers_between_two_ticks_are_counted_and_are_none_of_the_next() -> None:
    machine = Machine().ticks(3)
    machine.tick(*but(0x182))
    machine.wire.bring(answer(0x182, 77))
    sample = machine.tick(*but(0x182))
    assert machine.cyclic.late_frames == 1
    assert np.isnan(sample.position[1])
    assert sample.position_late.tolist() == [False, True], "it answers, and late"
    assert machine.tick(*but(0x182)).position_late.tolist() == [False, False]
    machine.wire.bring(answer(0x182))
    machine.tick()
    assert machine.cyclic.late_frames == 2


def test_all_nodes_that_answer_late_are_said_to() -> None:
    machine = Machine().ticks(3)
    machine.tick(*ALL[2:])
    for can_id in (0x181, 0x182):
        machine.wire.bring(answer(can_id))
    assert machine.tick(*ALL[2:]).position_late.tolist() == [True, True]


def test_each_late_answer_pays_one_that_is_owed() -> None:
    machine = Machine().ticks(3)
    machine.tick(*but(0x182))
    machine.wire.bring(answer(0x182))
    machine.tick()
    assert machine.clock.now() == machine.clock.tick_s, "nothing is owed, and the tick ends with its last answer"
    machine.tick(*but(0x182))
    machine.tick(*but(0x182))
    machine.wire.bring(answer(0x182))
    resolution = 2 * math.pi / (4096 * 150)
    assert machine.tick(*but(0x182), answer(0x182, 1), answer(0x182, 2)).position[1] == pytest.approx(2 * resolution)


def test_while_one_node_owes_answers_the_usual_time_of_others_stays() -> None:
    spread_s = 0.1 * PERIOD_S
    machine = Machine().ticks(50)
    for _ in range(50):
        machine.tick(*[frame for frame in ALL if frame[1] not in (0x181, 0x182)], answer(0x182, 0, 2.0 * spread_s))
    machine.ticks(2)
    machine.tick(*but(0x182))
    assert np.isfinite(machine.tick().position[1])


def test_when_nothing_is_owed_any_more_the_usual_time_follows_again() -> None:
    machine, later = Machine().ticks(3), answer(0x182, 0, 0.2 * PERIOD_S)
    machine.tick(*but(0x182))
    machine.wire.bring(answer(0x182))
    for _ in range(50):
        machine.tick(*but(0x182), later)
    machine.tick(*but(0x182))
    assert np.isfinite(machine.tick(*but(0x182), later).position[1])


def test_a_second_sender_of_a_node_that_was_late_for_long_is_named_as_soon_as_any_other() -> None:
    machine = Machine().ticks(3)
    machine.tick(*but(0x182))
    for _ in range(6):
        machine.tick(*but(0x182), answer(0x182, 0, 1.5e-3))
    machine.tick(*but(0x182), answer(0x182, 0, 1e-4), answer(0x182, 0, 2e-4))  # what it owed, and what it owes
    for k in range(4):
        assert machine.network.intruder == "", k
        machine.tick(*ALL, answer(0x182))
        machine.wire.bring(answer(0x182))
    machine.tick()
    assert machine.network.intruder.startswith("roll_drive: TPDO 1 (182h) comes more than once per SYNC")


@pytest.mark.parametrize("can_id", [0x181, 0x182])
def test_a_second_sender_of_answers_is_named(can_id: int) -> None:
    for between in (False, True):
        machine = Machine().ticks(3)
        for _ in range(4):
            assert machine.network.intruder == ""
            if between:
                machine.wire.bring(answer(can_id))
            machine.tick(*([] if between else [answer(can_id)]), *ALL)
        assert f"_drive: TPDO 1 ({can_id:03X}h) comes more than once per SYNC" in machine.network.intruder


def test_what_is_not_sent_with_every_sync_may_come_as_often_as_it_likes() -> None:
    nodes = list(NODES)
    nodes[3] = dataclasses.replace(nodes[3], tpdos=(dataclasses.replace(nodes[3].tpdos[0], transmission_type=255),))
    machine = Machine(all_nodes=nodes)
    for _ in range(10):
        machine.tick(answer(0x18C), answer(0x18C), *ALL)
    assert machine.network.intruder == ""


# ---- all other frames


def test_frames_that_are_no_process_data_reach_whoever_they_are_for(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine()
    heard: list[object] = []
    monkeypatch.setattr(machine.heartbeats, "heartbeat", lambda node, data: heard.append(("beat", node, bytes(data))))
    monkeypatch.setattr(machine.heartbeats, "emergency", lambda node, data: heard.append(("emergency", node, bytes(data))))
    machine.network.subscribe(0x582, lambda can_id, data, stamp: heard.append((can_id, bytes(data), stamp)))
    others: list[Frame] = [(0.0, 0x70C, b"\x05"), (0.0, 0x081, b"12345678"), (0.0, 0x582, b"abc")]
    machine.tick(*others, *ALL)
    for frame in others:
        machine.wire.bring(frame)
    machine.tick()
    assert heard == [("beat", 12, b"\x05"), ("emergency", 1, b"12345678"), (0x582, b"abc", 7.0)] * 2


def test_frames_of_other_kinds_are_counted_and_are_no_answers() -> None:
    machine = Machine().ticks(2)
    remote = can.Message(arbitration_id=0x181, is_extended_id=False, is_remote_frame=True, dlc=8)
    long = can.Message(arbitration_id=0x181, is_extended_id=True, data=bytes(8))
    sample = machine.tick(remote, long, *but(0x181))
    assert np.isnan(sample.position[0])
    machine.wire.bring(remote)
    machine.tick()
    assert machine.network.passed_over == {"remote frames": 2, "frames with a 29-bit identifier": 1}
    assert machine.cyclic.late_frames == 0


def test_bus_off_is_a_fault_of_one_sample_and_other_error_frames_are_none() -> None:
    machine = Machine()
    error = can.Message(arbitration_id=0x40, is_extended_id=False, is_error_frame=True)
    assert machine.tick(can.Message(arbitration_id=0x04, is_extended_id=False, is_error_frame=True), *ALL).fault == ""
    assert machine.tick(can.Message(arbitration_id=0x40, is_extended_id=False, data=b""), *ALL).fault == ""
    says = "wire: the CAN controller is bus off; check wiring, termination and bit rate"
    assert machine.tick(error, error, *ALL).fault == says
    assert machine.tick().fault == ""
    assert machine.tick(error, (0.0, 0x081, struct.pack("<HB5x", 0x2310, 1)), *ALL).fault == says, "the first stands"
    assert "2310h" in machine.tick((0.0, 0x081, struct.pack("<HB5x", 0x2310, 1)), *ALL).fault


def test_a_flood_is_named_with_its_last_frame_when_it_lasts_and_counts_by_tick() -> None:
    machine = Machine()
    bearable = [(0.0, 0x3A5, b"")] * 17
    for _ in range(10):
        machine.tick(*bearable, *ALL)
    assert machine.network.intruder == ""
    for k in range(4):
        assert machine.network.intruder == ""
        machine.wire.bring((0.0, 0x3A6, b""))  # those between ticks count, too
        machine.tick(*bearable, *ALL)
        assert bool(machine.network.intruder) == (k == 3)
    assert machine.network.intruder.startswith("18 frames in one period that nobody here asked for, the last with the identifier 3A5h, 17 ")


def test_a_flood_of_three_ticks_at_the_very_beginning_is_none() -> None:
    machine = Machine()
    for frames in (17, 18, 18, 18):
        machine.tick(*[(0.0, 0x3A5, b"")] * frames, *ALL)
    assert machine.network.intruder == ""


def test_a_flood_does_not_keep_the_loop_from_its_tick() -> None:
    """Frames without end, of 10 us each: as many as are read before SYNC, until answers are overdue, and as many again."""
    machine, read = Machine(), []

    def flood(timeout: float | None = None) -> can.Message:
        machine.wire.time_s += 1e-5
        read.append(timeout)
        return can.Message(arbitration_id=0x3A5, is_extended_id=False)

    machine.wire.recv = flood
    machine.tick()
    assert len(read) == STALE_FRAMES_MAX + math.floor(PATIENCE_S / 1e-5) + STALE_FRAMES_MAX + 1
    assert len(machine.cyclic.missing) == 4
    assert read[-STALE_FRAMES_MAX:] == [0.0] * STALE_FRAMES_MAX, "who is late waits no more"


# ---- silence


def test_ages_grow_from_the_last_answer_over_lost_ticks_too() -> None:
    machine = Machine().ticks(2)
    assert machine.tick(*but(0x18C)).age_s.tolist() == [0.0, PERIOD_S]
    machine.clock.missed += 2
    assert machine.tick(*but(0x18C)).age_s.tolist() == [0.0, 4 * PERIOD_S]
    machine.clock.missed = 0
    assert machine.tick(*but(0x18C)).age_s.tolist() == [0.0, 5 * PERIOD_S], "a clock that starts again"
    assert machine.tick().age_s.tolist() == [0.0, 0.0]
    first = Machine()
    first.clock.missed = 1
    assert first.tick(*but(0x18C)).age_s.tolist() == [0.0, 2 * PERIOD_S]


def test_syncs_that_nobody_answers_are_counted_where_several_nodes_should() -> None:
    nobody = (0.0, 0x700, b"")
    machine = Machine()
    assert machine.tick(nobody).unanswered == 0, "before the first answer nobody is late"
    machine.ticks(2)
    assert machine.tick(nobody).unanswered == 1
    machine.clock.missed += 3
    assert machine.tick(nobody).unanswered == 5
    assert machine.tick(answer(0x18C)).unanswered == 0
    assert machine.cyclic.silent_ticks == 64  # two and a half heartbeats of 0.1 s
    assert Machine(2).cyclic.silent_ticks == 64
    alone = Machine(1, scalings=machine_settings().scalings[:1])
    alone.sample = Sample(1)
    assert alone.cyclic.silent_ticks == 0, "nobody tells a late bus from a node that is silent"
    for frames in (ALL[:1], [nobody]):
        alone.wire.script.append(frames)
        alone.cyclic.run((0.0,), alone.sample)
    assert alone.sample.unanswered == 0


def test_a_rehearsal_changes_nothing_and_rehearses_the_bus() -> None:
    machine = Machine()
    machine.cyclic.rehearse()
    rehearsed: list[bool] = []
    machine.wire.rehearse = lambda: rehearsed.append(True)
    machine.cyclic = CyclicExchange(machine.network, machine_settings(), machine.heartbeats)
    machine.cyclic.rehearse()
    assert rehearsed == [True]
    assert machine.wire.log == []
    assert machine.tick().position.tolist() == [0.0, 0.0]
