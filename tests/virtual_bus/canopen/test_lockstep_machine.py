"""The whole machine on the lockstep bus: timing, order of frames, time, repeatability."""

from __future__ import annotations

import io
import math
import re
import struct

import can
import numpy as np
import pytest
from device_wires import PERIOD_S, SpinningMasses, two_axis_bus, u32
from lockstep_client import NO_RTR, OFF, Master

from virtual_bus.lockstep import MOST_HEARD, LockstepBus, imu_line, io_line
from virtual_bus.machine import EmulatedMachine
from virtual_bus.modbus.io_device import EmulatedIo, IoLayout
from virtual_bus.serial.xsens_imu import EmulatedImu


def enabled(position: tuple[float, float] = (0.0, 0.0), **options: object) -> Master:
    master = Master(position=position, **options)
    master.configure()
    master.enable(1, 2)
    return master


def test_a_target_acts_from_the_next_sync_and_shows_in_its_current() -> None:
    """Contract: at SYNC k the drives apply command k-1 and latch; between rows k and k+1 the plant feels it."""
    master = enabled()
    felt, seen = [], []
    targets = [100, -50, 0, 300]
    for target in targets:
        answers = master.tick({1: 0x0F, 2: 0x0F}, {1: target, 2: 0})
        felt.append(master.physics.effort[0])
        seen.append(struct.unpack("<Hih", answers[0x181])[2])
    assert felt == pytest.approx([0.005 * target for target in targets])
    assert seen == targets


def test_position_in_row_k_is_before_the_motion_of_row_k() -> None:
    master = enabled()
    physics = master.physics
    for _ in range(10):
        before = physics.position.copy()
        answers = master.tick({1: 0x0F, 2: 0x0F}, {1: 1000, 2: -1000})
        for axis, node in enumerate((1, 2)):
            counts = struct.unpack("<Hih", answers[0x180 + node])[1]
            assert counts == round(before[axis] / (2 * np.pi / 409600))


def test_one_sync_is_one_period() -> None:
    master = enabled()
    advanced, time_s = master.physics.advanced, master.machine.time_s
    for _ in range(256):
        master.tick({1: 0x0F, 2: 0x0F}, {})
    assert master.physics.advanced - advanced == 256
    assert master.machine.time_s - time_s == pytest.approx(1.0, abs=1e-12)


def test_answers_come_in_node_order_after_heartbeats() -> None:
    master = Master()
    master.configure(heartbeat_ms=100)
    orders = set()
    for _ in range(512):
        master.send(0x080)
        ids = [can_id for can_id, _ in master.drain()]
        heartbeats = [can_id for can_id in ids if can_id >= 0x700]
        assert ids == [*heartbeats, 0x181, 0x182, 0x18B, 0x18C]
        assert heartbeats == sorted(heartbeats)
        orders.add(bool(heartbeats))
    assert orders == {True, False}


def script(master: Master) -> str:
    master.configure(heartbeat_ms=50)
    master.enable(1, 2)
    for k in range(300):
        master.tick({1: 0x0F, 2: 0x0F}, {1: k % 70 - 35, 2: (k * k) % 41 - 20})
    master.wait(0.4)
    master.tick({1: 0x02, 2: 0x02}, {})
    return master.log.getvalue()


def test_the_same_run_gives_the_same_frames() -> None:
    first, second = script(Master()), script(Master())
    assert len(first.splitlines()) > 2000
    assert first == second


def test_the_log_is_in_candumps_form_and_holds_both_directions() -> None:
    master = enabled()
    lines = master.log.getvalue().splitlines()
    form = re.compile(r"\((\d+\.\d{6})\) lockstep ([0-9A-F]{3})#((?:[0-9A-F]{2}){0,8})")
    stamps = [float(form.fullmatch(line).group(1)) for line in lines]  # type: ignore[union-attr]
    assert stamps == sorted(stamps)
    assert "(0.000000) lockstep 080#" in lines
    assert "(0.003906) lockstep 080#" in lines
    assert any(" 201#" in line for line in lines)
    assert any(" 181#" in line for line in lines)
    assert next(iter(can.CanutilsLogReader(io.StringIO(master.log.getvalue())))).arbitration_id == 0x601


