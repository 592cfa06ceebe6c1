"""Cyclic synchronous position, velocity and torque: the drive's cascade against its own transfer functions."""

from __future__ import annotations

import numpy as np
import pytest
from device_wires import PERIOD_S, RESOLUTION
from drive_master import DriveMaster
from scipy.signal import lfilter

CSP, CSV, CST = 8, 9, 10
TARGET_REACHED, INTERNAL_LIMIT, FOLLOWS, FOLLOWING_ERROR = 1 << 10, 1 << 11, 1 << 12, 1 << 13
ROUNDING = 0.5 + 1e-6  # per mille: the torque on the wire is a whole number
VELOCITY_GAIN, INTEGRAL_GAIN, POSITION_GAIN = 20.0, 40.0, 3.0  # A/(rad/s), A/rad, 1/s
PERMILLE_PER_COUNT = RESOLUTION * 1000.0 / 5.0
KP, KI = VELOCITY_GAIN * PERMILLE_PER_COUNT, INTEGRAL_GAIN * PERMILLE_PER_COUNT


def speed_meter(position: np.ndarray) -> np.ndarray:
    """D(z) = 0.25 (1 - z^-1) / T / (1 - 0.75 z^-1)."""
    return lfilter([0.25 / PERIOD_S, -0.25 / PERIOD_S], [1.0, -0.75], position)


def velocity_loop(lag: np.ndarray) -> np.ndarray:
    """Kv(z) = kp + ki T z^-1 / (1 - z^-1)."""
    return lfilter([KP, KI * PERIOD_S - KP], [1.0, -1.0], lag)


