"""Objects over SDO without a receiving thread: answers, aborts in words, read-back, lost frames, two devices of one id."""

from __future__ import annotations

import errno
import threading
import uuid
from typing import Never

import can
import canopen
import pytest
from scripted_nodes import EDS, BusClock, ScriptedBus, ScriptedDrive, ScriptedNode

from drivers.canopen.eds import load_object_dictionary
from drivers.canopen.network import PolledNetwork
from drivers.canopen.sdo import SdoNode
from drivers.errors import BusError, ConfigurationRefusedError, DuplicateNodeError, NodeAbsentError
from hil.bench.clock import WallClock


def connected(*nodes: ScriptedNode) -> tuple[ScriptedBus, SdoNode]:
    bus = ScriptedBus(*nodes)
    dictionary = load_object_dictionary(EDS / "isocenter_drive.eds", 1)
    return bus, SdoNode(PolledNetwork(bus, BusClock(bus)), 1, "roll_drive", dictionary)


def test_a_read_is_the_standards_bytes_and_starts_no_thread() -> None:
    threads = threading.active_count()
    bus, node = connected(ScriptedDrive(1))
    assert node.read_integer(0x1000) == 0x0002_0192
    assert bus.sent(0x601) == [bytes.fromhex("4000100000000000")]
    assert threading.active_count() == threads


def test_a_long_string_comes_in_segments() -> None:
    drive = ScriptedDrive(1)
    drive.objects[0x1008, 0] = b"A name of more than seven bytes"
    _, node = connected(drive)
    assert node.read_text(0x1008) == "A name of more than seven bytes"


def test_integers_go_out_in_the_data_sheets_width_and_come_back_with_its_sign() -> None:
    bus, node = connected(ScriptedDrive(1))
    node.write_checked(0x6007, 0, -1)
    assert bus.sent(0x601)[0] == bytes.fromhex("2b076000ffff0000")  # expedited, two bytes
    assert node.read_integer(0x6007) == -1


def test_bytes_beyond_an_objects_size_do_not_count() -> None:
    _, node = connected(ScriptedDrive(1))
    assert node.to_integer(0x6007, 0, bytes.fromhex("ffff0000")) == -1
    assert node.to_integer(0x6061, 0, bytes.fromhex("fc2e302e")) == -4


def test_an_object_that_only_the_data_sheet_has_is_told_as_that() -> None:
    drive = ScriptedDrive(1)
    drive.aborts[0x1017, 0] = 0x06020000
    _, node = connected(drive)
    with pytest.raises(
        ConfigurationRefusedError, match=r"object does not exist \(abort 06020000h\); its data sheet has it: give that of its"
    ):
        node.write_integer(0x1017, 0, 100)


def test_answers_to_requests_that_were_given_up_are_no_answers_to_later_ones() -> None:
    class Slow(ScriptedDrive):
        """Answers every request behind the next."""

        held: bytes | None = None

        def _sdo(self, data: bytes) -> None:
            if self.held is not None:
                super()._sdo(self.held)
            self.held = data

    _, node = connected(Slow(1))
    assert node.read_integer(0x1000) == 0x0002_0192
    assert node.read_integer(0x1018, 2) == 0x4953_4F01
    assert node.read_integer(0x1018, 3) == 0x0001_0000


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x06040041, "object cannot be mapped to the PDO"),
        (0x06090030, "value range of parameter exceeded"),
        (0x06010002, "attempt to write a read only object"),
        (0x08000022, "because of the present device state"),
        (0x12345678, "unknown abort code"),
    ],
)
def test_an_abort_is_told_in_words_with_node_object_value_and_code(code: int, words: str) -> None:
    drive = ScriptedDrive(1)
    drive.aborts[0x6072, 0] = code
    _, node = connected(drive)
    with pytest.raises(ConfigurationRefusedError) as caught:
        node.write_integer(0x6072, 0, 1600)
    for part in ("roll_drive (node 1)", "6072h:00", "1600", words, f"{code:08X}h"):
        assert part in str(caught.value)


def test_a_value_that_does_not_stick_is_refused() -> None:
    drive = ScriptedDrive(1)
    drive.stuck.add((0x6072, 0))
    _, node = connected(drive)
    with pytest.raises(ConfigurationRefusedError, match=r"6072h:00 \(Max torque\) reads back 0 .* after 1600"):
        node.write_checked(0x6072, 0, 1600)


def test_an_object_that_is_not_in_the_data_sheet_and_a_value_too_wide_are_refused_before_anything_is_sent() -> None:
    bus, node = connected(ScriptedDrive(1))
    with pytest.raises(ConfigurationRefusedError, match=r"3333h:01 is not in its EDS"):
        node.write_integer(0x3333, 1, 5)
    with pytest.raises(ConfigurationRefusedError, match="70000 does not fit"):
        node.write_integer(0x6072, 0, 70000)
    assert bus.log == []


