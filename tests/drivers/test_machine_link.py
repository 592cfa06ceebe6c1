"""A whole machine in closed loop: timing of the tick, missing and late data, faults, heartbeats, and a stop that always works."""

import dataclasses
import math
import struct

import can
import numpy as np
import pytest
from scripted_nodes import PERIOD_S, BusClock, ScriptedBus, ScriptedDrive, ScriptedEncoder, ScriptedIo, machine_settings

from drivers.canopen.emcy import decode_emergency
from drivers.errors import (
    BusError,
    BusTimeout,
    ConfigurationRefused,
    DeviceFault,
    DuplicateNode,
    HeartbeatLost,
    MotionRefused,
    NodeAbsent,
    WrongIdentity,
)
from drivers.machine_link import CanMachine
from drivers.settings import Pdo

RESOLUTION = 2 * math.pi / (4096 * 150)
ZERO = np.zeros(2)


class Rig:
    """Two axes on the scripted bus."""

    def __init__(self, **options):
        self.drives = [ScriptedDrive(1), ScriptedDrive(2)]
        self.encoders = [ScriptedEncoder(11, self.drives[0]), ScriptedEncoder(12, self.drives[1])]
        self.bus = ScriptedBus(*self.drives, *self.encoders)
        self.clock = BusClock(self.bus)
        self.settings = machine_settings(**options)
        self.io = ScriptedIo(dict(zip(("propeller", "roll"), self.drives, strict=True)))
        self.machine = CanMachine(self.settings, self.bus, self.clock, io=self.io if self.settings.io else None)

    def ready(self):
        self.machine.start()
        self.machine.enable()
        self.machine.release_brakes(lambda _: ZERO)
        return self

    def at_rest(self) -> bool:
        powerless = all(drive.power in ("switch on disabled", "fault") for drive in self.drives)
        return powerless and not any(drive.brake_open for drive in self.drives)


@pytest.fixture
def rig():
    return Rig()


# ---- starting


def test_start_leaves_all_nodes_operational_and_all_drives_without_voltage(rig):
    rig.machine.start()
    assert [node.state for node in rig.bus.nodes] == [0x05] * 4
    assert rig.at_rest()
    assert np.isfinite(rig.machine.sample.position).all()


@pytest.mark.parametrize(
    ("spoil", "error", "words"),
    [
        (lambda r: r.bus.nodes.pop(), NodeAbsent, r"roll_encoder \(node 12\)"),
        (lambda r: r.drives[1].set(0x1018, 2, 7), WrongIdentity, r"roll_drive \(node 2\): product_code is 00000007h"),
        (lambda r: r.drives[0].aborts.update({(0x1A00, 1): 0x06040041}), ConfigurationRefused, "cannot be mapped to the PDO"),
        (lambda r: setattr(r.drives[1], "mute_pdo", True), BusTimeout, r"roll_drive: TPDO 1 \(182h\): no answer"),
    ],
)
def test_a_machine_that_is_not_as_its_file_says_does_not_start(rig, spoil, error, words):
    spoil(rig)
    with pytest.raises(error, match=words):
        rig.machine.start()
    assert rig.at_rest()


def test_two_devices_with_one_id_do_not_start(rig):
    twin = ScriptedDrive(2)
    twin.bus = rig.bus
    rig.bus.nodes.append(twin)
    with pytest.raises(DuplicateNode, match="roll_drive"):
        rig.machine.start()


def test_a_second_bench_on_the_bus_is_refused_before_anything_is_commanded(rig):
    other = ScriptedDrive(127)  # anything that beats with the bench's id
    other.bus = rig.bus
    other.set(0x1017, 0, 100)
    rig.bus.nodes.append(other)
    with pytest.raises(DuplicateNode, match="another bench is running there"):
        rig.machine.start()
    for _ in range(2):  # whoever is refused has nothing to stop: it would stop the other bench in mid-motion
        assert rig.bus.sent(0x000) == [] and rig.io.history == []
        rig.machine.close()


