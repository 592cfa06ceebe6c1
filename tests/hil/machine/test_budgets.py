"""Budgets of time and travel to standstill: what is computed bounds an integrated pendulum; what cannot be met is refused."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_machines import RPM_PER_S, edited, with_data_sheet
from scipy.integrate import solve_ivp

from hil.errors import MachineFileError
from hil.machine import Machine, check_machine, load_machine, machine_from_text
from hil.machine.check import examine
from hil.machine.check_budgets import WIDEST, axis_facts, budgets, quick_stop
from hil.machine.finding import Finding
from hil.machine.standstill import CLASSES, AxisFacts
from virtual_bus.settings import EffectSetting

TURNTABLE = load_machine("turntable")
WITHOUT_OWN = edited(r"^\[\[bus\.nodes\.\w+_drive\.write\]\]\nindex = 0x6085.*\nvalue = .*\n", "", TURNTABLE.text)
MASS, ARM, BRAKE = 10.0, 0.3, 100.0
GRAVITY = 9.81
INERTIA = 7.0 + MASS * ARM**2 + 6.0e-5 * 100.0**2  # table, hanging mass, rotor


def pendulum() -> Machine:
    """The turntable turned on its side, with a mass of 10 kg out of its axis by 0.3 m."""
    text = edited(r"^axis = \[0.0, 0.0, 1.0\]", "axis = [0.0, 1.0, 0.0]", TURNTABLE.text)
    text = edited(r"^mass_kg = 30.0", f"mass_kg = {MASS}\ncenter_of_mass_m = [0.0, 0.0, -{ARM}]", text)
    text = edited(r"^inertia_kg_m2 = .*", "inertia_kg_m2 = [7.0, 7.0, 7.0, 0.0, 0.0, 0.0]", text)
    return machine_from_text(re.sub(r"(?ms)^\[budgets.*?\n\n", "", text))


def swing(position: float, speed: float, brakes_at_s: float, push: float = 0.0) -> tuple[float, float]:
    """Time and travel of the pendulum from a fault to rest, integrated: it falls with its drive's push, then the brake closes over it."""

    def motion(brake: float) -> Callable[[float, np.ndarray], list[float]]:
        return lambda t, state: [state[1], (push - MASS * GRAVITY * ARM * math.sin(state[0]) - brake) / INERTIA]

    def rests(t: float, state: np.ndarray) -> float:
        return float(state[1])

    rests.terminal = True  # type: ignore[attr-defined]
    falling = solve_ivp(motion(0.0), (0.0, brakes_at_s), [position, speed], max_step=1e-2, rtol=1e-8)
    closed = falling.y[:, -1]
    braking = solve_ivp(motion(math.copysign(BRAKE, closed[1])), (0.0, 20.0), closed, events=rests, max_step=1e-2, rtol=1e-8)
    assert braking.t_events[0].size
    travel = max(np.abs(part.y[0] - position).max() for part in (falling, braking))
    return brakes_at_s + float(braking.t[-1]), float(travel)


@pytest.fixture(scope="module")
def facts() -> AxisFacts:
    machine = pendulum()
    ((facts, _),) = axis_facts(machine, 0, examine(machine, 9))
    return facts


def test_the_facts_of_a_pendulum_are_those_of_its_formulas(facts: AxisFacts) -> None:
    assert facts.gravity == pytest.approx(MASS * GRAVITY * ARM, rel=1e-6)  # the arm level, at 90 degrees
    assert facts.inertia == pytest.approx((INERTIA, INERTIA), rel=1e-9)
    assert facts.drive_effort == pytest.approx(8.0 * 9.5)
    assert facts.brake_effort == BRAKE


@pytest.mark.parametrize("name", ["drive_fault", "node_silent"])
def test_what_the_brake_alone_takes_bounds_an_integrated_pendulum_from_every_pose_by_less_than_the_margin(
    facts: AxisFacts, name: str
) -> None:
    computed = CLASSES[name](facts)
    departs_s = math.sqrt(2.0 * facts.tracking_error / facts.falls) + facts.period_s
    seen_s = facts.period_s if name == "drive_fault" else min(facts.node_silent_s, departs_s)
    stops = [swing(pose, facts.speed, seen_s + facts.period_s + 0.04) for pose in np.radians(np.arange(-90, 91, 10))]
    longest, farthest = max(time_s for time_s, _ in stops), max(travel for _, travel in stops)
    assert longest <= computed.time_s <= WIDEST * longest
    assert farthest <= computed.travel <= WIDEST * farthest