def test_a_missing_object_reads_as_none_where_that_is_allowed() -> None:
    _, node = connected(ScriptedDrive(1))
    assert node.read_if_present(0x1018, 4) is None
    assert node.read_if_present(0x2345) is None
    with pytest.raises(ConfigurationRefusedError, match=r"1018h:04.*subindex does not exist"):
        node.read(0x1018, 4)


def test_a_mute_node_is_asked_three_times_and_then_absent() -> None:
    drive = ScriptedDrive(1)
    drive.answers_sdo = False
    bus, node = connected(drive)
    with pytest.raises(NodeAbsentError, match="asked 3 times"):
        node.read(0x1000)
    assert 3 * 0.2 < bus.time_s < 1.0  # an EPOS4 may take 0.2 s to write its flash, and nobody waits a second for a node that is not there
    assert bus.sent(0x601)[-1] == bytes.fromhex("8000000000000405")  # the transfer is aborted: time-out


def test_one_lost_answer_is_bridged() -> None:
    class Forgetful(ScriptedDrive):
        asked = 0

        def _sdo(self, data: bytes) -> None:
            self.asked += 1
            if self.asked > 1:
                super()._sdo(data)

    _, node = connected(Forgetful(1))
    assert node.read_integer(0x1000) == 0x0002_0192
    assert node.read_integer(0x1018, 2) == 0x4953_4F01


def test_a_late_answer_to_a_repeated_request_is_no_second_device() -> None:
    class Slow(ScriptedDrive):
        late = None

        def _sdo(self, data: bytes) -> None:
            if self.late is None:
                self.late = data
            else:
                super()._sdo(self.late)
                super()._sdo(data)
                self.late = b"done"

        def receive(self, can_id: int, data: bytes) -> None:
            if self.late == b"done" and can_id == 0x601:
                ScriptedDrive._sdo(self, data)
            else:
                super().receive(can_id, data)

    _, node = connected(Slow(1))
    assert node.read_integer(0x1000) == 0x0002_0192
    assert node.read_integer(0x1018, 2) == 0x4953_4F01


def test_two_answers_to_one_request_are_two_devices() -> None:
    _, node = connected(ScriptedDrive(1), ScriptedDrive(1))
    node.read(0x1000)
    with pytest.raises(DuplicateNodeError, match=r"roll_drive \(node 1\): two answers"):
        node.read(0x1000)


def test_other_traffic_while_waiting_reaches_its_subscribers() -> None:
    bus, node = connected(ScriptedDrive(1))
    beats = []
    node.network.subscribe(0x702, lambda can_id, data, stamp: beats.append(bytes(data)))
    bus.emit(0x702, b"\x05")
    node.read(0x1000)
    assert beats == [b"\x05"]


def test_a_dead_interface_is_a_bus_error() -> None:
    bus, node = connected(ScriptedDrive(1))
    bus.broken = True
    with pytest.raises(BusError, match="scripted"):
        node.read(0x1000)
    with pytest.raises(BusError, match="scripted"):
        node.network.pump(0.1)


def test_the_canopen_librarys_own_server_is_read_and_written_on_a_virtual_bus_in_wall_time() -> None:
    channel = uuid.uuid4().hex
    network = canopen.Network(can.Bus(interface="virtual", channel=channel))
    network.connect()
    try:
        network.create_node(1, str(EDS / "isocenter_drive.eds"))
        with can.Bus(interface="virtual", channel=channel) as bus:
            node = SdoNode(PolledNetwork(bus, WallClock()), 1, "drive", load_object_dictionary(EDS / "isocenter_drive.eds", 1))
            node.write_checked(0x6072, 0, 1234)
            assert node.read_text(0x1008) == "Isocenter drive"
            with pytest.raises(ConfigurationRefusedError, match="attempt to write a read only object"):
                node.write_integer(0x6041, 0, 0)
    finally:
        network.disconnect()


def test_a_transmit_queue_that_is_full_for_a_moment_loses_no_frame() -> None:
    bus, node = connected(ScriptedDrive(1))
    refusals = [can.CanOperationError("no buffer space", errno.ENOBUFS), can.CanOperationError("Transmit buffer full")]
    original = bus.send

    def send(message: can.Message, timeout: float | None = None) -> None:
        if refusals:
            raise refusals.pop()
        original(message)

    bus.send = send
    assert node.read_integer(0x1000) == 0x0002_0192
    assert len(bus.sent(0x601)) == 1


def test_a_transmit_queue_that_stays_full_is_a_bus_error() -> None:
    bus, node = connected(ScriptedDrive(1))

    def send(message: can.Message, timeout: float | None = None) -> Never:
        raise can.CanOperationError("no buffer space", errno.ENOBUFS)

    bus.send = send
    with pytest.raises(BusError, match="frame 601 could not be sent: no buffer space"):
        node.read(0x1000)