def test_a_closed_machine_is_anybodys_and_a_bench_refused_there_leaves_it_alone(rig):
    rig.ready()
    rig.machine.close()
    rig.bus.log.clear()
    commands = len(rig.io.history)
    other = ScriptedDrive(127)
    other.bus = rig.bus
    other.set(0x1017, 0, 100)
    rig.bus.nodes.append(other)
    with pytest.raises(DuplicateNode):
        rig.machine.start()
    rig.machine.close()
    assert rig.bus.sent(0x000) == [] and len(rig.io.history) == commands


def test_ticks_before_the_start_and_after_a_stop_are_refused(rig):
    with pytest.raises(BusError, match="not started"):
        rig.machine.exchange(ZERO)
    rig.ready()
    rig.machine.stop()
    with pytest.raises(BusError, match="start it first"):
        rig.machine.exchange(ZERO)


@pytest.mark.parametrize(
    ("rpdos", "tpdos", "words"),
    [
        ((Pdo(1, 0x201, 1, ((0x6040, 0, 16),)),), None, "must map controlword and target_torque"),
        ((Pdo(1, 0x201, 1, ((0x6040, 0, 16), (0x6060, 0, 8))),), None, "fills controlword and target_torque and nothing else"),
        (None, (Pdo(1, 0x181, 1, ((0x6041, 0, 16),)),), "no TPDO with transmission type 1 maps position_actual_value"),
        (None, (Pdo(1, 0x181, 255, ((0x6041, 0, 16), (0x6064, 0, 32))),), "no TPDO with transmission type 1 maps statusword"),
    ],
)
def test_pdos_that_cannot_run_the_loop_are_refused_before_the_bus_is_touched(rig, rpdos, tpdos, words):
    drive = rig.settings.nodes[0]
    drive = dataclasses.replace(drive, rpdos=rpdos or drive.rpdos, tpdos=tpdos or drive.tpdos)
    settings = dataclasses.replace(rig.settings, nodes=(drive, *rig.settings.nodes[1:]))
    with pytest.raises(ConfigurationRefused, match=words):
        CanMachine(settings, rig.bus, rig.clock)
    assert rig.bus.log == []


# ---- the tick


def test_a_tick_is_rpdos_then_sync_then_tpdos_and_the_effort_answers_to_the_command(rig):
    rig.ready()
    rig.bus.log.clear()
    sample = rig.machine.exchange(np.array([1.0, -2.5]))
    frames = [(can_id, data.hex(" ")) for _, can_id, data in rig.bus.log if can_id < 0x700]
    assert frames[:3] == [(0x201, "0f 00 c8 00"), (0x202, "0f 00 0c fe"), (0x080, "")]  # 200 and -500 per mille of 5 A
    assert [can_id for can_id, _ in frames[3:]] == [0x181, 0x182, 0x18B, 0x18C]
    assert sample.effort == pytest.approx([1.0, -2.5])
    assert sample.statusword.tolist() == [0x237, 0x237]
    assert sample.age_s.tolist() == [0.0, 0.0]


def test_split_and_swapped_rpdos_carry_the_same_values(rig):
    drives = list(rig.settings.nodes[:2])
    drives[0] = dataclasses.replace(drives[0], rpdos=(Pdo(1, 0x201, 1, ((0x6071, 0, 16), (0x6040, 0, 16))),))
    drives[1] = dataclasses.replace(drives[1], rpdos=(Pdo(1, 0x202, 1, ((0x6040, 0, 16),)), Pdo(2, 0x302, 1, ((0x6071, 0, 16),))))
    rig.machine = CanMachine(dataclasses.replace(rig.settings, nodes=(*drives, *rig.settings.nodes[2:])), rig.bus, rig.clock)
    rig.machine.start()
    rig.bus.log.clear()
    rig.machine.exchange(np.array([1.0, -2.5]))
    assert [data.hex() for _, can_id, data in rig.bus.log if can_id in (0x201, 0x202, 0x302)] == ["c8000000", "0000", "0cfe"]