def test_configuration_takes_no_machine_time() -> None:
    master = Master()
    master.configure(heartbeat_ms=10)
    assert master.machine.time_s == 0.0
    assert not [1 for can_id, _ in master.seen if can_id > 0x700]


def test_waiting_lets_the_machine_live() -> None:
    master = Master()
    master.configure(heartbeat_ms=100)
    came = master.wait(2.0)
    heartbeats = [can_id for can_id, _ in came if can_id == 0x701]
    assert len(heartbeats) == pytest.approx(20, abs=1)
    assert master.machine.time_s == pytest.approx(2.0, abs=2 * PERIOD_S)
    assert master.bus.time_s == pytest.approx(2.0)


@pytest.mark.parametrize("pause_s", [0.003, 0.01, 0.1])
def test_time_passes_for_a_master_that_polls_slowly(pause_s: float) -> None:
    master = Master()
    for _ in range(round(2.0 / pause_s)):
        master.read(1, 0x6041)
        master.wait(pause_s)
    assert master.machine.time_s == pytest.approx(2.0, abs=2 * pause_s)


def test_between_syncs_nothing_else_moves_time() -> None:
    master = Master()
    for _ in range(100):
        master.tick({}, {})
        master.wait(0.04)
    assert master.machine.time_s == pytest.approx(100 * PERIOD_S)


def test_a_master_that_reacts_to_a_heartbeat_finds_the_machine_where_it_spoke() -> None:
    master = Master()
    master.configure(heartbeat_ms=100)
    while not [can_id for can_id, _ in master.wait(0.001) if can_id > 0x700]:
        pass
    spoke_s = master.machine.time_s
    master.wait(0.015)
    assert master.machine.time_s == spoke_s


@pytest.mark.slow
@pytest.mark.parametrize("start", range(12))
def test_heartbeats_fall_on_the_same_syncs_whenever_they_began(start: int) -> None:
    """25.6 samples are 0.1 s: every fifth heartbeat falls on a sample exactly, and rounding must not decide."""
    master = Master()
    for _ in range(start * 977):
        master.machine.receive(0x080, b"")
    master.configure(heartbeat_ms=100)
    ticks = [k for k in range(700) if 0x701 in master.tick({}, {})]
    assert ticks == [math.ceil(n * 25.6) for n in range(28)]


def test_an_event_driven_device_tells_between_syncs_what_has_changed() -> None:
    master = Master()
    off, on = 0x18B | OFF | NO_RTR, 0x18B | NO_RTR
    for subindex, data in ((1, u32(off)), (2, b"\xff"), (1, u32(on))):
        master.write(11, 0x1800, subindex, data)
    master.send(0x000, bytes((1, 11)))
    *_, (_, first) = master.wait(1.0)
    assert master.wait(1.0) == []
    master.physics.position[0] += 0.5
    ((can_id, then),) = master.wait(1.0)
    assert can_id == 0x18B
    assert int.from_bytes(then, "little") - int.from_bytes(first, "little") == round(0.5 / (2.0 * np.pi / 8388608))


def test_a_drive_that_expects_a_counter_says_that_a_sync_has_none_and_the_other_the_opposite() -> None:
    master = Master()
    master.write(1, 0x1019, 0, b"\x0a")
    master.configure()

    def told(sync: bytes) -> list[int]:
        master.send(0x080, sync)
        return [can_id for can_id, data in master.drain() if data[:2] == b"\x40\x82"]

    assert told(b"") == [0x081]
    assert told(b"\x01") == [0x082, 0x08B, 0x08C]


def test_waiting_draws_no_noise_and_triggers_nothing() -> None:
    """Rows of a run must not depend on how long somebody waited before it."""
    times: list[float] = []
    master = Master(witness=times.append)
    master.wait(1.0)
    assert master.physics.rows == 0
    assert times == []
    master.tick({}, {})
    assert master.physics.rows == 1
    assert len(times) == 1