def test_a_runaway_bounds_an_integrated_pendulum_that_is_pushed_against_its_brake() -> None:
    text = edited(r"^limit_A = 8.0", "limit_A = 4.0", pendulum().text)
    machine = machine_from_text(text)
    ((facts, _),) = axis_facts(machine, 0, examine(machine, 9))
    computed = CLASSES["runaway"](facts)
    push = 4.0 * 9.5
    assert push + MASS * GRAVITY * ARM < BRAKE
    for pose in np.radians([-90, -45, 0]):
        a = (push - MASS * GRAVITY * ARM * math.sin(pose)) / INERTIA
        seen_s = min(math.sqrt(2.0 * facts.tracking_error / a), 0.5 * facts.speed / a)  # by its place or by its speed
        _, travel = swing(pose, facts.speed, seen_s + 2.0 * facts.period_s + 0.04, push)
        assert travel - facts.speed * seen_s <= computed.travel  # less what the reference itself went


def test_an_axis_whose_brake_is_too_weak_does_not_come_to_rest() -> None:
    machine = machine_from_text(edited(r"^brake_effort_Nm = 100.0", "brake_effort_Nm = 20.0", pendulum().text))
    ((facts, _),) = axis_facts(machine, 0, examine(machine, 9))
    assert CLASSES["drive_fault"](facts).travel == math.inf
    assert math.isfinite(CLASSES["asked"](facts).travel)  # its drive stops it


def test_a_drive_that_its_file_makes_late_ramps_down_late_and_what_hangs_on_a_spring_is_braked_too(facts: AxisFacts) -> None:
    effects = (
        EffectSetting("delay", "turn", {"Td": 0.012}),
        EffectSetting("drive_bandwidth", "turn", {"fc": 40.0, "zeta": 0.7}),
        EffectSetting("structural_mode", "turn", {"J": 3.0, "f": 6.0, "zeta": 0.01}),
    )
    machine = pendulum()
    machine = replace(machine, plant=replace(machine.plant, effects=effects))
    ((late, _),) = axis_facts(machine, 0, examine(machine, 9))
    late_s = 0.012 + 2.0 * 0.7 / (2.0 * math.pi * 40.0)  # and the steady lag of the low pass behind a ramp
    assert late.drive_late_s == pytest.approx(late_s)
    assert late.inertia == pytest.approx((INERTIA, INERTIA + 3.0), rel=1e-6)
    before, after = (CLASSES["bench_silent"](each) for each in (facts, replace(facts, drive_late_s=late_s)))
    assert after.time_s > before.time_s + late_s
    ramped, coasted = (CLASSES["asked"](replace(facts, drive_late_s=each)) for each in (0.0, late_s))
    if facts.ramps >= facts.brakes:  # one ramp, begun later
        assert coasted.travel == pytest.approx(ramped.travel + facts.speed * late_s)
    never = CLASSES["asked"](replace(facts, drive_late_s=10.0))  # the brake is there before it
    seen_s = facts.inputs_s + facts.period_s
    assert never.travel == pytest.approx(facts.speed * (seen_s + facts.closing_s) + facts.speed**2 / (2.0 * facts.brakes))


def _budgets(machine: Machine) -> dict[tuple[str, str], Finding]:
    findings = [finding for finding in check_machine(machine, 25) if finding.name == "budget"]
    return {(finding.values["axis"], finding.values["class"]): finding for finding in findings}


@pytest.mark.parametrize("name", ["turntable", pytest.param("carm", marks=pytest.mark.slow)])
def test_the_shipped_machines_state_a_budget_for_every_class_and_can_meet_it(name: str) -> None:
    machine = load_machine(name)
    assert machine.bus is not None
    found = _budgets(machine)
    classes = set(CLASSES) - ({"io_silent"} if machine.bus.io is None else set())
    assert set(found) == {(axis, name) for axis in machine.axes for name in classes}
    assert all(finding.ok and finding.values["stated_time_s"] is not None for finding in found.values())