def test_commands_are_clipped_to_the_axis_limit(rig):
    rig.ready()
    sample = rig.machine.exchange(np.array([9.0, -1e6]))
    assert sample.effort == pytest.approx([8.0, -8.0])


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_command_that_is_no_number_is_not_sent_and_stops_the_machine(rig, value):
    rig.ready()
    with pytest.raises(MotionRefused, match="roll: the command is"):
        rig.machine.exchange(np.array([0.0, value]))
    assert rig.at_rest()


def test_a_reversed_axis_reverses_position_and_effort_together():
    rig = Rig(sign=-1)
    rig.ready()
    before = rig.machine.exchange(ZERO).position.copy()
    sample = rig.machine.exchange(np.array([1.0, 0.0]))
    assert struct.unpack("<h", rig.drives[0].objects[0x6071, 0])[0] == -200
    assert sample.effort[0] == pytest.approx(1.0)
    assert sample.position[0] > before[0]


def test_the_own_heartbeat_goes_out_by_tick_count_behind_the_rpdos(rig):
    rig.ready()
    rig.bus.log.clear()
    for _ in range(100):
        rig.machine.exchange(ZERO)
    ids = [can_id for _, can_id, _ in rig.bus.log]
    beats = [k for k, can_id in enumerate(ids) if can_id == 0x77F]
    assert len(beats) == 4  # 0.1 s is 25.6 ticks: every 25
    assert all(ids[k - 1] == 0x202 and ids[k + 1] == 0x080 for k in beats)
    syncs = [ids[:k].count(0x080) for k in beats]
    assert set(np.diff(syncs)) == {25}


def test_runs_are_repeatable_frame_by_frame():
    logs = []
    for _ in range(2):
        rig = Rig().ready()
        for k in range(50):
            rig.machine.exchange(np.array([0.1 * (k % 7), -0.1]))
        rig.machine.close()
        logs.append(rig.bus.log)
    assert logs[0] == logs[1]


def test_a_missing_pdo_is_nan_in_its_row_and_ages(rig):
    rig.ready()
    rig.drives[1].mute_pdo = True
    for k in range(1, 4):
        sample = rig.machine.exchange(ZERO)
        assert np.isfinite(sample.position[0]) and np.isnan(sample.position[1]) and np.isnan(sample.effort[1])
        assert sample.statusword[1] == -1
        assert sample.age_s == pytest.approx([0.0, k * PERIOD_S])
    rig.drives[1].mute_pdo = False
    sample = rig.machine.exchange(ZERO)
    assert np.isfinite(sample.position[1]) and sample.age_s[1] == 0.0


def test_waiting_for_a_missing_pdo_ends_with_the_answer_time(rig):
    rig.ready()
    rig.drives[1].mute_pdo = True
    start = rig.bus.time_s
    rig.machine.exchange(ZERO)
    assert rig.bus.time_s - start == pytest.approx(PERIOD_S + 0.0025, abs=1e-9)


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next_syncs(rig):
    rig.ready()
    last = rig.encoders[1]
    last.mute_pdo = True
    rig.machine.exchange(ZERO)
    rig.bus.emit(0x18C, struct.pack("<I", 4194304 + 99999))  # what the encoder owed to the last SYNC
    last.mute_pdo = False
    sample = rig.machine.exchange(ZERO)
    assert sample.link_position[1] == pytest.approx((last.value(0x6004) - 4194304) * 2 * math.pi / 2**23)


def test_a_pdo_that_is_too_short_is_a_fault_in_words_and_no_value(rig):
    rig.ready()
    rig.drives[0].set(0x1A00, 0, 1)
    sample = rig.machine.exchange(ZERO)
    assert np.isnan(sample.position[0])
    assert sample.fault == "propeller_drive: TPDO 1 (181h): PDO of 2 bytes where 8 are mapped"


