"""The bench over `lockstep:`: repeatable bit for bit, at 256 Hz and at 1 kHz, and its recordings say what it found."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM, STOPWATCH, LosingBus, carm_at_1_kHz, read_truth, run_in_lockstep

from drivers.canopen.quick_stop import STANDING_SHARE
from drivers.errors import DeviceFaultError
from drivers.interface import Sample
from hil.bench.bench import Bench
from hil.bench.open import open_bench, recording_paths
from hil.bench.options import BenchOptions
from hil.errors import LoopAbortedError, UnusableInputError
from hil.experiments import Jog, JogOnly, Multisine, Plan, Scan, Static
from hil.machine import load_machine
from hil.recording import Recording, read_recording
from hil.simulation import compare, simulate
from virtual_bus.settings import EffectSetting

ROLL = CARM.axis_index("roll")
POSE = {"roll": 0.5, "propeller": -0.2}
SHORT = Multisine(
    pose=POSE, lines=(3, 5, 7, 11, 13), amplitude_A=0.4, period_s=1.0, periods=1, settle_periods=0, experiments="single", jog=None, seed=4
)
COUNT_rad = CARM.bus.scalings[ROLL].position_resolution
LINK_COUNT_rad = CARM.bus.scalings[ROLL].link_resolution


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lockstep")


@pytest.fixture(scope="module")
def two_plans() -> list[Plan]:
    return SHORT.plans(CARM)


@pytest.fixture(scope="module")
def first(folder: Path, two_plans: list[Plan]) -> list[Recording]:
    """Two recordings of one bench, the machine switched on at pose zero."""
    return run_in_lockstep(folder, two_plans, name="first", start_pose=np.zeros(2), seed=3)


def _equal(one: Recording, other: Recording, leave_out: tuple[str, ...] = ()) -> set[str]:
    assert one.channels.keys() == other.channels.keys()
    return {name for name in one.channels if name not in leave_out and not np.array_equal(one[name], other[name], equal_nan=True)}


@pytest.mark.slow
def test_the_same_seed_gives_the_same_recordings_bit_for_bit_and_the_same_frames(
    folder: Path, two_plans: list[Plan], first: list[Recording]
) -> None:
    again = run_in_lockstep(folder, two_plans, name="again", start_pose=np.zeros(2), seed=3)
    for one, other in zip(first, again, strict=True):
        assert _equal(one, other) == set()
        assert one.metadata == other.metadata
    frames = (folder / "first.log").read_bytes()
    assert frames == (folder / "again.log").read_bytes()
    assert frames.count(b"\n") > 2 * 256 * 7
    assert (folder / "first.csv").read_bytes() == (folder / "again.csv").read_bytes()


@pytest.mark.slow
def test_another_seed_changes_the_sensors_noise_and_nothing_the_bench_decides(
    folder: Path, two_plans: list[Plan], first: list[Recording]
) -> None:
    (other,) = run_in_lockstep(folder, two_plans[:1], name="other", start_pose=np.zeros(2), seed=5)
    different = _equal(first[0], other, STOPWATCH)
    assert {"imu_x", "gyro_z", "current_roll"} <= different
    assert not any(name.startswith(("time", "reference", "excitation", "feedforward")) for name in different)


@pytest.mark.nightly
def test_a_run_at_1_kHz_keeps_its_time_and_is_what_the_simulation_says(folder: Path) -> None:
    machine = carm_at_1_kHz()
    plans = Multisine(
        pose=POSE, lines=(3, 5, 7), amplitude_A=0.3, period_s=0.5, periods=2, settle_periods=0, experiments="single", jog=None
    ).plans(machine)[1:]
    (recording,) = run_in_lockstep(folder, plans, machine, name="fast")
    assert recording.rows == 1000
    assert recording.sample_rate_Hz == pytest.approx(1000.0)
    assert not recording.channel("position_roll").missing.any()
    assert not recording.channel("imu_z").missing.any()
    assert np.diff(recording["imu_time"]) == pytest.approx(1e-3, abs=1.01e-4)  # its own time stamps, in steps of 0.1 ms
    assert np.ptp(recording["position_roll"]) > 20 * COUNT_rad
    comparison = compare(recording, simulate(machine, recording))
    assert comparison["position_roll"].rms < 2 * COUNT_rad
    assert comparison["current_roll"].nrmse < 0.08  # its noise is 10 mA


def test_several_plans_are_named_by_realisation_and_experiment_counted_from_one() -> None:
    plans = Multisine(pose=POSE, lines=(3, 5), amplitude_A=0.1, period_s=1.0, periods=1, realisations=2, jog=None).plans(CARM)
    names = [path.name for path in recording_paths(Path("out/run.csv"), plans)]
    assert names == ["run_r1_e1.csv", "run_r1_e2.csv", "run_r2_e1.csv", "run_r2_e2.csv"]
    assert recording_paths(Path("run.mf4"), plans[:1]) == [Path("run.mf4")]


def test_each_recording_says_which_machine_experiment_seed_and_controller_states_made_it(first: list[Recording]) -> None:
    for number, recording in enumerate(first):
        assert recording.machine_hash == CARM.hash
        assert recording.machine_text == CARM.text
        assert recording.experiment["experiment"] == number
        assert recording.experiment["excited_lines"] == [3, 5, 7, 11, 13]
        initial = recording.metadata["initial"]
        assert initial["seed"] == 3
        assert initial["brakes"] == {"propeller": "open", "roll": "open"}
        assert recording.rows == 256
        assert "timing" not in recording.metadata
        assert set(initial["controller_states"]) == {"propeller", "roll"}
        assert any("homed" in line for line in recording.metadata["bench"]["commissioning"])


def test_row_0_is_standstill_in_the_start_pose_the_machine_was_brought_to(folder: Path, first: list[Recording]) -> None:
    truth = read_truth(folder / "first.csv")
    for number, recording in enumerate(first):
        for axis, pose in POSE.items():
            assert recording[f"reference_{axis}"][0] == pose
            assert recording[f"position_{axis}"][0] == pytest.approx(pose, abs=4 * COUNT_rad)
            assert truth[f"joint_speed_{axis}"][number * 256] == pytest.approx(0.0, abs=2e-4)  # a count or so in 10 ms
        assert truth["joint_speed_propeller_gear"][number * 256] == pytest.approx(0.0, abs=2e-4)
        assert [recording[f"gyro_{axis}"][0] for axis in "xyz"] == pytest.approx([2e-4, -1e-4, 1e-4], abs=4 * 5e-4)  # its bias


def test_row_0_answers_to_the_holding_effort_that_the_integrators_bring(first: list[Recording]) -> None:
    from virtual_bus.physics import Physics

    holding = Physics(CARM.plant, noise=False).holding_effort(np.array([POSE[axis] for axis in CARM.axes]))
    for recording in first:
        for axis, effort in zip(CARM.axes, holding, strict=True):
            fed_back = recording[f"command_{axis}"][0] - recording[f"excitation_{axis}"][0]
            assert fed_back == pytest.approx(effort, abs=0.05)
            assert recording[f"current_{axis}"][0] == pytest.approx(effort, abs=0.1)


def test_a_current_answers_to_the_command_of_the_row_before(first: list[Recording]) -> None:
    command, current = first[1]["command_roll"], first[1]["current_roll"]
    step = CARM.bus.scalings[ROLL].rated / 1000.0  # the target goes out in per mille of rated
    assert np.abs(current[1:] - command[:-1]).max() < 5 * 0.01 + step  # five sigma of its noise
    assert np.abs(current[1:] - command[1:]).max() > 2 * (5 * 0.01 + step)  # and not to its own


def test_the_truth_has_a_row_for_every_recorded_row_and_agrees_with_the_encoders(folder: Path, first: list[Recording]) -> None:
    truth = read_truth(folder / "first.csv")
    assert len(truth["time"]) == sum(recording.rows for recording in first)
    for number, recording in enumerate(first):
        rows = slice(number * 256, number * 256 + 256)
        for axis in CARM.axes:
            motor, gear = (truth[f"joint_position_{name}"][rows] for name in (axis, f"{axis}_gear"))
            missed = recording[f"position_{axis}"] - motor
            assert np.ptp(missed) < 1.01 * COUNT_rad  # quantisation is all that changes
            assert abs(missed.mean()) < 5e-5  # homing found zero
            assert recording[f"link_position_{axis}"] == pytest.approx(motor + gear, abs=1.01 * LINK_COUNT_rad)


def test_every_column_of_the_truth_has_its_name_and_unit(folder: Path, first: list[Recording]) -> None:
    header = (folder / "first.csv").read_text().split("\n", 1)[0].split(",")
    assert {"time [s]", "joint_position_roll_gear [rad]", "joint_speed_propeller [rad/s]", "friction_effort_roll [Nm]"} <= set(header)
    assert {"pose_detector_x [m]", "pose_detector_r33", "pose_tube_z [m]"} <= set(header)


@pytest.mark.slow
def test_physics_that_the_machine_file_does_not_know_shows_in_the_current(folder: Path) -> None:
    """12 Nm of Coulomb friction at roll: 12/(0.095 * 500) = 0.2526 A to either side, Armstrong-Helouvry et al. 1994."""
    plans = JogOnly(pose={"roll": 0.5}, jog=Jog(0.02, line=1), period_s=5.0, periods=1).plans(CARM)
    secret = CARM.with_effects((EffectSetting("coulomb_friction", "roll", {"Fc": 12.0}),))
    (known,) = run_in_lockstep(folder, plans, name="known", noise=False)
    (rough,) = run_in_lockstep(folder, plans, name="rough", noise=False, emulated=secret)
    speed = np.gradient(known["reference_roll"]) * 256.0
    moving = (np.abs(speed) > 0.5 * np.abs(speed).max()) & (known.time > 5.0)
    extra = (rough["current_roll"] - known["current_roll"])[moving] * np.sign(speed[moving])
    assert extra.mean() == pytest.approx(12.0 / (0.095 * 500.0), rel=0.05)
    assert np.abs((rough["current_propeller"] - known["current_propeller"])[moving].mean()) < 0.02
    assert rough.machine_hash == known.machine_hash  # the secret is kept


def test_commissioning_says_what_was_checked_axis_by_axis() -> None:
    with open_bench(CARM, BenchOptions("lockstep:"), np.array([0.3, -0.7])) as bench:
        report = bench.commission()
    pushed = [line for line in report if "the right way" in line]
    homed = [re.fullmatch(r"(\w+): homed at ([-+.0-9]+) rad; .*differ by ([-+.0-9e]+) rad.*", line) for line in report if "homed" in line]
    assert [line.split(":")[0] for line in pushed] == ["propeller", "roll"]
    assert [match[1] for match in homed] == ["propeller", "roll"]
    assert [float(match[2]) for match in homed] == pytest.approx([0.3, -0.7], abs=2e-3)
    assert all(abs(float(match[3])) < np.radians(0.1) for match in homed)


@pytest.mark.slow
def test_both_ends_of_the_bus_count_the_same_syncs_and_a_recording_has_one_a_row(folder: Path, two_plans: list[Plan]) -> None:
    """What a panel stamps its exposures with, over two sessions."""
    with open_bench(CARM, BenchOptions("lockstep:"), two_plans[0].start_pose) as bench:
        emulated, told = bench.wiring.link.network.can_bus.machine, []

        class Counted:
            begin = end = staticmethod(lambda syncs: told.append((syncs, emulated.syncs)))

        for plan in two_plans:
            bench.run(plan, folder / "counted.mf4", rows=Counted)
    assert len(told) == 4
    assert all(ours == theirs > 0 for ours, theirs in told)
    rows = [len(plan.reference) for plan in two_plans]
    assert [after[0] - before[0] for before, after in (told[:2], told[2:])] == rows


def test_a_machine_without_bus_cannot_be_run_and_is_told_so() -> None:
    with (
        pytest.raises(UnusableInputError, match=r"emps: its file has no \[bus\]"),
        open_bench(load_machine("emps"), BenchOptions("lockstep:")),
    ):
        pass


@pytest.fixture
def losing(monkeypatch: pytest.MonkeyPatch) -> type[LosingBus]:
    """The lockstep bus loses frames when `LosingBus.lost_ids` says so."""
    monkeypatch.setattr("hil.bench.wiring.LockstepBus", LosingBus)
    monkeypatch.setattr(LosingBus, "lost_ids", ())
    return LosingBus


def test_positions_lost_for_a_moment_are_missing_in_the_recording_and_the_run_goes_on(
    folder: Path, losing: type[LosingBus], two_plans: list[Plan]
) -> None:
    def lose_once(bench: Bench, row: int) -> None:
        link = bench.wiring.link
        tick, exchange = 0, link.exchange

        def counted(command: np.ndarray) -> Sample:
            nonlocal tick
            tick += 1
            losing.lost_ids = (0x182,) if row == 0 and 10 <= tick < 13 else ()
            return exchange(command)

        if row == 0:
            link.exchange = counted

    (recording,) = run_in_lockstep(folder, two_plans[:1], name="bridged", progress=lose_once)
    missing = np.flatnonzero(recording.channel("position_roll").missing)
    assert len(missing) == 3
    assert np.ptp(missing) == 2
    assert recording.rows == 256
    assert not recording.channel("position_propeller").missing.any()
    assert recording["data_age_roll"][missing] == pytest.approx(np.arange(1, 4) / 256.0)
    assert np.isfinite(recording["command_roll"]).all()


def test_positions_lost_for_longer_stop_the_motors_and_every_row_is_kept(folder: Path, losing: type[LosingBus]) -> None:
    plans = Static(2.0, POSE).plans(CARM)

    def lose(bench: Bench, row: int) -> None:
        losing.lost_ids = (0x182,) if row >= 256 else ()

    with pytest.raises(LoopAbortedError, match=r"^row 260: roll: no position for 4 ticks.* 261 rows are kept$"):
        run_in_lockstep(folder, plans, name="lost", progress=lose)
    recording = read_recording(folder / "lost_0.mf4")
    assert recording.rows == 261
    assert "no position" in recording.metadata["ended"]["error"]
    assert np.flatnonzero(recording.channel("position_roll").missing).tolist() == [257, 258, 259, 260]


def test_an_imu_that_says_nonsense_is_recorded_as_missing(folder: Path, monkeypatch: pytest.MonkeyPatch, two_plans: list[Plan]) -> None:
    from virtual_bus.serial.xsens_imu import EmulatedImu

    honest = EmulatedImu.on_sync
    monkeypatch.setattr(
        EmulatedImu, "on_sync", lambda self, readings, time_s: honest(self, np.where([0, 0, 1, 0, 0, 0], np.nan, readings), time_s)
    )
    (recording,) = run_in_lockstep(folder, two_plans[:1], name="nonsense")
    assert recording.channel("imu_z").missing.all()
    assert not recording.channel("imu_x").missing.any()


def test_a_drive_in_fault_stops_the_run_in_words_with_its_rows_kept(folder: Path) -> None:
    def trip(bench: Bench, row: int) -> None:
        if row == 128:
            emulated = bench.wiring.link.network.can_bus.machine
            emulated.drives["roll_drive"].inject_fault(0x2310)

    with pytest.raises((DeviceFaultError, LoopAbortedError), match=r"roll_drive.*2310h"):
        run_in_lockstep(folder, Static(2.0, POSE).plans(CARM), name="tripped", progress=trip)
    recording = read_recording(folder / "tripped_0.mf4")
    assert 128 <= recording.rows <= 132
    assert "2310h" in recording.metadata["ended"]["error"]


def test_a_stop_request_while_homing_stops_there_and_not_at_the_first_row() -> None:
    with open_bench(CARM, BenchOptions("lockstep:"), np.zeros(2)) as bench:
        bench.loop.stop_request.ask("asked to stop by SIGINT")
        with pytest.raises(LoopAbortedError, match=r"^asked to stop by SIGINT; the motors were stopped"):
            bench.commission()
        assert bench.commissioning == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["SIGTERM", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("SIGHUP", "SIGQUIT") if hasattr(signal, name))],
)
def test_a_run_asked_to_stop_by_a_signal_keeps_its_rows_and_leaves_the_handlers_as_they_were(folder: Path, name: str) -> None:
    number = getattr(signal, name)
    before = signal.getsignal(number)

    def interrupt(bench: Bench, row: int) -> None:
        if row == 128:
            signal.raise_signal(number)

    with pytest.raises(LoopAbortedError, match=rf"row 129: asked to stop by {name}|^asked to stop by {name}"):
        run_in_lockstep(folder, Static(2.0, POSE).plans(CARM), name=f"interrupted_{name}", progress=interrupt)
    assert 129 <= read_recording(folder / f"interrupted_{name}_0.mf4").rows <= 130
    assert signal.getsignal(number) is before


def test_after_an_interrupt_the_time_to_standstill_is_told(folder: Path) -> None:
    """From full speed it takes as long as the drive's quick stop needs, from standstill no time."""
    speed = 0.4

    def interrupted(name: str, plans: list[Plan], at_row: int) -> tuple[str, list[dict[str, object]]]:
        def interrupt(bench: Bench, row: int) -> None:
            if row >= at_row:
                signal.raise_signal(signal.SIGINT)

        with pytest.raises(LoopAbortedError) as stopped:
            run_in_lockstep(folder, plans, name=name, progress=interrupt)
        (said,) = [note for note in stopped.value.__notes__ if note.startswith(("standstill", "no encoder"))]
        events = read_recording(folder / f"{name}_0.mf4").metadata["events"]
        return said, [event for event in events if event["what"] == "axis stopped"]

    said, _ = interrupted("stood", Static(2.0, POSE).plans(CARM), 128)
    within = f"{STANDING_SHARE * CARM.bus.motions[ROLL].tracking_error:.1e} rad"
    each = rf"(0\.0\d s|within {within})"
    told = rf"(no encoder moved by more than {within}|standstill 0\.0\d s) after the stop began( \(propeller {each}, roll {each}\))?"
    assert re.fullmatch(told, said), said
    said, events = interrupted("moved", Scan("roll", -0.5, 0.5, speed).plans(CARM), 600)
    took = float(re.match(r"standstill ([\d.]+) s", said)[1])
    stopping = CARM.bus.motions[ROLL]
    assert 0.02 < took < 1.0, said
    assert max(event["standstill_s"] for event in events) == pytest.approx(took, abs=0.006), stopping


@pytest.mark.slow
def test_a_turntable_that_coasts_from_its_first_move_check_is_led_to_its_way(tmp_path: Path) -> None:
    table = load_machine("turntable")
    friction = (EffectSetting("coulomb_friction", "turn", {"Fc": 5.214}), EffectSetting("viscous_friction", "turn", {"Fv": 3.211}))
    with open_bench(table, BenchOptions("lockstep:", seed=1, emulated=table.with_effects(friction))) as bench:
        bench.run(Static(1.0, {"turn": 0.0}).plans(table)[0], tmp_path / "run.mf4")
        assert abs(bench.pose[0]) < np.radians(0.4)  # the check's travel