def steps_of(rng: np.random.Generator, count: int, size: int, hold: int) -> np.ndarray:
    return np.repeat(rng.integers(-size, size + 1, -(-count // hold)), hold)[:count]


@pytest.mark.parametrize("mode", [CSP, CSV, CST])
def test_the_torque_from_a_sync_on_is_the_cascades_answer_to_its_targets_and_the_row_before(mode: int) -> None:
    rng = np.random.default_rng(7)
    count = 1500
    asked = {
        "torque": steps_of(rng, count, 80, 5),
        "position": steps_of(rng, count, 2000, 200),
        "velocity": steps_of(rng, count, 2000, 70),
        "position_offset": steps_of(rng, count, 300, 30),
        "velocity_offset": steps_of(rng, count, 300, 20),
        "torque_offset": steps_of(rng, count, 40, 3),
    }
    master = DriveMaster(mode=mode, velocity_gain=VELOCITY_GAIN, velocity_integral_gain=INTEGRAL_GAIN, position_gain=POSITION_GAIN)
    master.switch_on()
    answers = [master.step(**{name: int(values[k]) for name, values in asked.items()}) for k in range(count)]
    position = np.array([answer.position for answer in answers])
    torque = np.array([answer.torque for answer in answers])
    row_before = np.concatenate([[0], position[:-1]])
    if mode == CST:
        assert np.array_equal(torque, asked["torque"] + asked["torque_offset"])
        return
    demand = asked["velocity"] + asked["velocity_offset"]
    if mode == CSP:
        demand = POSITION_GAIN * (asked["position"] + asked["position_offset"] - row_before) + asked["velocity_offset"]
    wanted = velocity_loop(demand - speed_meter(row_before)) + asked["torque_offset"]
    assert np.abs(wanted).max() < 1600.0, "no limit acts"
    assert np.abs(torque).max() > 100
    assert np.abs(torque - wanted).max() <= ROUNDING
    assert np.ptp(position) > 500
    assert not any(answer.statusword & INTERNAL_LIMIT for answer in answers)
    assert all(answer.statusword & FOLLOWS for answer in answers)


@pytest.mark.parametrize("mode", [CSP, CSV, CST])
def test_what_is_foreseen_is_what_is_commanded(mode: int) -> None:
    """Before every SYNC, also where the torque is limited and where a mode takes over from another."""
    rng = np.random.default_rng(3)
    master = DriveMaster(mode=mode)
    drive = master.machine.drives["roll_drive"]
    master.switch_on(torque_offset=30)
    foreseen, commanded = [], []
    command = drive.command
    drive.command = lambda: commanded.append(command()) or commanded[-1]
    for k in range(300):
        if 200 < k < 220:
            master.asked.mode = CST if k % 2 else mode
            master.set(0x6060, master.asked.mode, "<b")
        size = 200_000 if 100 < k < 140 else 2000
        changes = {name: int(rng.integers(-size, size + 1)) for name in ("position", "velocity", "position_offset", "velocity_offset")}
        master.announce(torque=int(rng.integers(-2000, 2001)), torque_offset=int(rng.integers(-99, 100)), **changes)
        foreseen.append(drive.foreseen())
        master.send(0x080)
    assert foreseen == commanded
    assert max(np.abs(commanded)) == 8.0, "the limit was reached"


def test_a_saturated_loop_does_not_wind_up_and_shows_its_limit() -> None:
    master = DriveMaster(mode=CSV)
    master.physics.load[0] = 8.0  # as strong as the drive: the mass stands
    master.switch_on()
    answer = master.steps(300, velocity=400_000)
    assert answer.torque == 1600
    assert answer.statusword & INTERNAL_LIMIT
    answer = master.steps(2, velocity=-20_000)
    assert answer.torque < 0, "it turns round at once"
    assert not answer.statusword & INTERNAL_LIMIT


@pytest.mark.parametrize(("mode", "limit_index"), [(CSP, 0x6072), (CSV, 0x6073)])
def test_the_smaller_of_the_two_torque_limits_binds(mode: int, limit_index: int) -> None:
    master = DriveMaster(mode=mode)
    master.set(limit_index, 300, "<H")
    master.switch_on()
    torques = [master.step(position=900_000, velocity=900_000, torque_offset=(-1) ** k * 500).torque for k in range(40)]
    assert max(torques) == 300
    assert min(torques) >= -300


def test_a_position_target_is_reached_and_held_against_a_load() -> None:
    master = DriveMaster(mode=CSP)
    master.physics.load[0] = 0.5
    master.switch_on()
    answer = master.steps(2500, position=12_345)
    assert answer.position == pytest.approx(12_345, abs=3)
    assert answer.position_demand == 12_345
    assert answer.following_error == answer.position_demand - answer.position
    assert answer.torque == pytest.approx(100, abs=3)


def test_software_limits_cut_the_demand_and_show_it() -> None:
    master = DriveMaster(mode=CSP)
    master.set(0x607D, -500, "<i", 1)
    master.set(0x607D, 4000, "<i", 2)
    master.switch_on()
    answer = master.steps(2000, position=9000, position_offset=1000, velocity_offset=5000)
    assert answer.position_demand == 4000
    assert answer.position == pytest.approx(4000, abs=3), "a demand that stands has no speed"
    assert answer.statusword & INTERNAL_LIMIT
    answer = master.steps(2000, position=-9000, position_offset=0, velocity_offset=0)
    assert answer.position_demand == -500
    answer = master.steps(5, position=3900, position_offset=99)
    assert answer.position_demand == 3999
    assert not answer.statusword & INTERNAL_LIMIT


@pytest.mark.parametrize(("option", "coasts"), [(0, True), (2, False)])
def test_a_following_error_that_stays_beyond_its_window_is_a_fault(option: int, coasts: bool) -> None:
    master = DriveMaster(mode=CSP)
    master.set(0x6065, 1000)
    master.set(0x6066, 100, "<H")
    master.set(0x605E, option, "<h")
    master.switch_on()
    master.physics.load[0] = 12.0  # stronger than the drive
    beyond = 0
    while (answer := master.step()).state == 0x27:
        beyond += abs(answer.following_error) > 1000
        assert not answer.statusword & FOLLOWING_ERROR
        assert beyond < 100
    assert beyond * PERIOD_S == pytest.approx(0.1, abs=PERIOD_S)
    assert answer.statusword & FOLLOWING_ERROR
    assert answer.mode == CSP
    assert answer.state == (0x08 if coasts else 0x0F)
    assert master.get(0x603F) == 0x8611
    master.send(0x080)
    assert [data[:3] for can_id, data in master.seen if can_id == 0x082] == [bytes.fromhex("11 86 21")]
    assert bool(master.physics.effort[0]) is not coasts


def test_the_interpolation_time_period_is_stored_and_read_back() -> None:
    master = DriveMaster()
    master.set(0x60C2, 39, "<B", 1)
    master.set(0x60C2, -4, "<b", 2)
    assert (master.get(0x60C2, 1), master.get(0x60C2, 2, signed=True)) == (39, -4)


def test_where_no_position_loop_acts_the_demand_is_where_the_motor_is() -> None:
    master = DriveMaster(mode=CSP)
    master.switch_on()
    assert master.steps(20, position=50_000).following_error > 10_000
    answer = master.steps(5, word=0x010F)  # halt
    assert answer.following_error == 0
    assert answer.position_demand == pytest.approx(answer.position, abs=500), "one sample apart"
    assert master.steps(5, word=0x0F).following_error > 10_000
    assert master.steps(5, mode=CSV).following_error == 0
