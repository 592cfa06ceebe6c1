"""Profile position and profile velocity mode through PDO: handshake, demand, windows and limits (IEC 61800-7-201)."""

from __future__ import annotations

import itertools
import math

import pytest
import ruckig
from device_wires import PERIOD_S
from drive_master import Answer, DriveMaster

PP, PV = 1, 3
ENABLED, NEW, AT_ONCE, RELATIVE, HALT = 0x0F, 1 << 4, 1 << 5, 1 << 6, 1 << 8
TARGET_REACHED, INTERNAL_LIMIT, ACKNOWLEDGED, SPEED_ZERO, FOLLOWING_ERROR = 1 << 10, 1 << 11, 1 << 12, 1 << 12, 1 << 13
SPEED, ACCELERATION, DECELERATION = 20_000, 50_000, 25_000


def enabled(mode: int, **changes: object) -> DriveMaster:
    master = DriveMaster(mode=mode, **changes)
    for index, value in ((0x6081, SPEED), (0x6083, ACCELERATION), (0x6084, DECELERATION)):
        master.set(index, value)
    master.switch_on()
    return master


def go(master: DriveMaster, target: int, bits: int = 0) -> Answer:
    """Give a set-point and take bit 4 back; the answer to the former."""
    answer = master.step(word=ENABLED | NEW | bits, position=target)
    master.step(word=ENABLED | bits)
    return answer


def until(master: DriveMaster, bit: int, *, is_set: bool = True, within_s: float = 10.0) -> Answer:
    for _ in range(round(within_s / PERIOD_S)):
        answer = master.step()
        if bool(answer.statusword & bit) is is_set:
            return answer
    raise AssertionError(f"bit {bit.bit_length() - 1} did not come")


# ---- profile position ----------------------------------------------------------------------------------


@pytest.mark.parametrize("target", [15_000, -15_000, 3_000])
def test_the_position_demand_is_the_exact_trapezoid(target: int) -> None:
    master = enabled(PP)
    answer = master.step(word=ENABLED | NEW, position=target)
    assert answer.statusword & ACKNOWLEDGED
    assert answer.position_demand == 0
    asked = ruckig.InputParameter(1)
    sign = math.copysign(1.0, target)
    asked.target_position, asked.max_velocity, asked.max_jerk = [abs(target) / SPEED], [1.0], [math.inf]  # lengths over 20 000 counts
    asked.max_acceleration, asked.min_acceleration = [ACCELERATION / SPEED], [-DECELERATION / SPEED]
    trajectory = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(asked, trajectory)
    samples = math.ceil(trajectory.duration / PERIOD_S)
    for k in range(1, samples + 10):
        answer = master.step(word=ENABLED)
        (position,), _, _ = trajectory.at_time(min(k * PERIOD_S, trajectory.duration))
        assert answer.position_demand == pytest.approx(sign * position * SPEED, abs=0.5 + 1e-3)
    assert answer.position_demand == target
    assert until(master, TARGET_REACHED).position == pytest.approx(target, abs=100)


def test_a_set_point_is_acknowledged_and_its_target_reached() -> None:
    master = enabled(PP)
    answer = master.step(word=ENABLED | NEW, position=5000)
    assert answer.statusword & ACKNOWLEDGED
    assert not answer.statusword & TARGET_REACHED
    assert master.steps(20).statusword & ACKNOWLEDGED, "bit 4 is still set"
    assert not master.step(word=ENABLED).statusword & ACKNOWLEDGED
    answer = until(master, TARGET_REACHED)
    assert answer.position == pytest.approx(5000, abs=100)
    assert not answer.statusword & (ACKNOWLEDGED | INTERNAL_LIMIT | FOLLOWING_ERROR)


def test_without_a_rising_edge_of_bit_4_nothing_moves() -> None:
    master = DriveMaster(mode=PP)
    for word in (0x16, 0x17, 0x1F):  # the bit stays on from before the enabling
        master.step(word=word, position=9000)
    answer = master.steps(100, word=0x1F)
    assert (answer.position_demand, answer.position) == (0, 0)
    assert not answer.statusword & ACKNOWLEDGED


