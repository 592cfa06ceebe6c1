"""Claims about the observer in the sample loop: what is recorded, that a replay repeats it, and that a run goes on without the IMU."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bench_machines import edited

from drivers.errors import BusUnavailableError
from drivers.interface import Sample
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.cli import main
from hil.errors import LoopAbortedError, UnusableInputError
from hil.experiments import Scan
from hil.machine import Machine, machine_from_text
from hil.machine.effects_file import read_effects_file
from hil.observing import ObserverDesign, observe, write_design
from hil.observing.board import EstimateBoard, latest_estimate, remove_abandoned
from hil.observing.live import LiveObserver
from hil.recording import Channel, Recording, RecordingWarning, read_recording
from virtual_bus.lockstep import imu_line
from virtual_bus.serial.pipe import PipeEnd

PLAN = Scan("roll", -0.1, 0.1, 0.2, dwell_s=0.5)


def scanned(machine: Machine, design: ObserverDesign, path: Path, **options: object) -> Recording:
    """A short scan in lockstep with the observer."""
    plan = PLAN.plans(machine)[0]
    with open_bench(machine, BenchOptions("lockstep:", seed=5, **options), plan.start_pose, LiveObserver(design.observer())) as bench:  # type: ignore[arg-type]
        bench.run(plan, path)
    return read_recording(path)


def assert_replayed(recording: Recording, design: ObserverDesign) -> None:
    """Every estimate and variance in a recording is the replay's, bit for bit."""
    replayed = observe(recording, design.observer())
    assert np.array_equal(recording.matrix(replayed.names), replayed.values, equal_nan=True)


def imu_missing(recording: Recording) -> np.ndarray:
    return np.asarray(recording["estimate_measured"] == 4)


def test_two_recordings_of_one_bench_are_each_replayed_from_their_own_row_0(
    machine: Machine, design: ObserverDesign, tmp_path: Path
) -> None:
    plan = PLAN.plans(machine)[0]
    with open_bench(machine, BenchOptions("lockstep:", seed=5), plan.start_pose, LiveObserver(design.observer())) as bench:
        for name in ("one.mf4", "two.csv"):
            bench.run(plan, tmp_path / name)
    for name in ("one.mf4", "two.csv"):
        recording = read_recording(tmp_path / name)
        assert_replayed(recording, design)
        assert recording.metadata["observer"]["filter"] == "ukf"


def test_an_observer_that_only_watches_changes_no_command(machine: Machine, design: ObserverDesign, tmp_path: Path) -> None:
    watched = scanned(machine, design, tmp_path / "watched.mf4")
    plan = PLAN.plans(machine)[0]
    with open_bench(machine, BenchOptions("lockstep:", seed=5), plan.start_pose) as bench:
        bench.run(plan, tmp_path / "alone.mf4")
    alone = read_recording(tmp_path / "alone.mf4")
    for name, channel in alone.channels.items():
        assert np.array_equal(channel.values, watched[name], equal_nan=True), name


def test_an_imu_whose_readings_are_held_counts_as_missing_and_variances_grow(
    machine: Machine, design: ObserverDesign, tmp_path: Path
) -> None:
    effects = tmp_path / "effects.toml"
    effects.write_text('[[effect]]\nname = "sample_dropout"\nat = "imu"\np = 0.3\nlength = 40\nseed = 4\n')
    emulated = machine.with_effects(read_effects_file(effects, machine))
    recording = scanned(machine, design, tmp_path / "held.mf4", emulated=emulated)
    held = np.concatenate(([False], (np.diff(recording["imu_x"]) == 0.0) & (np.diff(recording["gyro_x"]) == 0.0)))
    assert 0.1 < held.mean() < 0.6
    assert np.array_equal(imu_missing(recording), held)
    variance = recording["estimate_detector_wy_variance"]
    begins = np.flatnonzero(np.diff(held.astype(int)) == 1)
    grows = [variance[k + 32] / variance[k] for k in begins if k > 128 and k + 32 < len(variance)]
    assert len(grows) > 1, grows
    assert min(grows) > 1.3, grows
    assert np.isfinite(recording["command_roll"]).all()
    assert_replayed(recording, design)


def test_ticks_the_loop_lost_are_time_that_passed_live_and_in_replay(machine: Machine, design: ObserverDesign, tmp_path: Path) -> None:
    plan = PLAN.plans(machine)[0]
    with open_bench(machine, BenchOptions("lockstep:", seed=5), plan.start_pose, LiveObserver(design.observer())) as bench:

        def lose(k: int) -> None:
            bench.wiring.clock.missed += 5 * (k > 0)  # type: ignore[misc]  # a number in lockstep

        bench.run(plan, tmp_path / "lost.mf4", lose)
    with pytest.warns(RecordingWarning, match="20 ticks are missing in 4 places"):
        recording = read_recording(tmp_path / "lost.mf4")
    assert (np.diff(recording.ticks) == 6).sum() > 1
    assert_replayed(recording, design)