def test_a_budget_that_cannot_be_met_is_refused_and_so_is_one_too_wide() -> None:
    computed = _budgets(TURNTABLE)["turn", "drive_fault"].values
    for factor, says in ((0.95, "cannot be met"), (1.6, "is wider than 1.5 times what is computed")):
        travel_deg, time_s = factor * math.degrees(computed["travel"]), factor * computed["time_s"]
        text = edited(r"^drive_fault = .*", f"drive_fault = {{ time_s = {time_s}, travel_deg = {travel_deg} }}", TURNTABLE.text)
        found = _budgets(machine_from_text(text))
        assert [key for key, finding in found.items() if not finding.ok] == [("turn", "drive_fault")]
        assert found["turn", "drive_fault"].text.count(says) == 2


def test_a_machine_without_budgets_is_told_what_its_stops_take() -> None:
    found = budgets(pendulum(), examine(pendulum(), 9))
    assert len(found) == len(CLASSES) - 1  # no I/O to fall silent
    assert all(finding.ok for finding in found)


def stated_stop(deg_s2: float, text: str) -> str:
    """The turntable, whose limits say its drive's quick stop."""
    return edited(r"^jerk_deg_s3 = 2000.0", f"jerk_deg_s3 = 2000.0\nquick_stop_deg_s2 = {deg_s2}", text)


def believed(text: str) -> float:
    """The quick stop that a check takes the drive for [deg/s^2]."""
    machine = machine_from_text(text)
    assert machine.bus is not None
    return math.degrees(quick_stop(machine, 0, machine.bus.nodes[0]))


def test_a_quick_stop_that_is_said_twice_is_refused_in_one_line() -> None:
    with pytest.raises(MachineFileError, match=r"limits\.turn\.quick_stop_deg_s2.*6085h in bus\.nodes\.turn_drive") as refused:
        machine_from_text(stated_stop(60.0, TURNTABLE.text))
    assert "\n" not in str(refused.value)


def test_a_quick_stop_is_believed_as_far_as_the_drive_takes_it(tmp_path: Path) -> None:
    capped = with_data_sheet(WITHOUT_OWN, tmp_path, r"^\[6085\]$", "[6085]\nHighLimit=1000")
    assert believed(stated_stop(60.0, WITHOUT_OWN)) == pytest.approx(60.0)
    assert believed(stated_stop(60.0, capped)) == pytest.approx(1000 * 360.0 / (4096 * 100))


def test_an_own_write_of_the_quick_stop_is_in_the_drives_unit_and_nothing_where_that_is_not_known(tmp_path: Path) -> None:
    assert believed(TURNTABLE.text) == pytest.approx(1_000_000 * 360.0 / (4096 * 100))
    in_rpm = with_data_sheet(edited("^value = 1000000", "value = 100", TURNTABLE.text), tmp_path, r"^\[6085\]$", f"{RPM_PER_S}\\g<0>")
    assert believed(in_rpm) == pytest.approx(100 * 6.0 / 100)
    metres = RPM_PER_S.replace("0x00C00300", "0x00010300")
    assert believed(with_data_sheet(TURNTABLE.text, tmp_path, r"^\[6085\]$", f"{metres}\\g<0>")) == 0.0


def test_a_slower_quick_stop_takes_longer_than_a_faster_one() -> None:
    slow = _budgets(machine_from_text(stated_stop(60.0, WITHOUT_OWN)))
    fast = _budgets(TURNTABLE)
    for name in ("asked", "bench_silent"):
        assert slow["turn", name].values["travel"] > fast["turn", name].values["travel"]
    rest_s = math.radians(60.0) / math.radians(60.0)  # from the speed limit, less what the held torque adds
    assert slow["turn", "bench_silent"].values["time_s"] > rest_s


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[budgets.turn]", "[budgets.roll]", "budgets.roll: no such axis; there is turn"),
        ("asked = {", "io_silent = {", "budgets.turn.io_silent: there is no I/O on the bus"),
        ("travel_deg = 3.6", "travel_mm = 3.6", "does not fit a revolute joint; give it an angular unit"),
        ("asked = { time_s = ", "asked = { time_s = -", "budgets.turn.asked.time_s"),
    ],
)
def test_a_wrong_budget_is_refused_in_one_line(old: str, new: str, says: str) -> None:
    with pytest.raises(MachineFileError) as refused:
        machine_from_text(edited(re.escape(old), new, TURNTABLE.text, 1))
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)
