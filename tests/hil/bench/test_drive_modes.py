"""Drives that close loops of their own: the loop commands them in velocity or position, over the same frames as ever."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest
from bench_machines import CARM, carm_text_in, edited, run_in_lockstep

from drivers.interface import Sample
from hil.bench.bench import Bench
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.diagnosis.audit.controller import audit_controllers
from hil.errors import LoopAbortedError, MachineFileError, RecordingError
from hil.experiments import Multisine, Plan, Scan, Static
from hil.machine import Machine, check_machine, machine_from_text
from hil.recording import Channel, Recording
from hil.simulation import in_effort, simulate
from virtual_bus.physics import Physics

MODES = ("velocity", "position")
ONE_BY_DAY = (pytest.param("velocity", marks=pytest.mark.nightly), "position")
"""Where the mode changes a number and not the way."""
COUNT_rad = 2.0 * np.pi / (4096 * 500)
ROWS = 400
STEP_A = 0.005  # of the torque on the wire, and of what is measured
SENSOR_NOISE_A = 0.01  # of the shipped current sensors, the quantisation of the target beside it


def machine_in(mode: str) -> Machine:
    return machine_from_text(carm_text_in(mode))


def swept_plan(machine: Machine) -> Plan:
    (plan,) = Scan("roll", 0.0, 0.15, 0.2, dwell_s=0.5).plans(machine)
    return plan


@pytest.fixture(scope="module", params=MODES)
def swept(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Machine, Recording, Path]:
    folder = tmp_path_factory.mktemp(request.param)
    machine = machine_in(request.param)
    (recording,) = run_in_lockstep(folder, [swept_plan(machine)], machine)
    return machine, recording, folder / "run.log"


def test_its_simulation_is_the_run_within_counts(swept: tuple[Machine, Recording, Path]) -> None:
    machine, recording, _ = swept
    simulated = simulate(machine, recording)
    for axis in machine.axes:
        off = recording[f"position_{axis}"] - simulated[f"position_{axis}"]
        assert np.abs(off).max() < 4.0 * COUNT_rad
        command, same = recording.channel(f"command_{axis}"), simulated.channel(f"command_{axis}")
        assert command.unit == same.unit
        assert np.abs(command.values - same.values).max() < 4.0 * COUNT_rad * 256.0  # of a speed
    assert np.abs(recording["reference_roll"] - recording["position_roll"]).max() < 0.01


def test_the_effort_that_follows_from_the_positions_is_what_the_drive_measures_a_row_later(swept: tuple[Machine, Recording, Path]) -> None:
    machine, recording, _ = swept
    effort = in_effort(recording)
    for axis in machine.axes:
        assert effort.channel(f"command_{axis}").unit == "A"
        off = recording[f"current_{axis}"][1:] - effort[f"command_{axis}"][:-1]
        assert np.std(off) < 1.3 * SENSOR_NOISE_A
        assert abs(np.mean(off)) < SENSOR_NOISE_A
    assert in_effort(effort, CARM) is not recording


def test_recordings_say_mode_and_unit(swept: tuple[Machine, Recording, Path]) -> None:
    machine, recording, _ = swept
    mode = machine.commanded["roll"]["mode"]
    unit = {"velocity": "rad/s", "position": "rad"}[mode]
    assert recording.metadata["commands"]["roll"] == {"mode": mode, "unit": unit, "excitation_unit": "A"}
    assert recording.channel("command_roll").unit == unit
    assert recording.channel("excitation_roll").unit == "A"


def test_frames_carry_the_recorded_target_in_counts(swept: tuple[Machine, Recording, Path]) -> None:
    machine, recording, log = swept
    sent = [m.data for m in can.LogReader(str(log)) if m.arbitration_id == 0x202]
    targets = [int.from_bytes(data[2:6], "little", signed=True) for data in sent if data[0] == 15]  # operation enabled
    asked = recording["command_roll"][:ROWS] / COUNT_rad
    begins_anywhere = machine.commanded["roll"]["mode"] == "position"  # a position's counts begin where the drive was switched on
    assert any(_rounded(asked, np.array(targets[k : k + ROWS]), begins_anywhere) for k in range(len(targets) - ROWS))


def _rounded(asked: np.ndarray, targets: np.ndarray, begins_anywhere: bool) -> bool:
    """Whether each target makes up for what those before have lost by rounding: of their sum at most half a count, at either end.

    So it is with one offset of all of them, which is not a whole number of counts.
    """
    rows, sums = np.arange(1, len(asked) + 1), np.cumsum(targets - asked)
    lowest, highest = ((sums - 1.0) / rows).max(), ((sums + 1.0) / rows).min()
    return bool(lowest <= highest) and (begins_anywhere or lowest <= 0.0 <= highest)


def test_one_axis_may_be_led_and_the_other_be_commanded_in_effort(tmp_path: Path) -> None:
    text = carm_text_in("position")
    head, rest = CARM.text.split("[drives.roll]", 1)[0], text.split("[drives.roll]", 1)[1]
    propeller = re.search(r"\[controller\.propeller\]\n(?:.|\n)*?(?=\n\[)", CARM.text)
    assert propeller is not None
    mixed = edited(r"\[controller\.propeller\]\n(?:.|\n)*?(?=\n\[)", propeller.group().replace("\\", "\\\\"), f"{head}[drives.roll]{rest}")
    mixed = edited(r'map = \["controlword", "target_position", "torque_offset"\]', 'map = ["controlword", "target_torque"]', mixed, count=1)
    machine = machine_from_text(mixed)
    (recording,) = run_in_lockstep(tmp_path, [swept_plan(machine)], machine)
    assert recording.channel("command_propeller").unit == "A"
    assert recording.channel("command_roll").unit == "rad"
    assert np.abs(recording["reference_roll"] - recording["position_roll"]).max() < 0.01


@pytest.mark.parametrize("mode", ONE_BY_DAY)
def test_a_led_axis_that_is_asked_to_stop_ends_with_its_brake_proven(mode: str, tmp_path: Path) -> None:
    machine = machine_in(mode)
    (plan,) = Static(2.0, {"roll": 0.5}).plans(machine)

    def ask(bench: Bench, row: int) -> None:
        bench.loop.stop_request.ask("somebody asked")

    with pytest.raises(
        LoopAbortedError, match="somebody asked; the motors were stopped: propeller, roll at rest: brake proven, voltage off"
    ):
        run_in_lockstep(tmp_path, [plan], machine, progress=ask)


LOAD = """
[[effect]]
name = "constant_load"
at = "roll"
tau0_Nm = 0.0
tau0_Nm_between = [-100.0, 100.0]
"""


@pytest.mark.parametrize("mode", MODES)
def test_after_a_way_the_brakes_of_a_led_axis_open_under_what_holds_it_there(mode: str) -> None:
    machine, ends = machine_from_text(carm_text_in(mode) + LOAD), (1.2, -0.9)
    model = Physics(machine.plant, noise=False)
    with open_bench(machine, BenchOptions("lockstep:"), np.array([0.0, ends[0]])) as bench:
        bench.move(np.array([0.0, ends[1]]))
        with bench.session():
            bench.take_hold()
            beside = bench.loop.control.effort - model.holding_effort(bench.pose)
            way = abs(bench.wiring.link.exchange(bench.loop.control.effort).position[1] - ends[1])
    assert abs(beside[1]) < 0.2, "the load of the pose that it came from differs by 3.3 A"
    assert way < 5e-4


@pytest.mark.parametrize("mode", MODES)
def test_a_stop_on_the_way_leaves_no_target_of_the_motion(mode: str, tmp_path: Path) -> None:
    machine = machine_in(mode)

    def ask(bench: Bench, row: int) -> None:
        if row >= 256:
            bench.loop.stop_request.ask("somebody asked")

    with pytest.raises(LoopAbortedError, match="roll at rest: brake proven"):
        run_in_lockstep(tmp_path, [swept_plan(machine)], machine, progress=ask)
    frames = [message for message in can.LogReader(str(tmp_path / "run.log")) if message.arbitration_id in (0x182, 0x202)]
    targets = [(m.data[0], int.from_bytes(m.data[2:6], "little", signed=True)) for m in frames if m.arbitration_id == 0x202]
    positions = [int.from_bytes(m.data[2:6], "little", signed=True) for m in frames if m.arbitration_id == 0x182]
    led = max(k for k, (controlword, _) in enumerate(targets) if controlword == 2)  # the end of the quick stop
    assert max(abs(target) for _, target in targets) > 1000
    for _, target in targets[led:]:
        assert abs(target - (positions[-1] if mode == "position" else 0)) <= 4


@pytest.mark.parametrize("mode", ONE_BY_DAY)
def test_a_drive_is_judged_by_the_effort_that_was_asked_for_in_the_same_tick(mode: str, tmp_path: Path) -> None:
    machine = machine_in(mode)
    plan = Multisine(period_s=2.0, periods=1, settle_periods=0, amplitude_A=0.5, jog=None).plans(machine)[0]
    efforts = []
    with open_bench(machine, BenchOptions("lockstep:", noise=False)) as bench:
        judge = bench.loop.judge
        assert judge is not None
        judged = judge.step

        def seen(sample: Sample, ticks: int, row_s: float, *, led: bool = True) -> str:
            if led:
                efforts.append((sample.effort - sample.commanded).tolist())
            return judged(sample, ticks, row_s, led=led)

        judge.step = seen  # type: ignore[method-assign]
        bench.run(plan, tmp_path / "run.mf4")
    assert np.abs(efforts[-plan.rows :]).max() < 2.5 * STEP_A


@pytest.mark.parametrize("mode", MODES)
def test_check_judges_the_whole_cascade(mode: str) -> None:
    found = {finding.name: finding for finding in check_machine(machine_in(mode), poses=9)}
    assert found["stability"].ok
    assert all(finding.ok for finding in check_machine(machine_in(mode), poses=9) if "margin" in finding.name)
    hard = edited(r"velocity_gain = 160.0", "velocity_gain = 1600.0", carm_text_in(mode))
    assert not all(finding.ok for finding in check_machine(machine_from_text(hard), poses=9) if "margin" in finding.name)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            r"^\[drives.propeller.loops\](?:.*\n)*?\]\n",
            "",
            "drives.propeller.loops: is missing; in position mode they are part of the feedback",
        ),
        (r'"torque_offset"\]', '"target_torque"]', "torque_offset is mapped nowhere; a drive in position mode needs it in an RPDO"),
        (r'"target_position"', '"target_velocity"', "target_position is mapped nowhere; a drive in position mode needs it in an RPDO"),
        (r"^mode = .*$", 'mode = "profile"', "drives.propeller.mode"),
        (r"torque_sections = \[\n    \[", "torque_sections = [[1", "has a static gain of"),
        (r"position_gain = 4.0", "position_gain = -4.0", "drives.propeller.loops.position_gain"),
        (r"(?<=\[controller.roll\]\n)position_sections = .*$", "position_sections = [[1.0, 0.0, 0.0, 1.0, -1.0, 0.0]]", "controller.roll"),
    ],
)
def test_a_file_that_cannot_be_led_is_refused_in_one_line(old: str, new: str, words: str) -> None:
    with pytest.raises(MachineFileError, match=re.escape(words)) as caught:
        machine_from_text(edited(old, new, carm_text_in("position"), count=1))
    assert "\n" not in str(caught.value)


def test_efforts_that_were_made_from_the_law_are_no_witness_of_it(swept: tuple[Machine, Recording, Path]) -> None:
    machine, recording, _ = swept
    made = in_effort(recording)
    assert made["target_roll"] is recording["command_roll"]
    without = Recording({name: channel for name, channel in made.channels.items() if not name.startswith("target_")}, made.metadata)
    assert audit_controllers(machine, [without]) == []
    torque = Recording({**recording.channels, "command_roll": in_effort(recording).channel("command_roll")}, recording.metadata)
    assert "roll" in [one.axis for one in audit_controllers(replace(machine, commands=(machine.commands[0], None)), [torque])]


def with_gains(machine: Machine, of_reference: float, of_position: float) -> Machine:
    """The machine with another law of its own for roll's targets."""
    command = machine.commands[1]
    own = command.controller
    sections = [sections.copy() for sections in (own.reference_sections, own.position_sections)]
    for each, gain in zip(sections, (of_reference, of_position), strict=True):
        each[0, :3] *= gain
    law = replace(own, reference_sections=sections[0], position_sections=sections[1])
    return replace(machine, commands=(machine.commands[0], replace(command, controller=law)))