def test_receiving_with_a_time_out_waits_in_virtual_time_only() -> None:
    master = Master()
    assert master.bus.recv(0.0) is None
    assert master.bus.time_s == 0.0
    assert master.bus.recv(1.5) is None
    assert master.bus.time_s == pytest.approx(1.5)
    master.write(1, 0x1017, 0, b"\xf4\x01")
    message = master.bus.recv(5.0)
    assert message is not None
    assert message.arbitration_id == 0x701
    assert master.bus.time_s < 1.7


def test_it_is_a_python_can_bus() -> None:
    master = Master()
    master.bus.set_filters([{"can_id": 0x581, "can_mask": 0x7FF}])
    for node in (2, 1):
        master.send(0x600 + node, bytes.fromhex("40 00 10 00 00 00 00 00"))
    message = master.bus.recv(0.0)
    assert message is not None
    assert message.arbitration_id == 0x581
    assert (message.dlc, message.is_extended_id, message.is_rx) == (8, False, True)
    assert "581" in str(message)
    assert master.bus.recv(0.0) is None


def test_frames_without_message_objects_are_filtered_as_well() -> None:
    master = Master()
    master.bus.set_filters([{"can_id": 0x581, "can_mask": 0x7FF}])
    for node in (2, 1):
        master.send(0x600 + node, bytes.fromhex("40 00 10 00 00 00 00 00"))
    assert [can_id for can_id, _ in master.bus.waiting_frames()] == [0x581]


def test_who_listens_is_called_before_the_machine_hears_a_sync_and_whenever_many_frames_wait() -> None:
    master, heard, calls = Master(), [], []
    master.configure(heartbeat_ms=100)

    def listener() -> None:
        calls.append((master.machine.syncs, list(zip(*[iter(heard)] * 3, strict=True))))
        heard.clear()

    master.bus.tap(heard, listener)
    for _ in range(3):
        syncs, time_s = master.machine.syncs, master.bus.time_s
        master.send(0x201, bytes(4))
        master.send(0x080)
        at, frames = calls.pop()
        assert at == syncs
        assert frames[-2:] == [(0x201, bytes(4), time_s), (0x080, b"", time_s)]
        answers = [can_id for can_id in heard[::3] if can_id < 0x700]
        assert answers == [0x181, 0x182, 0x18B, 0x18C], "told with the next SYNC"
    master.bus.pass_time(10.0)
    assert sum(len(frames) for _, frames in calls) > 200
    assert {3 * len(frames) for _, frames in calls} == {MOST_HEARD}
    calls.clear()
    for _ in range(MOST_HEARD):
        master.send(0x7FF)
    assert len(calls) >= 3


def test_remote_and_long_frames_find_no_listener() -> None:
    master = Master()
    master.bus.send(can.Message(arbitration_id=0x601, is_remote_frame=True, dlc=8, is_extended_id=False))
    master.bus.send(can.Message(arbitration_id=0x601, data=bytes(8), is_extended_id=True))
    assert master.drain() == []


def test_the_machine_was_on_before_the_bench_came() -> None:
    assert Master().drain() == []


def test_a_sender_may_use_its_message_again() -> None:
    master = enabled()
    message = can.Message(arbitration_id=0x201, data=bytearray(struct.pack("<Hh", 0x0F, 100)), is_extended_id=False)
    master.bus.send(message)
    message.data[2:] = struct.pack("<h", 999)
    master.tick({}, {})
    assert master.physics.effort[0] == pytest.approx(0.5)


def test_link_encoders_show_the_joint_in_absolute_counts() -> None:
    master = Master(position=(0.25, -0.5))
    master.configure()
    answers = master.tick({}, {})
    for node, position in ((11, 0.25), (12, -0.5)):
        assert struct.unpack("<I", answers[0x180 + node])[0] == 4194304 + round(position / (2 * np.pi) * 8388608)
    assert struct.unpack("<Hih", answers[0x181])[1] == 0, "the motor side is incremental"