@pytest.mark.parametrize("step", [1, -1])
def test_the_position_runs_on_where_the_drives_counter_wraps(rig, step):
    rig.ready()
    edge = 2**31 - 3 if step > 0 else -(2**31) + 2
    for counts in (edge // 2, edge):  # a step of more than half the counter's range would itself look like a wrap
        rig.drives[0].counts = float(counts)
        before = rig.machine.exchange(ZERO).position[0]
    for k in range(1, 8):
        counts = edge + step * k
        rig.drives[0].counts = float((counts + 2**31) % 2**32 - 2**31)
        assert rig.machine.exchange(ZERO).position[0] == pytest.approx(before + step * k * RESOLUTION, abs=1e-9)


def test_link_positions_come_from_the_absolute_encoder(rig):
    rig.ready()
    rig.drives[1].link_counts = 4194304 + 1000
    assert rig.machine.exchange(ZERO).link_position[1] == pytest.approx(1000 * 2 * math.pi / 2**23)


# ---- things go wrong


def test_a_drive_that_falls_into_fault_stops_everything_and_is_explained(rig):
    rig.ready()
    rig.drives[1].fail(0x2310)
    with pytest.raises(DeviceFault, match=r"roll_drive \(node 2\): left operation enabled: fault .*EMCY 2310h: continuous overcurrent"):
        rig.machine.exchange(ZERO)
    assert rig.at_rest()
    assert decode_emergency(rig.bus.sent(0x082)[-1]).code == 0x2310


def test_a_drive_that_is_switched_off_by_somebody_else_is_a_fault(rig):
    rig.ready()
    rig.drives[0].power = "switched on"
    rig.drives[0].refuses_enable = True
    with pytest.raises(DeviceFault, match=r"propeller_drive .*left operation enabled: switched on"):
        rig.machine.exchange(ZERO)
    assert rig.at_rest()


def test_an_emergency_of_any_node_is_in_the_sample(rig):
    rig.ready()
    rig.encoders[0].emergency(0x5000, 0x01)
    faults = [rig.machine.exchange(ZERO).fault for _ in range(3)]
    assert any("propeller_encoder (node 11): EMCY 5000h: device hardware" in fault for fault in faults)
    assert faults[-1] == ""


def test_a_node_that_leaves_operational_stops_everything(rig):
    rig.ready()
    rig.encoders[0].receive(0x000, bytes((0x80, 11)))
    with pytest.raises(DeviceFault, match=r"propeller_encoder \(node 11\): left operational: pre-operational"):
        for _ in range(60):
            rig.machine.exchange(ZERO)
    assert rig.at_rest()


def test_a_controller_that_went_bus_off_is_a_fault(rig):
    rig.ready()
    rig.bus.queue.append(can.Message(arbitration_id=0x040, is_error_frame=True, is_extended_id=False, dlc=8))
    assert "bus off" in rig.machine.exchange(ZERO).fault


def test_a_node_that_falls_silent_stops_everything_within_its_time_out(rig):
    rig.ready()
    rig.encoders[1].silent = True
    start = rig.bus.time_s
    with pytest.raises(HeartbeatLost, match=r"roll_encoder \(node 12\)"):
        for _ in range(1000):
            rig.machine.exchange(ZERO)
    assert rig.bus.time_s - start < 0.1 + 0.25 + 8 * PERIOD_S + 0.7  # its period, its tolerance, the round of checks, the stop
    assert rig.at_rest()


def test_a_bus_that_dies_still_closes_the_brakes(rig):
    rig.ready()
    rig.bus.broken = True
    with pytest.raises(BusError, match="interface went down"):
        rig.machine.exchange(ZERO)
    assert rig.io.history[-1] == {"propeller": False, "roll": False}
    assert rig.machine.stop_trouble and "quick stop" in rig.machine.stop_trouble[0]


def test_lost_io_does_not_keep_the_drives_from_being_stopped(rig):
    rig.ready()

    def gone(*_):
        raise BusError("Modbus server is gone")

    rig.io.poll_due = gone
    with pytest.raises(BusError, match="Modbus server is gone"):
        rig.machine.exchange(ZERO)
    assert all(drive.power == "switch on disabled" for drive in rig.drives)
    assert any("Modbus server is gone" in trouble for trouble in rig.machine.stop_trouble)


@pytest.mark.parametrize("stage", ["started", "enabled", "released", "faulted", "stopped"])
def test_stop_works_from_every_state_and_again(rig, stage):
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


def test_stop_orders_quick_stop_before_voltage_off_and_waits_for_the_brakes_in_between(rig):
    rig.ready()
    rig.bus.log.clear()
    rig.io.delay_polls = 10
    rig.machine.stop()
    words = [struct.unpack_from("<H", data)[0] for data in rig.bus.sent(0x201)]
    quick_stops = words.index(0x0000)
    assert words[:quick_stops] == [0x0002] * quick_stops and quick_stops >= 10
    assert set(words[quick_stops:]) == {0x0000}


def test_no_drive_loses_its_voltage_during_a_stop_before_its_brake_has_closed(rig, monkeypatch):
    rig.ready()
    rig.io.delay_polls = 20  # brakes take longer than the drives' standstill
    seen = []
    original = ScriptedDrive.on_sync

    def watch(drive):
        original(drive)
        seen.append((drive.power, drive.brake_open))

    monkeypatch.setattr(ScriptedDrive, "on_sync", watch)
    rig.machine.stop()
    assert seen.count(("quick stop active", True)) > 20 and seen[-1] == ("switch on disabled", False)
    assert ("switch on disabled", True) not in seen


def quick_stop_of_a_turning_axis(ramp, monkeypatch):
    """One axis without a brake turns by 20 counts a tick and is stopped: its (power, speed) tick by tick, and how long the stop took."""
    rig = Rig(io=False)
    rig.machine.start()
    rig.machine.enable()
    drive = rig.drives[0]
    drive.brake_open, drive.speed, drive.ramp = True, 20.0, ramp
    seen = []
    original = ScriptedDrive.on_sync

    def watch(node):
        original(node)
        if node is drive:
            seen.append((node.power, node.speed))

    monkeypatch.setattr(ScriptedDrive, "on_sync", watch)
    start = rig.bus.time_s
    rig.machine.stop()
    assert [d.power for d in rig.drives] == ["switch on disabled"] * 2
    return seen, rig.bus.time_s - start


def test_an_axis_without_a_brake_keeps_its_voltage_until_it_stands(monkeypatch):
    seen, seconds = quick_stop_of_a_turning_axis(1.0, monkeypatch)
    assert all(speed == 0.0 for power, speed in seen if power == "switch on disabled")
    assert seen.count(("quick stop active", 0.0)) == pytest.approx(0.05 / PERIOD_S, abs=2)
    assert seconds < 0.2


def test_an_axis_without_a_brake_that_never_stands_does_not_hold_up_the_stop_for_ever(monkeypatch):
    _, seconds = quick_stop_of_a_turning_axis(0.0, monkeypatch)
    assert 0.6 < seconds < 0.7


def test_an_axis_without_a_brake_whose_position_is_lost_is_not_taken_for_standing(monkeypatch):
    rig = Rig(io=False)
    rig.machine.start()
    rig.machine.enable()
    rig.drives[0].mute_pdo = True
    start = rig.bus.time_s
    rig.machine.stop()
    assert rig.bus.time_s - start > 0.6


def test_a_brake_that_jams_open_does_not_hold_up_the_stop_for_ever(rig):
    rig.ready()
    rig.io.jammed = {"roll"}
    start = rig.bus.time_s
    rig.machine.stop()
    assert rig.bus.time_s - start < 1.0
    assert all(drive.power == "switch on disabled" for drive in rig.drives)


def test_voltage_stays_on_while_nobody_knows_whether_the_brakes_have_closed(rig):
    rig.ready()
    rig.io.age_s = 10.0
    start = rig.bus.time_s
    rig.machine.stop()
    assert rig.bus.time_s - start > 0.5


def test_a_stopped_machine_starts_again_without_a_new_link(rig):
    rig.ready()
    rig.machine.stop()
    rig.ready()
    assert np.isfinite(rig.machine.exchange(ZERO).position).all()


def test_close_resets_communication_so_that_nodes_forget_the_bench(rig):
    rig.ready()
    rig.machine.close()
    resets = [data for data in rig.bus.sent(0x000) if data[0] == 0x82]
    assert resets[-4:] == [bytes((0x82, node_id)) for node_id in (1, 2, 11, 12)]