@pytest.mark.parametrize("read", [lambda recording: recording, in_effort])
def test_targets_are_the_bench_s_own_law_or_are_told(swept: tuple[Machine, Recording, Path], read: Callable) -> None:
    machine, recording, _ = swept
    sound = audit_controllers(machine, [read(recording)])
    assert [(one.axis, one.status) for one in sound] == [("propeller", "as_filed"), ("roll", "as_filed")]
    assert sound[1].gain.value == pytest.approx(1.0, abs=1e-4)
    wrong = audit_controllers(with_gains(machine, 1.0 / 1.05, 1.0 / 1.05), [read(recording)])[1]
    assert wrong.status == "differs"
    assert wrong.gain.value == pytest.approx(1.05, abs=1e-3)
    assert machine.command_unit(1) in wrong.said


def test_a_wrong_gain_on_the_position_alone_is_another_law(swept: tuple[Machine, Recording, Path]) -> None:
    machine, recording, _ = swept
    if machine.commands[1].mode == "position":
        pytest.skip("its bench has no gain on the position here")
    assert audit_controllers(with_gains(machine, 1.0, 1.05), [recording])[1].status == "differs"


def test_a_target_beside_the_reference_is_told_where_the_file_has_no_law(swept: tuple[Machine, Recording, Path]) -> None:
    machine, recording, _ = swept
    if machine.commands[1].mode == "velocity":
        pytest.skip("velocity mode needs a law")
    bare = with_gains(machine, 0.0, 0.0)
    assert audit_controllers(bare, [recording])[1].status == "differs"
    channels = {**recording.channels, "command_roll": Channel("rad", recording["reference_roll"])}
    assert audit_controllers(bare, [Recording(channels, recording.metadata)])[1].status == "as_filed"


def test_without_controller_states_no_effort_follows(
    swept: tuple[Machine, Recording, Path],
) -> None:
    _, recording, _ = swept
    bare = Recording(recording.channels, {**recording.metadata, "initial": {}})
    with pytest.raises(RecordingError, match=r"no initial\.controller_states, .*; recordings of `isocenter run` have them"):
        in_effort(bare)
