"""The drive with a motor on it: torque, limits, stops, homing, loss of the master."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from device_wires import COUNTS_PER_TURN, PERIOD_S, RESOLUTION
from lockstep_client import Master, one_axis, one_axis_bus

from virtual_bus.canopen.motion import VelocityGains, VelocityLoop

OPERATION_ENABLED, FAULT, QUICK_STOP_ACTIVE, SWITCH_ON_DISABLED = 0x27, 0x08, 0x07, 0x40
TARGET_REACHED, INTERNAL_LIMIT, HOMING_ATTAINED, HOMING_ERROR, FOLLOWS = 1 << 10, 1 << 11, 1 << 12, 1 << 13, 1 << 12


def state(statusword: int) -> int:
    return statusword & (0x4F if statusword & 0x48 in (0x40, 0x08) else 0x6F)


@pytest.mark.parametrize(("target", "effort"), [(0, 0.0), (1, 0.005), (-1, -0.005), (333, 1.665), (1600, 8.0), (-1600, -8.0)])
def test_the_motor_feels_per_mille_of_the_rated_current(target: int, effort: float) -> None:
    master = one_axis()
    master.tick({2: 0x0F}, {2: target})
    assert master.physics.effort[0] == pytest.approx(effort, abs=1e-12)
    assert master.read(2, 0x6074, signed=True) == target


def test_the_measured_current_is_what_the_motor_felt() -> None:
    master = one_axis()
    master.tick({2: 0x0F}, {2: 200})
    statusword, _, current = master.sample(2)
    assert current == 200
    assert statusword & FOLLOWS
    assert master.read(2, 0x6077, signed=True) == 200


@pytest.mark.parametrize(("index", "limit"), [(0x6072, 500), (0x6073, 700)])
def test_a_target_beyond_the_limit_is_cut_and_shown(index: int, limit: int) -> None:
    master = one_axis()
    master.write(2, index, 0, struct.pack("<H", limit))
    for target, felt, shown in ((limit, limit, False), (limit + 1, limit, True), (-3000, -limit, True), (0, 0, False)):
        master.tick({2: 0x0F}, {2: target})
        assert master.physics.effort[0] == pytest.approx(felt * 0.005)
        assert bool(master.sample(2)[0] & INTERNAL_LIMIT) == shown


def test_a_drive_that_is_not_enabled_gives_no_torque() -> None:
    master = one_axis()
    for word in (0x07, 0x06, 0x00):
        master.tick({2: word}, {2: 500})
        for _ in range(60):
            master.sample(2)
        assert master.physics.effort[0] == 0.0


def test_position_counts_as_the_motor_turns() -> None:
    master = one_axis()
    for _ in range(256):
        master.tick({2: 0x0F}, {2: 100})
    _, position, _ = master.sample(2)
    assert position == round(master.physics.position[0] / RESOLUTION) - round(master.physics.speed[0] * PERIOD_S / RESOLUTION)
    assert master.physics.position[0] == pytest.approx(0.5 * 0.5 * 1.0**2, rel=0.02)
    speed = master.read(2, 0x606C, signed=True)
    assert speed * RESOLUTION == pytest.approx(master.physics.speed[0], rel=0.03)


def test_a_drive_wired_the_other_way_round_shows_it_on_the_wire_only() -> None:
    forward, backward = one_axis(), one_axis(sign=-1)
    for _ in range(50):
        forward.tick({2: 0x0F}, {2: 100})
        backward.tick({2: 0x0F}, {2: -100})
    assert backward.physics.position[0] == forward.physics.position[0] > 0.0
    assert backward.sample(2)[1:] == tuple(-value for value in forward.sample(2)[1:])


def spin_up(master: Master, seconds: float = 0.5, target: int = 400) -> None:
    for _ in range(round(seconds / PERIOD_S)):
        master.tick({2: 0x0F}, {2: target})


@pytest.mark.parametrize(
    ("option", "ramp_index", "ends"),
    [(1, 0x6084, SWITCH_ON_DISABLED), (2, 0x6085, SWITCH_ON_DISABLED), (5, 0x6084, QUICK_STOP_ACTIVE), (6, 0x6085, QUICK_STOP_ACTIVE)],
)
def test_a_quick_stop_ramps_down_as_its_option_says(option: int, ramp_index: int, ends: int) -> None:
    master = one_axis()
    deceleration = 2.0 if ramp_index == 0x6085 else 1.25  # rad/s^2
    master.write(2, ramp_index, 0, struct.pack("<I", round(deceleration / RESOLUTION)))
    master.write(2, 0x605A, 0, struct.pack("<h", option))
    spin_up(master)
    speed = float(master.physics.speed[0])
    assert speed == pytest.approx(1.0, rel=0.02)
    ticks = 0
    while abs(master.physics.speed[0]) > 0.05 * speed:
        master.tick({2: 0x02}, {2: 400})
        ticks += 1
    assert ticks * PERIOD_S == pytest.approx(0.95 * speed / deceleration, rel=0.2)
    for _ in range(400):
        statusword, _, _ = master.sample(2)
    assert state(statusword) == ends
    assert abs(master.physics.speed[0]) < 0.01


def test_a_quick_stop_with_option_0_lets_the_motor_coast() -> None:
    master = one_axis()
    master.write(2, 0x605A, 0, struct.pack("<h", 0))
    spin_up(master)
    master.tick({2: 0x02}, {2: 400})
    statusword, _, _ = master.sample(2)
    assert state(statusword) == SWITCH_ON_DISABLED
    assert master.physics.effort[0] == 0.0


def test_a_hard_stop_uses_the_torque_limit() -> None:
    master = one_axis()
    master.write(2, 0x605A, 0, struct.pack("<h", 7))
    spin_up(master)
    master.tick({2: 0x02}, {})
    assert master.physics.effort[0] == -8.0
    assert master.sample(2)[0] & INTERNAL_LIMIT


def test_halt_holds_and_release_resumes() -> None:
    master = one_axis()
    spin_up(master)
    for _ in range(400):
        master.tick({2: 0x010F}, {2: 400})
    statusword, _, _ = master.sample(2)
    assert state(statusword) == OPERATION_ENABLED
    assert statusword & TARGET_REACHED
    assert abs(master.physics.speed[0]) < 0.01
    master.tick({2: 0x000F}, {2: 400})
    assert master.physics.effort[0] == pytest.approx(2.0)


def test_a_stopped_drive_holds_against_a_load() -> None:
    master = one_axis()
    master.write(2, 0x605A, 0, struct.pack("<h", 6))
    master.physics.load[0] = 1.5
    for _ in range(50):
        master.tick({2: 0x0F}, {2: 300})
    before = float(master.physics.position[0])
    for _ in range(1000):
        master.tick({2: 0x02}, {})
    assert master.physics.effort[0] == pytest.approx(1.5, abs=0.05)
    assert abs(master.physics.position[0] - before) < 0.01


def test_disabling_operation_stops_first() -> None:
    master = one_axis()
    spin_up(master)
    master.tick({2: 0x07}, {})
    assert state(master.sample(2)[0]) == OPERATION_ENABLED
    for _ in range(400):
        statusword, _, _ = master.sample(2)
    assert state(statusword) == 0x23
    assert abs(master.physics.speed[0]) < 0.01


def test_a_change_of_mind_during_the_stop_is_obeyed() -> None:
    master = one_axis()
    spin_up(master)
    master.tick({2: 0x07}, {})
    master.tick({2: 0x0F}, {2: 100})
    assert master.physics.effort[0] == pytest.approx(0.5)
    master.tick({2: 0x07}, {})
    master.tick({2: 0x00}, {})
    assert state(master.sample(2)[0]) == SWITCH_ON_DISABLED


def test_a_motor_that_cannot_be_stopped_is_switched_off_in_the_end() -> None:
    master = one_axis()
    master.write(2, 0x6072, 0, struct.pack("<H", 100))  # 0.5 A against a load of 2
    master.physics.load[0] = -2.0
    for _ in range(round(6.0 / PERIOD_S)):
        master.tick({2: 0x02}, {})
    assert state(master.sample(2)[0]) == SWITCH_ON_DISABLED


# ---- the master is gone --------------------------------------------------------------------------------


def supervised(option: int) -> Master:
    master = one_axis()
    master.write(2, 0x6007, 0, struct.pack("<h", option))
    master.write(2, 0x1016, 1, struct.pack("<I", 127 << 16 | 200))
    master.send(0x77F, b"\x05")
    spin_up(master, 0.1)
    master.seen.clear()
    return master


@pytest.mark.parametrize(("option", "ends"), [(1, FAULT), (2, SWITCH_ON_DISABLED), (3, SWITCH_ON_DISABLED)])
def test_a_master_that_falls_silent_finds_the_motor_stopped(option: int, ends: int) -> None:
    master = supervised(option)
    came = master.wait(3.0)
    emergencies = [data for can_id, data in came if can_id == 0x082]
    assert emergencies == [bytes.fromhex("30 81 11 7F 00 00 00 00")]
    assert state(master.read(2, 0x6041)) == ends
    assert master.physics.effort[0] == 0.0
    if option != 2:  # a ramp, not a coast
        assert master.physics.closed[0]
        assert master.physics.position[0] < 0.15
    if option == 1:
        assert master.read(2, 0x603F) == 0x8130


def test_abort_option_0_lets_the_drive_go_on() -> None:
    master = supervised(0)
    master.wait(1.0)
    assert state(master.read(2, 0x6041)) == OPERATION_ENABLED


def test_the_drive_is_back_after_heartbeat_reset_and_start() -> None:
    master = supervised(1)
    master.wait(3.0)
    master.send(0x77F, b"\x05")
    master.send(0x000, bytes((1, 2)))
    master.tick({2: 0x00}, {})
    master.tick({2: 0x80}, {})
    master.enable(2)
    assert state(master.sample(2)[0]) == OPERATION_ENABLED


@pytest.mark.parametrize("command", [0x02, 0x81, 0x82])
def test_a_drive_that_is_put_to_rest_by_the_network_stops_its_motor(command: int) -> None:
    master = one_axis()
    spin_up(master)
    master.send(0x000, bytes((command, 2)))
    master.wait(3.0)
    assert master.physics.effort[0] == 0.0
    assert abs(master.physics.speed[0]) < 1e-9


def test_bus_off_stops_the_motor_and_is_told_when_the_bus_is_back() -> None:
    master = one_axis()
    spin_up(master)
    drive = master.machine.drives["roll_drive"]
    drive.bus_off()
    assert master.wait(3.0) == []
    assert master.physics.effort[0] == 0.0
    drive.bus_on()
    assert [data[:2] for can_id, data in master.drain() if can_id == 0x082] == [b"\x40\x81", b"\x00\x00"]
    assert state(master.read(2, 0x6041)) == FAULT


# ---- homing --------------------------------------------------------------------------------------------


def home(master: Master, method: int, offset: int = 0, seconds: float = 20.0) -> int:
    """Run a homing; the statusword it ends with."""
    master.write(2, 0x6098, 0, struct.pack("<b", method))
    master.write(2, 0x607C, 0, struct.pack("<i", offset))
    master.write(2, 0x6099, 1, struct.pack("<I", round(0.2 / RESOLUTION)))
    master.write(2, 0x6099, 2, struct.pack("<I", round(0.05 / RESOLUTION)))
    master.write(2, 0x609A, 0, struct.pack("<I", round(1.0 / RESOLUTION)))
    master.write(2, 0x6060, 0, b"\x06")
    master.tick({2: 0x0F}, {})
    for _ in range(round(seconds / PERIOD_S)):
        statusword = struct.unpack("<H", master.tick({2: 0x1F}, {})[0x182][:2])[0]
        if statusword & (HOMING_ATTAINED | HOMING_ERROR) and statusword & TARGET_REACHED:
            break
    return statusword


def shown(master: Master) -> int:
    return master.sample(2)[1]


@pytest.mark.parametrize("method", [35, 37])
def test_the_present_position_can_be_home(method: int) -> None:
    master = one_axis(position=0.3)
    assert home(master, method, offset=1234) & (HOMING_ATTAINED | TARGET_REACHED) == HOMING_ATTAINED | TARGET_REACHED
    assert shown(master) == 1234


@pytest.mark.parametrize(("method", "direction"), [(33, -1), (34, 1)])
@pytest.mark.parametrize("start", [-0.31, 0.0001, 0.3])
def test_the_index_pulse_can_be_home(method: int, direction: int, start: float) -> None:
    master = one_axis(position=start)
    assert home(master, method, offset=-7) & (HOMING_ATTAINED | HOMING_ERROR) == HOMING_ATTAINED
    turn = COUNTS_PER_TURN * RESOLUTION
    index = (np.floor if direction < 0 else np.ceil)(start / turn) * turn
    assert (master.physics.position[0] - start) * direction > 0.0
    assert abs(master.physics.speed[0]) < 0.005
    assert shown(master) == pytest.approx((master.physics.position[0] - index) / RESOLUTION - 7, abs=3)


@pytest.mark.parametrize(("method", "switch"), [(17, "negative_switch"), (18, "positive_switch")])
@pytest.mark.parametrize("inside", [True, False])
def test_a_limit_switch_can_be_home(method: int, switch: str, inside: bool) -> None:
    side = -1.0 if method == 17 else 1.0
    master = one_axis(position=side * (0.55 if inside else 0.2), **{switch: side * 0.5})
    assert home(master, method) & (HOMING_ATTAINED | HOMING_ERROR) == HOMING_ATTAINED
    assert shown(master) == pytest.approx((master.physics.position[0] - side * 0.5) / RESOLUTION, abs=3)
    assert abs(master.physics.position[0]) < 0.5, "it ends off the switch"
    assert master.read(2, 0x60FD) == 0


def test_limit_switches_show_in_the_digital_inputs() -> None:
    for position, inputs in ((-0.6, 1), (0.0, 0), (0.6, 2)):
        assert one_axis(position=position, negative_switch=-0.5, positive_switch=0.5).read(2, 0x60FD) == inputs


def test_a_method_whose_switch_is_not_wired_fails() -> None:
    assert home(one_axis(), 17, seconds=1.0) & (HOMING_ERROR | HOMING_ATTAINED) == HOMING_ERROR


def test_an_index_search_that_meets_a_limit_switch_fails() -> None:
    master = one_axis(position=0.001, positive_switch=0.02)
    assert home(master, 34) & (HOMING_ERROR | HOMING_ATTAINED) == HOMING_ERROR
    assert abs(master.physics.speed[0]) < 0.06


def test_homing_has_no_side_effects_until_it_is_started() -> None:
    master = one_axis(position=0.3)
    before = shown(master)
    master.write(2, 0x607C, 0, struct.pack("<i", 99))
    master.write(2, 0x6060, 0, b"\x06")
    for _ in range(50):
        master.tick({2: 0x0F}, {})
    statusword, position, _ = master.sample(2)
    assert position == before
    assert not statusword & HOMING_ATTAINED
    assert statusword & TARGET_REACHED


@pytest.mark.parametrize("word", [0x0F, 0x011F])
def test_a_homing_that_is_interrupted_finds_no_home(word: int) -> None:
    master = one_axis(position=0.3, negative_switch=-5.0)
    home(master, 17, seconds=0.5)
    assert not master.sample(2)[0] & TARGET_REACHED
    for _ in range(500):
        master.tick({2: word}, {})
    statusword, _, _ = master.sample(2)
    assert statusword & TARGET_REACHED
    assert not statusword & (HOMING_ATTAINED | HOMING_ERROR)
    assert abs(master.physics.speed[0]) < 0.005


def test_a_homing_that_was_cut_off_does_not_go_on_by_itself() -> None:
    master = one_axis(position=0.3, negative_switch=-5.0)
    home(master, 17, seconds=0.5)
    master.tick({2: 0x00}, {})
    for word in (0x16, 0x17, 0x1F):  # the start bit stays on
        master.tick({2: word}, {})
    for _ in range(100):
        master.tick({2: 0x1F}, {})
    statusword, _, _ = master.sample(2)
    assert state(statusword) == OPERATION_ENABLED
    assert statusword & TARGET_REACHED
    assert not statusword & HOMING_ATTAINED
    assert abs(master.physics.speed[0]) < 0.005


def test_a_reset_of_the_node_starts_counting_at_zero() -> None:
    master = one_axis(position=0.3)
    spin_up(master, 0.2)
    for _ in range(300):
        master.tick({2: 0x07}, {})
    assert shown(master) > 100
    master.send(0x000, b"\x81\x02")
    master.tick({}, {})
    assert master.read(2, 0x6064, signed=True) == 0


def test_without_enable_homing_does_not_start() -> None:
    master = Master(one_axis_bus(), (0.3,))
    master.configure((2,), (12,))
    master.write(2, 0x6060, 0, b"\x06")
    for _ in range(20):
        master.tick({2: 0x1F}, {})
    assert not master.sample(2)[0] & HOMING_ATTAINED


def test_the_counter_wraps_at_32_bits() -> None:
    master = one_axis()
    home(master, 37, offset=2**31 - 1)
    master.write(2, 0x6060, 0, b"\x0a")
    for _ in range(20):
        master.tick({2: 0x0F}, {2: 500})
    assert shown(master) < -(2**31) + 100_000


# ---- the drive's own velocity loop ---------------------------------------------------------------------


def loop(period_s: float = PERIOD_S) -> VelocityLoop:
    return VelocityLoop(VelocityGains(proportional=0.1, integral=0.5), period_s, standstill_counts_s=10.0)


def test_a_loop_against_its_limit_does_not_wind_up() -> None:
    velocity = loop()
    velocity.start(0.0, 0.0)
    for _ in range(2000):
        assert velocity.torque(1e5, 1e9, 0.0, 100.0) == 100.0
    assert velocity.torque(0.0, 1e9, 1000.0, 100.0) < 0.0, "it turns round at once"


@pytest.mark.parametrize("period_s", [PERIOD_S, 1e-3])
def test_a_motor_stands_when_it_has_stood_for_a_while_however_fast_it_is_sampled(period_s: float) -> None:
    velocity = loop(period_s)
    velocity.start(0.0, 0.0)
    elapsed_s = period_s
    while elapsed_s < 0.078 - 1e-9:  # twenty periods at 256 Hz
        velocity.torque(0.0, 1e9, 5.0, 100.0)
        elapsed_s += period_s
    assert not velocity.standing
    velocity.torque(0.0, 1e9, 5.0, 100.0)
    assert velocity.standing
    velocity.torque(0.0, 1e9, 11.0, 100.0)
    assert not velocity.standing


def test_the_loop_takes_over_without_a_bump() -> None:
    velocity = loop()
    velocity.start(250.0, -70.0)
    assert velocity.torque(250.0, 1e3, 250.0, 100.0) == -70.0