def test_one_set_point_waits_while_another_is_under_way() -> None:
    master = enabled(PP)
    go(master, 4000)
    assert go(master, -2000).statusword & ACKNOWLEDGED
    assert master.step().statusword & ACKNOWLEDGED, "there is no room for another"
    go(master, 77_777)
    furthest, answer = 0, master.step()
    while answer.statusword & ACKNOWLEDGED:
        assert not answer.statusword & TARGET_REACHED, "there is more to come"
        furthest = max(furthest, answer.position_demand)
        answer = master.step()
    assert furthest == 4000, "it stops at the first, and the third was refused"
    assert until(master, TARGET_REACHED).position_demand == -2000
    assert go(master, 100).statusword & ACKNOWLEDGED


def test_a_set_point_that_changes_at_once_drops_what_waits() -> None:
    master = enabled(PP)
    go(master, 40_000)
    go(master, 50_000)
    answers = [master.step() for _ in range(60)]
    answers += [master.step(word=ENABLED | NEW | AT_ONCE, position=-3000), master.step(word=ENABLED)]
    while not answers[-1].statusword & TARGET_REACHED:
        answers.append(master.step())
    demands = [answer.position_demand for answer in answers]
    steps = [(b - a) / PERIOD_S for a, b in itertools.pairwise(demands)]
    changes = [abs(b - a) / PERIOD_S for a, b in itertools.pairwise(steps)]
    rounding = 2.0 / PERIOD_S**2
    assert max(demands) < 30_000
    assert demands[-1] == -3000
    assert max(changes) <= ACCELERATION + rounding, "from one profile to the next neither position nor speed jumps"
    assert min(steps) >= -SPEED - 1.0 / PERIOD_S


def test_relative_targets_add_to_the_target_before() -> None:
    master = enabled(PP, position=0.0)
    go(master, 1000)
    go(master, 500, RELATIVE)  # while the first is under way
    until(master, TARGET_REACHED)
    go(master, -200, RELATIVE)
    assert until(master, TARGET_REACHED).position_demand == 1300
    go(master, 10, RELATIVE | AT_ONCE)
    go(master, 10, RELATIVE | AT_ONCE)
    assert until(master, TARGET_REACHED).position_demand == 1320


def test_halt_interrupts_a_set_point_and_its_end_goes_on_with_it() -> None:
    master = enabled(PP)
    go(master, 30_000)
    master.steps(150)
    answer = master.steps(400, word=ENABLED | HALT)
    assert answer.statusword & TARGET_REACHED, "in a halt: it stands"
    assert 3000 < answer.position < 29_000
    at = answer.position
    answer = master.step(word=ENABLED)
    assert answer.position_demand == pytest.approx(at, abs=50)
    assert not answer.statusword & TARGET_REACHED
    assert until(master, TARGET_REACHED).position == pytest.approx(30_000, abs=100)


@pytest.mark.parametrize("target", [90_000, -90_000])
def test_the_software_limits_cut_a_target_and_show_it(target: int) -> None:
    master = enabled(PP)
    master.set(0x607D, -7000, "<i", 1)
    master.set(0x607D, 6000, "<i", 2)
    go(master, target)
    answer = until(master, TARGET_REACHED)
    assert answer.position_demand == (6000 if target > 0 else -7000)
    assert answer.statusword & INTERNAL_LIMIT
    go(master, 0)
    assert not until(master, TARGET_REACHED).statusword & INTERNAL_LIMIT


def test_the_speed_is_the_smaller_of_6081h_and_607fh() -> None:
    master = enabled(PP)
    master.set(0x607F, 5000)
    go(master, 20_000)
    demands = [master.step().position_demand for _ in range(400)]
    steps = [b - a for a, b in itertools.pairwise(demands)]
    assert max(steps) * PERIOD_S**-1 == pytest.approx(5000, abs=1.0 / PERIOD_S)


def test_a_target_counts_as_reached_once_the_position_has_stayed_in_its_window() -> None:
    master = enabled(PP)
    master.set(0x6067, 30)
    master.set(0x6068, 200, "<H")
    go(master, 8000)
    inside = 0
    while not (answer := master.step()).statusword & TARGET_REACHED:
        inside = inside + 1 if abs(answer.position - 8000) <= 30 and answer.position_demand == 8000 else 0
    assert inside * PERIOD_S == pytest.approx(0.2, abs=2 * PERIOD_S)


