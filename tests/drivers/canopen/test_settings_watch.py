"""Settings of drives while they run: who else writes them is seen in one tick, and what has changed unseen is read back in some seconds."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace

import can
import pytest
from machine_rig import ZERO, Rig
from scripted_nodes import PERIOD_S

from drivers.canopen.settings_watch import READS_PER_S
from drivers.errors import ConfigurationRefusedError, SecondMasterError
from drivers.machine_link import CanMachine

SECOND = round(1.0 / PERIOD_S)
QUICK_STOP_OPTION, CONSUMER_HEARTBEAT = (0x605A, 0), (0x1016, 1)
WRITES, SEGMENTED, BLOCK_WRITE, READS, BLOCK_READ, SEGMENT, ABORT = 0x2B, 0x21, 0xC6, 0x40, 0xA0, 0x60, 0x80


@pytest.fixture
def rig() -> Rig:
    return Rig().ready()


def ticks(rig: Rig, number: int) -> None:
    for _ in range(number):
        rig.machine.exchange(ZERO)


def request(command: int, index: int = 0x605A, subindex: int = 0, data: bytes = b"") -> bytes:
    return struct.pack("<BHB", command, index, subindex) + data.ljust(4, b"\0")


def foreign(rig: Rig, node_id: int, data: bytes) -> None:
    """Let somebody else ask a node, which answers."""
    rig.bus.emit(0x600 + node_id, data)
    next(node for node in rig.bus.nodes if node.node_id == node_id).receive(0x600 + node_id, data)


@pytest.mark.parametrize(("node_id", "name"), [(1, "propeller_drive"), (2, "roll_drive"), (12, "roll_encoder")])
@pytest.mark.parametrize(
    ("command", "verb"),
    [
        (WRITES, "writes"),
        (SEGMENTED, "writes"),
        (BLOCK_WRITE, "writes"),
        (READS, "reads"),
        (BLOCK_READ, "reads"),
        (SEGMENT, ""),
        (ABORT, ""),
    ],
)
def test_a_foreign_request_to_a_node_stops_the_run_in_one_tick(rig: Rig, node_id: int, name: str, command: int, verb: str) -> None:
    ticks(rig, 3)
    rig.bus.emit(0x600 + node_id, request(command, 0x1017))
    what = f" and {verb} 1017h:00" if verb else ""
    with pytest.raises(SecondMasterError, match=f"somebody else sends {0x600 + node_id:03X}h, SDO requests to {name},{what}") as caught:
        ticks(rig, 1)
    assert f"bus.nodes.{name}.foreign_sdo" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert rig.at_rest()


def test_requests_to_nodes_that_are_not_the_machines_are_nobodys_business(rig: Rig) -> None:
    for identifier in (0x600, 0x603, 0x67F):
        rig.bus.emit(identifier, request(WRITES))
    ticks(rig, SECOND)


@pytest.mark.parametrize("address", [QUICK_STOP_OPTION, CONSUMER_HEARTBEAT])
def test_what_a_foreign_request_has_changed_is_written_again_before_the_stop_needs_it(rig: Rig, address: tuple[int, int]) -> None:
    drive = rig.drives[1]
    configured = drive.value(*address)
    assert configured
    ticks(rig, 3)
    begin = len(rig.bus.log)
    foreign(rig, 2, request(WRITES if address[0] == 0x605A else 0x23, *address))
    assert drive.value(*address) == 0
    with pytest.raises(SecondMasterError):
        ticks(rig, 1)
    assert drive.value(*address) == configured
    after = rig.bus.log[begin:]
    again = next(place for place, (_, identifier, data) in enumerate(after) if identifier == 0x602 and data[4:] != bytes(4))
    stop = next(place for place, (_, identifier, data) in enumerate(after) if identifier == 0x202 and data[0] == 2)
    assert again < stop


def test_what_has_changed_without_a_frame_is_read_back_in_some_seconds(rig: Rig) -> None:
    drive = rig.drives[1]
    ticks(rig, 3)
    drive.set(*QUICK_STOP_OPTION, 0)
    with pytest.raises(SecondMasterError, match=r"roll_drive \(node 2\): 605Ah:00 .* is 0, 6 was written: somebody, or the device itself"):
        ticks(rig, 5 * SECOND)
    assert drive.value(*QUICK_STOP_OPTION) == 6
    assert rig.at_rest()


def test_a_few_objects_a_second_are_read_and_none_twice_before_the_next(rig: Rig) -> None:
    begin = len(rig.bus.log)
    ticks(rig, 4 * SECOND)
    asked = [(identifier, data[:4]) for _, identifier, data in rig.bus.log[begin:] if 0x601 <= identifier <= 0x67F]
    assert len(asked) == pytest.approx(4 * READS_PER_S, abs=1)
    assert {data[0] for _, data in asked} == {READS}
    decisive = asked[::2]
    first_round = decisive[: decisive.index(decisive[0], 1)] if decisive[0] in decisive[1:] else decisive
    assert len(set(first_round)) == len(first_round) >= 10
    assert {identifier for identifier, _ in asked} >= {0x601, 0x602}


def test_what_the_file_allows_by_name_goes_on_and_is_told_and_changes_are_still_found(rig: Rig) -> None:
    nodes = tuple(replace(node, foreign_sdo="the maker's tool logs") if node.name == "roll_drive" else node for node in rig.settings.nodes)
    rig.machine = CanMachine(replace(rig.settings, nodes=nodes), rig.bus, rig.clock, io=rig.io)
    rig.ready()
    for _ in range(200):
        foreign(rig, 2, request(READS, 0x6041))
        ticks(rig, 3)
    assert "roll_drive: 200 SDO requests of somebody else; the machine file allows them: the maker's tool logs" in rig.machine.remarks
    foreign(rig, 2, request(WRITES))
    with pytest.raises(SecondMasterError, match=r"605Ah:00 .* is 0, 6 was written"):
        ticks(rig, 5 * SECOND)


def echoing(rig: Rig) -> None:
    send = rig.bus.send

    def echo(msg: can.Message, timeout: float | None = None) -> None:
        send(msg, timeout)
        rig.bus.queue.append(can.Message(arbitration_id=msg.arbitration_id, is_extended_id=False, data=bytes(msg.data)))

    rig.bus.send = echo


def test_an_adapter_that_echoes_accuses_nobody_and_hears_somebody_else() -> None:
    rig = Rig()
    echoing(rig)
    rig.ready()
    assert rig.machine.network.echoes
    ticks(rig, 30 * SECOND)  # more is read back by then than was written at the start
    assert rig.machine.network.echoes
    foreign(rig, 2, request(READS, 0x6041))
    with pytest.raises(SecondMasterError, match="602h, SDO requests to roll_drive"):
        ticks(rig, SECOND)
    assert rig.at_rest()


def test_the_benchs_own_writes_are_what_it_expects_from_then_on(rig: Rig) -> None:
    ticks(rig, 20)
    sdo = rig.machine.sdo(1)
    sdo.write_checked(*CONSUMER_HEARTBEAT, 0x7F01F4)
    rig.machine.resume_ticks()
    ticks(rig, 5 * SECOND)


@pytest.mark.parametrize("late_ticks", [1, 20, 200])
def test_answers_that_are_late_or_never_come_accuse_nobody(rig: Rig, late_ticks: int) -> None:
    """And are no answers to what the bench asks next."""
    drive = rig.drives[1]
    drive.answers_sdo = False
    ticks(rig, late_ticks)
    while not any(identifier == 0x602 for _, identifier, _ in rig.bus.log[-30:]):
        ticks(rig, 1)
    drive.answers_sdo = True
    assert rig.machine.sdo(1).read_integer(0x605A) == 6
    rig.machine.resume_ticks()
    ticks(rig, 5 * SECOND)


def test_an_object_that_the_node_refuses_to_read_accuses_nobody(rig: Rig) -> None:
    del rig.drives[1].objects[QUICK_STOP_OPTION]
    ticks(rig, 5 * SECOND)


@pytest.mark.parametrize("change", [lambda drive: drive.set(*QUICK_STOP_OPTION, 0), lambda drive: drive.set(0x6072, 0, 1)])
def test_settings_are_read_back_before_a_stop_counts(rig: Rig, change: Callable[[object], None]) -> None:
    ticks(rig, 3)
    change(rig.drives[1])
    rig.machine.stop()
    (trouble,) = rig.machine.stop_trouble
    assert trouble.startswith("reading settings back: roll_drive (node 2): ")
    assert any("was written" in remark for remark in rig.machine.remarks)
    rig.machine.start()
    assert rig.machine.remarks == ()
    assert rig.drives[1].value(*QUICK_STOP_OPTION) == 6


def test_a_stop_of_a_machine_as_it_was_configured_says_nothing_of_settings(rig: Rig) -> None:
    ticks(rig, 3)
    rig.machine.stop()
    assert rig.machine.stop_trouble == []
    assert rig.at_rest()


def test_a_mode_that_somebody_changed_is_found(rig: Rig) -> None:
    ticks(rig, 3)
    rig.drives[0].set(0x6061, 0, 9)
    with pytest.raises((SecondMasterError, ConfigurationRefusedError), match=r"6061h:00 .* is 9, 10 was written"):
        ticks(rig, 5 * SECOND)
