"""Boot-up with a time-out of its own, heartbeats with ages, NMT states, two devices of one id."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scripted_nodes import BusClock, ScriptedBus, ScriptedDrive, machine_settings

from drivers.canopen.heartbeat_consumer import HeartbeatConsumer
from drivers.canopen.network import PolledNetwork
from drivers.errors import BusTimeoutError, ConfigurationRefusedError, DuplicateNodeError, HeartbeatLostError, NodeAbsentError

NODE = machine_settings().nodes[:1]
START_REMOTE_NODE = 1  # CiA 301, 7.2.8.3.1: the command specifier of the NMT service


def supervised(*nodes: ScriptedDrive) -> tuple[ScriptedBus, PolledNetwork, HeartbeatConsumer]:
    bus = ScriptedBus(*nodes)
    network = PolledNetwork(bus, BusClock(bus))
    return bus, network, HeartbeatConsumer(network, NODE)


def operational(drive: ScriptedDrive) -> tuple[ScriptedBus, PolledNetwork, HeartbeatConsumer]:
    bus, network, heartbeats = supervised(drive)
    heartbeats.boot(NODE)
    drive.set(0x1017, 0, 100)
    network.command_nmt(START_REMOTE_NODE, 1)
    heartbeats.await_operational(NODE)
    return bus, network, heartbeats


def test_a_node_that_boots_late_but_in_time_is_waited_for() -> None:
    drive = ScriptedDrive(1)
    drive.boot_delay_s = 1.9
    bus, _, heartbeats = supervised(drive)
    heartbeats.boot(NODE)
    assert 1.9 <= bus.time_s < 2.0


def test_a_node_that_never_boots_is_absent_after_its_own_time_out() -> None:
    bus, _, heartbeats = supervised()
    with pytest.raises(
        NodeAbsentError, match=r"propeller_drive \(node 1\): neither boot-up nor SDO answer within 2\.0 s .*scripted.*booted: none"
    ):
        heartbeats.boot(NODE)
    assert 2.0 <= bus.time_s < 4.0


def test_a_node_that_does_not_announce_itself_but_answers_is_there() -> None:
    drive = ScriptedDrive(1)
    drive.silent = True
    _, _, heartbeats = supervised(drive)
    heartbeats.boot(NODE)


def test_two_boot_ups_after_one_reset_are_two_devices() -> None:
    _, _, heartbeats = supervised(ScriptedDrive(1), ScriptedDrive(1))
    with pytest.raises(DuplicateNodeError, match="2 boot-up messages"):
        heartbeats.boot(NODE)


def test_a_started_node_without_heartbeat_is_reported_with_its_last_state() -> None:
    drive = ScriptedDrive(1)
    _, network, heartbeats = supervised(drive)
    heartbeats.boot(NODE)
    network.command_nmt(START_REMOTE_NODE, 1)
    with pytest.raises(BusTimeoutError, match=r"propeller_drive \(node 1\): started, but its heartbeat says initialising"):
        heartbeats.await_operational(NODE)


def test_a_silent_node_is_lost_after_two_and_a_half_periods() -> None:
    drive = ScriptedDrive(1)
    bus, network, heartbeats = operational(drive)
    drive.silent = True
    network.pump_for(0.2)
    heartbeats.check_one(bus.time_s)
    network.pump_for(0.15)
    with pytest.raises(
        HeartbeatLostError, match=r"propeller_drive \(node 1\): no heartbeat for 0\.\d+ s, 0\.250 s allowed; its last state was operational"
    ):
        heartbeats.check_one(bus.time_s)


def test_time_in_which_the_loop_did_not_look_is_no_silence_of_a_node() -> None:
    drive = ScriptedDrive(1)
    bus, network, _ = operational(drive)
    looking = HeartbeatConsumer(network, NODE, period_s=1 / 256)
    network.pump_for(0.11)
    drive.silent = True
    silent_s = bus.time_s

    def look(ticks: int) -> None:
        for _ in range(ticks):
            network.pump_for(1 / 256)
            looking.check_one(bus.time_s)

    look(20)
    network.pump_for(3.0)
    looking.check_one(bus.time_s)
    with pytest.raises(HeartbeatLostError, match=r"no heartbeat for 0\.2\d+ s"):
        look(200)
    assert 3.1 < bus.time_s - silent_s < 3.4


def test_ticks_that_the_loop_has_lost_are_no_silence_of_a_node() -> None:
    """The node is emulated, and its time moves with the SYNCs that a loaded computer leaves out; what was lost before is nothing."""
    drive = ScriptedDrive(1)
    bus, network, heartbeats = operational(drive)
    heartbeats.check_one(bus.time_s, 5.0)
    network.pump_for(0.11)
    drive.silent = True
    network.pump_for(0.35)
    heartbeats.check_one(bus.time_s, 5.2)
    network.pump_for(0.1)
    with pytest.raises(HeartbeatLostError, match=r"no heartbeat for 0\.2\d+ s"):
        heartbeats.check_one(bus.time_s, 5.2)


def test_a_program_that_stood_still_itself_says_so_while_nodes_may_still_tell_what_they_made_of_it() -> None:
    bus, network, heartbeats = operational(ScriptedDrive(1))
    assert heartbeats.own_silence == ""
    network.start_heartbeat(0x7F, 0.1)

    def wait(hundredths: int) -> None:
        for _ in range(hundredths):
            network.pump_for(0.01)

    wait(30)
    assert heartbeats.own_silence == "", "who waits goes on sending it"
    bus.time_s += 0.3  # 0.15 s after the last
    assert heartbeats.own_silence == "this program stood still: the nodes heard no master for 0.45 s"
    network.send_heartbeat()
    wait(15)
    assert heartbeats.own_silence == "this program stood still: the nodes heard no master for 0.45 s"
    wait(20)
    assert heartbeats.own_silence == "", "a node's heartbeat has come since, or is missed for itself"
    network.stop_heartbeat()
    bus.time_s += 5.0
    assert heartbeats.own_silence == "", "it was ended on purpose"


@pytest.mark.parametrize(
    ("command", "words"), [(0x80, "left operational: pre-operational"), (0x02, "left operational: stopped"), (0x82, "rebooted")]
)
def test_a_node_that_leaves_operational_by_itself_is_noticed(command: int, words: str) -> None:
    drive = ScriptedDrive(1)
    _, network, heartbeats = operational(drive)
    drive.receive(0x000, bytes((command, 1)))
    network.pump_for(0.15)
    assert words in heartbeats.left_operational


def test_an_emergency_is_kept_until_it_is_reset() -> None:
    drive = ScriptedDrive(1)
    _, network, heartbeats = operational(drive)
    drive.emergency(0x2310, 3)
    network.pump_for(0.01)
    assert "continuous overcurrent" in heartbeats.take_fault()
    assert "2310h" in heartbeats.last_emergency(1)
    drive.emergency(0x0000, 0)
    network.pump_for(0.01)
    assert heartbeats.last_emergency(1) == ""
    assert heartbeats.take_fault() == ""


def test_an_emergency_is_told_in_its_vendors_words() -> None:
    drive = ScriptedDrive(1)
    bus = ScriptedBus(drive)
    network = PolledNetwork(bus, BusClock(bus))
    nodes = tuple(replace(node, identity=replace(node.identity, vendor_id=0xFB)) for node in NODE)
    heartbeats = HeartbeatConsumer(network, nodes)
    heartbeats.emergency(1, b"\x90\x10\x01\0\0\0\0\0")
    assert "firmware incompatibility" in heartbeats.take_fault()
    assert "firmware incompatibility" in heartbeats.last_emergency(1)


def test_a_node_that_was_never_heard_has_no_state() -> None:
    _, _, heartbeats = supervised()
    assert heartbeats.nmt_state(1) == "never heard"


def test_a_reboot_that_was_read_together_with_a_heartbeat_accuses_no_second_device() -> None:
    bus, network, heartbeats = operational(ScriptedDrive(1))
    network.pump_for(0.15)
    heartbeats.heartbeat(1, b"\x05")
    heartbeats.heartbeat(1, b"\x00")
    assert heartbeats.left_operational == "propeller_drive (node 1): rebooted"
    assert bus.time_s > 0.0


def test_what_is_no_heartbeat_or_emergency_is_dropped_and_told() -> None:
    _, network, heartbeats = operational(ScriptedDrive(1))
    dropped: list[str] = []
    network.drop = dropped.append  # type: ignore[method-assign]
    for data in (b"", b"\x05\x05", b"\x06"):
        heartbeats.heartbeat(1, data)
    heartbeats.emergency(1, b"\x10")
    assert dropped == [
        "propeller_drive (node 1): a heartbeat of the bytes none, which is no NMT state",
        "propeller_drive (node 1): a heartbeat of the bytes 05 05, which is no NMT state",
        "propeller_drive (node 1): a heartbeat of the bytes 06, which is no NMT state",
        "propeller_drive (node 1): an EMCY of 1 bytes, which has no error code",
    ]
    heartbeats.heartbeat(1, b"\x85")
    assert heartbeats.nmt_state(1) == "operational", "bit 7 is reserved"
    assert heartbeats.left_operational == ""


def test_the_first_fault_is_told_once() -> None:
    drive = ScriptedDrive(1)
    _, network, heartbeats = operational(drive)
    drive.emergency(0x2310, 3)
    drive.emergency(0x3210, 3)
    network.pump_for(0.01)
    assert "2310h" in heartbeats.take_fault()
    assert heartbeats.take_fault() == ""
    assert "3210h" in heartbeats.last_emergency(1)


def test_a_node_that_is_stood_down_may_leave_operational() -> None:
    drive = ScriptedDrive(1)
    _, network, heartbeats = operational(drive)
    heartbeats.stand_down()
    drive.receive(0x000, bytes((0x80, 1)))
    network.pump_for(0.15)
    assert heartbeats.left_operational == ""


def test_a_node_that_was_heard_in_no_state_is_lost_in_an_unknown_one() -> None:
    _, _, heartbeats = supervised()
    heartbeats._nodes[1].heard_s = 0.0
    with pytest.raises(HeartbeatLostError, match=r"its last state was unknown$"):
        heartbeats.check_one(1.0)


def test_a_node_before_its_start_may_be_in_any_state() -> None:
    _, _, heartbeats = supervised()
    heartbeats.heartbeat(1, b"\x7f")
    assert heartbeats.left_operational == ""


def test_a_node_without_a_heartbeat_is_not_missed() -> None:
    bus = ScriptedBus()
    heartbeats = HeartbeatConsumer(PolledNetwork(bus, BusClock(bus)), [replace(NODE[0], heartbeat_period_s=0.0)])
    heartbeats._nodes[1].heard_s = 0.0
    heartbeats.check_one(1e9)


def test_a_started_node_has_two_and_a_half_periods_to_say_so() -> None:
    bus, _, heartbeats = supervised(ScriptedDrive(1))
    heartbeats.boot(NODE)
    began_s = bus.time_s
    with pytest.raises(BusTimeoutError):
        heartbeats.await_operational(NODE)
    assert bus.time_s - began_s == pytest.approx(0.25, abs=0.02)


def test_late_heartbeats_are_told_with_the_longest_and_ticks_that_the_loop_lost_are_none() -> None:
    bus, _, heartbeats = operational(ScriptedDrive(1))
    assert heartbeats.remarks == []
    for pause_s, late in ((0.1, 0), (0.14, 0), (0.16, 1), (0.24, 2), (0.18, 3), (0.1, 3)):
        bus.time_s += pause_s
        heartbeats.heartbeat(1, b"\x05")
        assert bool(heartbeats.remarks) == bool(late)
    assert heartbeats.remarks == ["propeller_drive (node 1): late heartbeats: 3, one after 0.240 s; its period is 0.1 s"]
    bus.time_s += 0.24
    heartbeats.check_one(bus.time_s, 0.1)
    heartbeats.heartbeat(1, b"\x05")
    assert "late heartbeats: 3" in heartbeats.remarks[0]
    heartbeats.await_operational(NODE)
    assert heartbeats.remarks == [], "a start begins to count anew"


def test_a_second_device_is_named_by_the_sixth_heartbeat_that_comes_twice_as_often() -> None:
    bus, network, heartbeats = operational(ScriptedDrive(1))
    for _ in range(5):
        bus.time_s += 0.055
        heartbeats.heartbeat(1, b"\x05")
        assert network.intruder == ""
    bus.time_s += 0.055
    heartbeats.heartbeat(1, b"\x05")
    assert network.intruder.startswith("propeller_drive (node 1): its heartbeat comes more often than every 0.1 s")


@pytest.mark.parametrize("silent", [1, 2])
def test_every_node_is_checked_within_as_many_ticks(silent: int) -> None:
    bus = ScriptedBus()
    heartbeats = HeartbeatConsumer(PolledNetwork(bus, BusClock(bus)), machine_settings().nodes[:2])
    for node in (1, 2):
        heartbeats.heartbeat(node, b"\x05")
    bus.time_s += 0.26
    heartbeats.heartbeat(3 - silent, b"\x05")

    def two_ticks() -> None:
        for _ in range(2):
            heartbeats.check_one(bus.time_s)

    with pytest.raises(HeartbeatLostError, match=rf"\(node {silent}\)"):
        two_ticks()


def test_a_heartbeat_of_before_the_start_is_as_old_as_it_is() -> None:
    bus, _, heartbeats = operational(ScriptedDrive(1))
    bus.time_s += 0.1
    heartbeats.await_operational(NODE)
    bus.time_s += 0.16
    with pytest.raises(HeartbeatLostError):
        heartbeats.check_one(bus.time_s)


def test_a_node_that_was_not_asked_for_a_heartbeat_may_send_one_after_the_start() -> None:
    bus = ScriptedBus()
    nodes = [replace(NODE[0], heartbeat_period_s=0.0)]
    heartbeats = HeartbeatConsumer(PolledNetwork(bus, BusClock(bus)), nodes)
    heartbeats.await_operational(nodes)
    bus.time_s += 5.0
    heartbeats.heartbeat(1, b"\x05")
    assert (heartbeats.left_operational, heartbeats.remarks) == ("", [])


def test_a_node_that_boots_late_is_waited_for_though_others_talk() -> None:
    drive, other = ScriptedDrive(1), ScriptedDrive(9)
    drive.boot_delay_s = 1.9
    drive.answers_sdo = False
    bus, _, heartbeats = supervised(drive, other)
    other.set(0x1017, 0, 100)
    heartbeats.boot(NODE)
    assert 1.9 <= bus.time_s < 2.0


def test_a_node_that_refuses_to_say_what_it_is_is_named() -> None:
    drive = ScriptedDrive(1)
    drive.silent = True
    del drive.objects[0x1000, 0]
    _, _, heartbeats = supervised(drive)
    with pytest.raises(ConfigurationRefusedError, match="propeller_drive"):
        heartbeats.boot(NODE)


def test_an_absent_node_is_told_with_those_that_are_there() -> None:
    bus = ScriptedBus(ScriptedDrive(1), ScriptedDrive(2))
    nodes = machine_settings().nodes[:3]
    with pytest.raises(NodeAbsentError, match=r"^propeller_encoder .* nodes that booted: propeller_drive \(1\), roll_drive \(2\)$"):
        HeartbeatConsumer(PolledNetwork(bus, BusClock(bus)), nodes).boot(nodes)


def test_a_node_that_boots_by_itself_before_its_turn_is_no_second_device() -> None:
    slow, early = ScriptedDrive(1), ScriptedDrive(2)
    slow.boot_delay_s = 1.0
    bus = ScriptedBus(slow, early)
    early.boot_delay_s = 0.3
    early.receive(0x000, bytes((0x82, 2)))  # somebody resets it
    nodes = machine_settings().nodes[:2]
    HeartbeatConsumer(PolledNetwork(bus, BusClock(bus)), nodes).boot(nodes)
    assert 1.0 < bus.time_s < 1.5


def test_what_the_loop_has_lost_since_the_start_is_no_silence_either() -> None:
    bus, _, heartbeats = operational(ScriptedDrive(1))
    bus.time_s += 1.0
    heartbeats.check_one(bus.time_s, 0.9)
    with pytest.raises(HeartbeatLostError):
        heartbeats.check_one(bus.time_s, 0.6)