def test_a_blocked_axis_is_a_following_error() -> None:
    master = enabled(PP)
    master.set(0x6065, 2000)
    master.set(0x6066, 50, "<H")
    master.physics.load[0] = 8.0
    go(master, 500_000)
    answer = until(master, FOLLOWING_ERROR)
    assert abs(answer.following_error) > 2000
    assert answer.state in (0x0F, 0x08)
    assert master.get(0x603F) == 0x8611


def test_another_mode_forgets_the_set_points() -> None:
    master = enabled(PP)
    go(master, 30_000)
    go(master, 40_000)
    master.steps(50)
    answer = master.steps(400, mode=PV)
    assert not answer.statusword & FOLLOWING_ERROR
    at = master.steps(5, mode=PP).position
    answer = master.steps(200)
    assert answer.position == pytest.approx(at, abs=5)
    assert not answer.statusword & ACKNOWLEDGED
    assert go(master, at + 1000).statusword & ACKNOWLEDGED


# ---- profile velocity ----------------------------------------------------------------------------------


def test_the_speed_ramps_up_and_down_exactly() -> None:
    master = enabled(PV)
    demands = [master.step(velocity=SPEED).velocity_demand for _ in range(150)]
    assert demands == [min(SPEED, round((k + 1) * ACCELERATION * PERIOD_S)) for k in range(150)]
    until(master, TARGET_REACHED)
    demands = [master.step(velocity=-SPEED).velocity_demand for _ in range(400)]
    down = SPEED / DECELERATION
    for k, demand in enumerate(demands, 1):
        elapsed = k * PERIOD_S
        exact = SPEED - DECELERATION * elapsed if elapsed <= down else max(-SPEED, -ACCELERATION * (elapsed - down))
        assert demand == pytest.approx(exact, abs=0.5 + 1e-6)


def test_target_reached_and_speed_zero_follow_their_windows() -> None:
    master = enabled(PV)
    assert master.steps(20).statusword & (TARGET_REACHED | SPEED_ZERO) == TARGET_REACHED | SPEED_ZERO
    answer = master.step(velocity=SPEED)
    assert answer.statusword & (TARGET_REACHED | SPEED_ZERO) == SPEED_ZERO
    until(master, SPEED_ZERO, is_set=False)
    until(master, TARGET_REACHED)
    assert master.get(0x606C, signed=True) == pytest.approx(SPEED, abs=500)
    master.step(velocity=0)
    answer = until(master, SPEED_ZERO)
    assert abs(master.get(0x606C, signed=True)) <= 500
    assert until(master, TARGET_REACHED).statusword & SPEED_ZERO


def test_the_greatest_profile_velocity_cuts_the_target_and_shows_it() -> None:
    master = enabled(PV)
    master.set(0x607F, 8000)
    answer = master.steps(300, velocity=-SPEED)
    assert answer.velocity_demand == -8000
    assert answer.statusword & INTERNAL_LIMIT
    answer = master.steps(300, velocity=-8000)
    assert not answer.statusword & INTERNAL_LIMIT
    assert answer.statusword & TARGET_REACHED


def test_halt_stops_and_its_end_ramps_up_again() -> None:
    master = enabled(PV)
    master.steps(300, velocity=SPEED)
    answer = master.steps(500, word=ENABLED | HALT)
    assert answer.statusword & TARGET_REACHED
    assert abs(master.get(0x606C, signed=True)) < 200
    assert abs(master.step(word=ENABLED).velocity_demand) < 500, "from standstill"
    assert master.steps(300).velocity_demand == SPEED


def test_a_drive_whose_unit_is_rpm_turns_its_motor_so_often_in_a_minute() -> None:
    counts_per_turn, rpm, samples = 4096, 300, 400
    master = DriveMaster(mode=PV, velocity_unit="rpm", acceleration_unit="rev/s^2")
    for index in (0x6083, 0x6084):
        master.set(index, 10)
    master.switch_on()
    ramping = master.steps(round(0.25 / PERIOD_S), velocity=-rpm)
    assert ramping.velocity_demand == pytest.approx(-10 * 0.25 * 60, abs=3.0)
    before = master.steps(samples).position
    turned = (master.steps(samples).position - before) / counts_per_turn
    assert turned == pytest.approx(-rpm / 60 * samples * PERIOD_S, rel=2e-3)
    assert master.get(0x606C, signed=True) == pytest.approx(-rpm, abs=3)