def test_after_ticks_that_are_not_recorded_the_estimate_is_where_the_machine_went_meanwhile(
    machine: Machine, design: ObserverDesign, tmp_path: Path
) -> None:
    whole = scanned(machine, design, tmp_path / "whole.mf4")
    kept = np.ones(whole.rows, dtype=bool)
    gap = slice(whole.rows // 2, whole.rows // 2 + 6)  # in full motion
    kept[gap] = False
    channels = {name: Channel(channel.unit, channel.values[kept]) for name, channel in whole.channels.items()}
    speed = np.diff(whole["estimate_link_position_roll"])[gap].mean()  # per tick
    replayed = observe(Recording(channels, whole.metadata), design.observer())
    after = replayed.values[gap.start]
    estimates = whole.matrix(replayed.names)
    column = replayed.names.index("estimate_link_position_roll")
    assert abs(speed) > 3e-4
    assert abs(after[column] - estimates[gap.stop, column]) < 0.05 * abs(speed)
    variance = replayed.names.index("estimate_detector_wy_variance")
    assert after[variance] > 1.01 * estimates[gap.stop, variance], "and it is known to be less certain"


def test_a_rehearsal_changes_no_estimate(design: ObserverDesign) -> None:
    plain, rehearsing, generator = LiveObserver(design.observer()), LiveObserver(design.observer()), np.random.default_rng(7)
    sample, command = Sample(2), np.zeros(2)
    for k in range(50):
        sample.position[:] = sample.link_position[:] = generator.normal(scale=1e-4, size=2)
        sample.imu[:] = generator.normal(size=6)
        for observer in (plain, rehearsing):
            observer.step(sample, command, k)
        assert np.array_equal(plain.estimate, rehearsing.estimate, equal_nan=True)
        rehearsing.rehearse()


class Cable(PipeEnd):
    """The IMU's line, until it is pulled."""

    def __init__(self) -> None:
        super().__init__()
        self.is_pulled = False

    def to(self, line: PipeEnd) -> Cable:
        self._line = line
        return self

    def read(self) -> bytes:
        if self.is_pulled:
            raise BusUnavailableError("serial port /dev/ttyUSB0 is gone: the other end hung up")
        return self._line.read()

    def write(self, data: bytes) -> None:
        self._line.write(data)

    def pull_at(self, row: int) -> Callable[[int], None]:
        """A progress callback that pulls it at the end of that row."""

        def progress(k: int) -> None:
            self.is_pulled = self.is_pulled or k == row

        return progress


@pytest.fixture
def cable(monkeypatch: pytest.MonkeyPatch) -> Cable:
    cable = Cable()
    monkeypatch.setattr("hil.bench.wiring.imu_line", lambda emulated: cable.to(imu_line(emulated)))
    return cable


def test_a_run_goes_on_without_its_imu_and_says_so(machine: Machine, design: ObserverDesign, cable: Cable, tmp_path: Path) -> None:
    plan = PLAN.plans(machine)[0]
    with open_bench(machine, BenchOptions("lockstep:", seed=5), plan.start_pose, LiveObserver(design.observer())) as bench:
        timing = bench.run(plan, tmp_path / "unplugged.mf4", cable.pull_at(256))
    recording = read_recording(tmp_path / "unplugged.mf4")
    assert recording.rows == plan.rows
    assert np.flatnonzero(imu_missing(recording)).tolist() == list(range(257, plan.rows))
    (line,) = timing.judged
    assert line.startswith("imu: serial port /dev/ttyUSB0 is gone")
    assert np.flatnonzero(recording["sensor_marks"]).tolist() == list(range(257, plan.rows))
    variance = recording["estimate_detector_wy_variance"]
    assert variance[-1] > 2.0 * variance[256]
    assert np.isfinite(recording.matrix([f"estimate_detector_{axis}" for axis in ("x", "y", "z", "vx", "wx")])).all()
    assert_replayed(recording, design)


def test_an_imu_that_is_gone_ends_the_run_where_the_machine_file_says_so(machine: Machine, cable: Cable, tmp_path: Path) -> None:
    machine = machine_from_text(edited(r'(\[judging.imu\]\nfollows = )"mark"', r'\1"stop"', machine.text))
    plan = PLAN.plans(machine)[0]
    with (
        pytest.raises(LoopAbortedError, match="row 257: imu: serial port /dev/ttyUSB0 is gone"),
        open_bench(machine, BenchOptions("lockstep:", seed=5), plan.start_pose) as bench,
    ):
        bench.run(plan, tmp_path / "unplugged.mf4", cable.pull_at(256))


def test_another_process_reads_whole_rows(tmp_path: Path) -> None:
    bus = f"virtual:{tmp_path.name}-{os.getpid()}"  # a killed test run may have left a page
    with pytest.raises(UnusableInputError, match="no observer runs there"):
        latest_estimate(bus)
    board = EstimateBoard(bus, ["estimate_a", "estimate_b"])
    try:
        board.put(7, np.array([1.5, -2.5]))
        newest = latest_estimate(bus)
        assert (newest.row, newest["estimate_a"], newest["estimate_b"]) == (7, 1.5, -2.5)
        with pytest.raises(UnusableInputError, match="no estimate estimate_c; there is estimate_a, estimate_b"):
            newest["estimate_c"]
        board._counters[0] += 1  # the writer died in the middle of a row
        with pytest.raises(UnusableInputError, match="stopped in the middle of a row"):
            latest_estimate(bus)
    finally:
        board.close()


def test_a_second_page_on_the_bus_leaves_the_first_writers_memory_alone_and_stays_when_it_ends(tmp_path: Path) -> None:
    bus = f"virtual:{tmp_path.name}-{os.getpid()}"  # a killed test run may have left a page
    first = EstimateBoard(bus, [f"estimate_{k}" for k in range(2000)])  # some pages of memory
    second = EstimateBoard(bus, ["estimate_a"])
    try:
        first.put(3, np.zeros(2000))  # beyond the end of the second's file
        second.put(8, np.array([2.5]))
        first.close()
        newest = latest_estimate(bus)
        assert (newest.row, newest.names, newest["estimate_a"]) == (8, ("estimate_a",), 2.5)
    finally:
        second.close()
    with pytest.raises(UnusableInputError, match="no observer runs there"):
        latest_estimate(bus)


def leave_a_page(bus: str, name: str) -> None:
    """As a process does that ends without having closed it."""
    made = f"from hil.observing.board import EstimateBoard; EstimateBoard({bus!r}, [{name!r}])"
    subprocess.run([sys.executable, "-c", made], check=True)


@pytest.mark.slow
def test_pages_of_killed_runs_are_removed_and_those_of_living_ones_are_not(tmp_path: Path) -> None:
    lives, killed = f"virtual:{tmp_path.name}-{os.getpid()}", f"virtual:{tmp_path.name}-{os.getpid()}-killed"
    board = EstimateBoard(lives, ["estimate_a"])
    try:
        board.put(1, np.array([0.5]))
        leave_a_page(killed, "estimate_a")
        with pytest.raises(UnusableInputError, match="the observer that ran there has ended"):
            latest_estimate(killed)
        remove_abandoned()  # of this user's, whoever's test they are
        with pytest.raises(UnusableInputError, match="no observer runs there"):
            latest_estimate(killed)
        assert latest_estimate(lives).row == 1
    finally:
        board.close()


@pytest.mark.slow
def test_a_run_that_begins_while_a_killed_one_s_page_is_removed_keeps_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bus, begun, rename = f"virtual:{tmp_path.name}-{os.getpid()}", list[EstimateBoard](), Path.rename
    leave_a_page(bus, bus)

    def late(page: Path, aside: Path) -> Path:
        if not begun and bus.encode() in page.read_bytes():
            begun.append(EstimateBoard(bus, ["estimate_b"]))  # between the look at the page and its removal
        return rename(page, aside)

    monkeypatch.setattr(Path, "rename", late)
    remove_abandoned()
    (board,) = begun
    board.put(4, np.array([0.5]))
    assert latest_estimate(bus).row == 4
    board.close()
    with pytest.raises(UnusableInputError, match="no observer runs there"):
        latest_estimate(bus)


def test_the_command_runs_an_observer_and_refuses_what_does_not_fit(
    machine: Machine, design: ObserverDesign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_design(design, tmp_path / "carm.observer.npz")
    recorded = tmp_path / "still.mf4"
    still = ["run", "static", "-m", "carm", "-b", "lockstep:", "--seconds", "1", "-o", str(recorded)]
    with pytest.raises(SystemExit) as left:
        main([*still, "--observer", str(tmp_path / "carm.observer.npz")])
    assert left.value.code == 0
    capsys.readouterr()
    replay = ["observe", "carm", str(recorded), "-o", str(tmp_path / "still.est.npz"), "--design", str(tmp_path / "carm.observer.npz")]
    with pytest.raises(SystemExit) as left:
        main([*replay, "--json", "-"])
    document = json.loads(capsys.readouterr().out)
    assert left.value.code == 0
    assert document["live"] == "the same"
    for more, word in (
        (["--observer", "absent.npz"], "absent.npz: no such file"),
        (["--damping", "0.1"], "give --observer FILE as well"),
        (["-b", "virtual:nobody", "--emulated", "carm"], "--emulated: only a run on lockstep:"),
        (["--observer", str(tmp_path / "carm.observer.npz"), "--truth", str(tmp_path / "carm.observer.npz")], "is read by this command"),
    ):
        with pytest.raises(SystemExit) as left:
            main([*still, *more])
        error = capsys.readouterr().err
        assert left.value.code == 2
        assert word in error
        assert len(error.strip().splitlines()) == 1