def test_without_an_io_device_each_drive_works_its_own_brake() -> None:
    master = Master()
    master.configure()
    assert master.physics.closed.tolist() == [True, True]
    master.enable(2)
    assert master.physics.closed.tolist() == [True, False]
    for _ in range(100):
        master.tick({2: 0x00}, {})
    assert master.physics.closed.tolist() == [True, True]


LAYOUT = IoLayout(1, {"propeller": 0, "roll": 1}, {"propeller": 0, "roll": 1}, 8, 9, {"propeller": 0, "roll": 1})


def with_io() -> tuple[EmulatedMachine, SpinningMasses, LockstepBus]:
    physics = SpinningMasses()
    device = EmulatedIo(LAYOUT, physics.axes, on_brakes=physics.set_brakes)
    machine = EmulatedMachine(physics, two_axis_bus(), PERIOD_S, imu=EmulatedImu(), io=device)  # type: ignore[arg-type]
    machine.place(np.zeros(2))
    bus = LockstepBus(machine)
    return machine, physics, bus


def test_brakes_open_after_their_coil_and_their_feedback_follows() -> None:
    machine, physics, bus = with_io()
    line = io_line(machine)
    line.write(bytes.fromhex("0001 0000 0006 01 05 0001 FF00"))  # Modbus/TCP: write coil 1
    assert line.read() == bytes.fromhex("0001 0000 0006 01 05 0001 FF00")
    sync = can.Message(arbitration_id=0x080, is_extended_id=False)
    ticks = 0
    while physics.closed[1]:
        bus.send(sync)
        ticks += 1
    assert ticks * PERIOD_S == pytest.approx(0.04, abs=3 * PERIOD_S)
    line.write(bytes.fromhex("0002 0000 0006 01 02 0000 000A"))  # read discrete inputs 0 to 9
    assert line.read() == bytes.fromhex("0002 0000 0005 01 02 02 02 03"), "roll open, hold-to-run pressed, door closed"
    bus.shutdown()


def test_temperatures_reach_the_registers() -> None:
    machine, physics, bus = with_io()
    physics.temperature_degC = 31.5
    line = io_line(machine)
    for _ in range(20):
        bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
    line.write(bytes.fromhex("0003 0000 0006 01 04 0000 0002"))
    assert line.read() == bytes.fromhex("0003 0000 0007 01 04 04 013B 013B")
    bus.shutdown()


def test_the_imu_answers_on_its_line_and_measures_at_the_sync() -> None:
    machine, _, bus = with_io()
    line = imu_line(machine)
    line.write(bytes.fromhex("FA FF 30 00 D1"))  # GoToConfig
    assert line.read() == bytes.fromhex("FA FF 31 00 D0")
    line.write(bytes.fromhex("FA FF 10 00 F1"))  # GoToMeasurement
    assert line.read() == bytes.fromhex("FA FF 11 00 F0")
    for _ in range(27):  # up to 0.1 s on its own clock of 100 Hz
        bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
    assert line.read().count(b"\xfa\xff\x36") == 10
    bus.shutdown()


def test_a_witness_sees_every_latched_sample() -> None:
    times: list[float] = []
    master = Master(witness=times.append)
    for _ in range(5):
        master.tick({}, {})
    assert times == pytest.approx([k * PERIOD_S for k in range(5)])


def test_an_identifier_nobody_listens_to_is_nobodys_business() -> None:
    master = Master()
    for can_id in range(0x800):
        if can_id not in (0x000, 0x080):
            master.send(can_id, bytes(8))
    assert {can_id for can_id, _ in master.drain()} <= {0x581, 0x582, 0x58B, 0x58C}


def test_two_nodes_on_one_emergency_identifier_still_have_their_own_words() -> None:
    master = Master()
    master.write(1, 0x1014, 0, u32(0x80000081))
    master.machine.drives["propeller_drive"].inject_fault(0x2310)
    assert master.drain() == []
    master.machine.drives["roll_drive"].inject_fault(0x2310)
    assert [can_id for can_id, _ in master.drain()] == [0x082]
