"""The recorder process under SIGKILL: whatever dies, at whatever moment, what was in the journal is read, row after row."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import SUPPORT
from refusals import answer_or_refusal

from hil.errors import LoopAbortedError, RecordingError
from hil.recording import RecorderProcess, Recording, read_recording
from hil.recording.journal import recover
from hil.recording.ring import Ring

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are killed and awaited with Linux's pidfd")

resource = pytest.importorskip("resource")

LOOP = SUPPORT / "loop_process.py"
ENDLESS = 10_000_000
CHANNELS = [("time", "s"), ("position_roll", "rad")]


class Loop:
    """A loop process, and what it said last."""

    def __init__(self, path: Path, rows: int = ENDLESS) -> None:
        self.process = subprocess.Popen([sys.executable, LOOP, path, str(rows)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.recorder = self.kept = 0

    def listen(self, lines: int) -> None:
        for _ in range(lines):
            word, number = self.process.stdout.readline().split()
            if word == "closed":
                return
            self.recorder, self.kept = int(word), int(number)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def complaints(self) -> str:
        """Everything it and its recorder wrote to the terminal; returns once both are gone."""
        return self.process.stderr.read()


def ended(pid: int) -> int:
    """A handle that turns readable when the process ends."""
    return os.pidfd_open(pid)


def wait_for(handle: int) -> None:
    readable, _, _ = select.select([handle], [], [], 60.0)
    os.close(handle)
    assert readable, "the recorder did not end"


def read_whatever_is_there(path: Path) -> Recording:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return read_recording(path)


def assert_unbroken(recording: Recording, at_least: int) -> None:
    np.testing.assert_array_equal(recording["estimate_row"], np.arange(recording.rows))
    assert recording.rows >= at_least


def named_memory(pid: int) -> list[object]:
    """Shared memory of a process that has a name, and so would be left behind if everybody were killed."""
    return [line for line in Path(f"/proc/{pid}/maps").read_text().splitlines() if "/dev/shm/" in line]


@pytest.mark.parametrize("lines", [2, 40, 103])  # the first is said before the first row
def test_when_the_loop_is_killed_the_recorder_finishes_the_recording(tmp_path: Path, lines: int) -> None:
    path = tmp_path / "run.mf4"
    loop = Loop(path)
    loop.listen(lines)
    assert named_memory(loop.process.pid) == []
    recorder = ended(loop.recorder)
    loop.kill()
    wait_for(recorder)
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.mf4"]
    recording = read_recording(path)
    assert_unbroken(recording, loop.kept)
    assert recording.rows >= 64 * (lines - 1)  # not only what was on disk: the ring outlives the loop
    assert "without closing" in recording.metadata["ended"]["error"]
    assert loop.complaints() == ""


@pytest.mark.slow
@pytest.mark.parametrize("lines", [1, 60])
def test_when_the_recorder_is_killed_again_and_again_no_row_is_lost(tmp_path: Path, lines: int) -> None:
    path = tmp_path / "run.csv"
    loop = Loop(path, rows=20_000)
    killed = set()
    for _ in range(3):
        loop.listen(lines)
        while loop.recorder in killed:
            loop.listen(1)
        os.kill(loop.recorder, signal.SIGKILL)
        killed.add(loop.recorder)
    output, complaints = loop.process.communicate(timeout=60)
    assert output.splitlines()[-1] == "closed 20000"
    assert complaints == ""
    recording = read_recording(path)
    assert_unbroken(recording, 20_000)
    assert recording.metadata["initial"] == {"seed": 1}
    assert not (tmp_path / "run.csv.part").exists()


def test_a_recorder_is_replaced_by_a_process_that_is_not_the_loops_child(tmp_path: Path) -> None:
    """The loop's process is copied for nobody while it ticks."""
    with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}) as recorder:
        first, keeper = recorder.pid, os.getpgid(recorder.pid)
        children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text()
        os.kill(first, signal.SIGKILL)
        while recorder.pid == first:
            os.sched_yield()
        fill(recorder, 0, 100)
        assert Path(f"/proc/{recorder.pid}/stat").read_text().rpartition(")")[2].split()[1] == str(keeper)
        assert Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text() == children
    np.testing.assert_array_equal(read_recording(tmp_path / "run.csv")["position_roll"], np.arange(100))


def test_a_recorder_records_on_when_the_process_that_would_replace_it_is_killed(tmp_path: Path) -> None:
    with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}) as recorder:
        fill(recorder, 0, 50)
        os.kill(os.getpgid(recorder.pid), signal.SIGKILL)
        fill(recorder, 50, 100)
    np.testing.assert_array_equal(read_recording(tmp_path / "run.csv")["position_roll"], np.arange(100))


@pytest.mark.slow
@pytest.mark.parametrize("first", ["loop", "recorder"])
@pytest.mark.parametrize("lines", [3, 88])
def test_when_both_are_killed_another_recorder_finishes_the_recording(tmp_path: Path, first: str, lines: int) -> None:
    path = tmp_path / "run.mf4"
    loop = Loop(path)
    loop.listen(lines)
    assert named_memory(loop.process.pid) == []
    keeper = ended(os.getpgid(loop.recorder))
    for pid in (loop.process.pid, loop.recorder) if first == "loop" else (loop.recorder, loop.process.pid):
        os.kill(pid, signal.SIGKILL)
    loop.process.wait()
    wait_for(keeper)
    recording = read_recording(path)
    assert_unbroken(recording, max(loop.kept, 64 * (lines - 1)))
    assert "without closing" in recording.metadata["ended"]["error"]
    assert loop.complaints() == ""


@pytest.mark.parametrize("lines", [3, 88])
def test_when_all_are_killed_the_journal_is_read(tmp_path: Path, lines: int) -> None:
    path = tmp_path / "run.mf4"
    loop = Loop(path)
    loop.listen(lines)
    assert named_memory(loop.process.pid) == []
    recorder = ended(loop.recorder)
    os.killpg(os.getpgid(loop.recorder), signal.SIGKILL)
    loop.kill()
    wait_for(recorder)
    if loop.kept:
        assert_unbroken(read_whatever_is_there(path), loop.kept)
    assert loop.complaints() == ""


def test_rows_reach_the_disk_well_within_the_second_that_may_be_lost(tmp_path: Path) -> None:
    took_s = []
    with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}) as recorder:
        for k in range(1, 6):  # a busy computer may delay some of them
            fill(recorder, 10 * (k - 1), 10 * k)
            put_s = time.monotonic()
            while rows_on_disk(tmp_path / "run.csv.part") < 10 * k:
                assert time.monotonic() - put_s < 10.0
                time.sleep(0.005)
            took_s.append(time.monotonic() - put_s)
    assert min(took_s) < 0.2


def rows_on_disk(part: Path) -> int:
    """Rows that could be read from the journal if all processes were killed now."""
    recovered, _ = answer_or_refusal(RecordingError, recover, part)
    return 0 if recovered is None else recovered.rows


def fill(recorder: RecorderProcess, first: int, last: int) -> None:
    for k in range(first, last):
        recorder.put(np.array([k / 256.0, float(k)]))


def stop(recorder: RecorderProcess) -> None:
    os.kill(recorder.pid, signal.SIGSTOP)
    while Path(f"/proc/{recorder.pid}/stat").read_text().rpartition(")")[2].split()[0] != "T":
        os.sched_yield()


def test_a_full_ring_loses_the_newest_rows_counts_them_and_never_waits(tmp_path: Path) -> None:
    with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}, capacity_rows=8) as recorder:
        stop(recorder)
        fill(recorder, 0, 20)
        assert recorder.rows_lost == 12
        os.kill(recorder.pid, signal.SIGCONT)
    recording = read_recording(tmp_path / "run.csv")
    np.testing.assert_array_equal(recording["position_roll"], np.arange(8))
    assert recording.metadata["rows_lost"] == 12


def test_a_recorder_killed_at_the_very_end_leaves_the_rest_to_the_loop(tmp_path: Path) -> None:
    with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}) as recorder:
        stop(recorder)
        fill(recorder, 0, 100)
        os.kill(recorder.pid, signal.SIGKILL)
    np.testing.assert_array_equal(read_recording(tmp_path / "run.csv")["position_roll"], np.arange(100))


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_signals_that_mean_the_loop_do_not_end_the_recorder(tmp_path: Path, name: str) -> None:
    with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}) as recorder:
        handle = ended(recorder.pid)
        os.kill(recorder.pid, getattr(signal, name))
        fill(recorder, 0, 100)
        while recorder.rows_kept < 100:
            assert not select.select([handle], [], [], 0.0)[0], "the recorder ended"
        os.close(handle)
    assert read_recording(tmp_path / "run.csv").rows == 100


def test_the_ring_wraps_without_mixing_rows(tmp_path: Path) -> None:
    with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}, capacity_rows=64) as recorder:
        for k in range(2000):
            while k - recorder.rows_kept >= 64:
                pass
            recorder.put(np.array([k / 256.0, float(k)]))
    np.testing.assert_array_equal(read_recording(tmp_path / "run.csv")["position_roll"], np.arange(2000))


def test_rows_a_recorder_finds_no_room_for_are_written_by_the_loop(tmp_path: Path) -> None:
    recorder = RecorderProcess(tmp_path / "run.csv", CHANNELS, {})
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (4096, 4096))
    fill(recorder, 0, 1000)
    assert recorder.close() == 1000
    np.testing.assert_array_equal(read_recording(tmp_path / "run.csv")["position_roll"], np.arange(1000))


def test_a_full_disk_is_one_line_at_the_end_and_what_fitted_is_read(tmp_path: Path) -> None:
    recorder = RecorderProcess(tmp_path / "run.csv", CHANNELS, {})
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (4096, 4096))
    fill(recorder, 0, 100)
    while recorder.rows_kept < 100:
        pass
    fill(recorder, 100, 1000)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(RecordingError, match=r"^[^\n]*cannot be written: File too large; the \d+ rows before are kept$"):
            recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    recording = read_whatever_is_there(tmp_path / "run.csv")
    np.testing.assert_array_equal(recording["position_roll"], np.arange(recording.rows))
    assert recording.rows >= 100


def put_until(recorder: RecorderProcess, done: Callable[[], bool], first: int = 0) -> int:
    """Rows at 256 Hz until something has happened; returns their number."""
    pause, number = threading.Event(), first
    while not done():
        fill(recorder, number, number + 1)
        number += 1
        pause.wait(1 / 256)
    return number


def test_a_disk_that_fills_is_told_while_the_run_goes_on_and_no_row_is_lost(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    told: list[str] = []

    def said() -> bool:
        told.append(capfd.readouterr().err)
        return bool(told[-1])

    with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}) as recorder:
        unlimited = resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
        rows = put_until(recorder, said)
        rows = put_until(recorder, lambda: recorder.rows > rows + 300, rows)  # a second on: it is not said again
        resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, unlimited)
        put_until(recorder, lambda: recorder.rows_kept > rows, rows)
        told.append(capfd.readouterr().err)
    (line,) = "".join(told).splitlines()
    assert line.startswith(f"isocenter: {tmp_path}/run.csv.part: cannot be written: File too large; the ")
    assert line.endswith("rows wait in memory for room, later ones are lost: free some")
    recording = read_recording(tmp_path / "run.csv")
    np.testing.assert_array_equal(recording["position_roll"], np.arange(recording.rows))


def test_a_recorder_that_stands_still_ends_the_run_within_a_second_and_every_row_is_kept(tmp_path: Path) -> None:
    recorder = RecorderProcess(tmp_path / "run.csv", CHANNELS, {})
    first = put_until(recorder, lambda: recorder.rows_kept > 10)
    stop(recorder)
    stopped_s = time.monotonic()
    with pytest.raises(LoopAbortedError, match=rf"the recorder \(process {recorder.pid}\) has stood still for .* rows are kept$"):
        put_until(recorder, lambda: False, first)
    assert time.monotonic() - stopped_s < 1.5  # a second, and what a loaded computer adds
    rows = recorder.rows
    assert recorder.close() == rows
    assert time.monotonic() - stopped_s < 10.0
    np.testing.assert_array_equal(read_recording(tmp_path / "run.csv")["position_roll"], np.arange(rows))


def test_a_recorder_that_stands_still_is_told_once_where_the_run_is_to_go_on(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    noticed: list[str] = []
    with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}, on_stall=noticed.append) as recorder:
        rows = put_until(recorder, lambda: recorder.rows_kept > 10)
        pid = recorder.pid
        stop(recorder)
        rows = put_until(recorder, lambda: bool(noticed), rows)
        rows = put_until(recorder, lambda: recorder.rows > rows + 300, rows)
        os.kill(pid, signal.SIGCONT)
        put_until(recorder, lambda: recorder.rows_kept > rows, rows)
    (said,) = noticed
    assert said.startswith(f"{tmp_path / 'run.csv'}: the recorder (process {pid}) has stood still for ")
    assert capfd.readouterr().err == f"isocenter: {said}; the run goes on, 32768 rows wait in memory, later ones are lost\n"
    recording = read_recording(tmp_path / "run.csv")
    np.testing.assert_array_equal(recording["position_roll"], np.arange(recording.rows))


def test_a_folder_that_is_not_there_is_one_line_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"run\.csv\.part: cannot be written: No such file or directory"):
        RecorderProcess(tmp_path / "absent" / "run.csv", CHANNELS, {})


def test_a_failed_run_is_kept_with_its_reason(tmp_path: Path) -> None:
    def failing_loop() -> None:
        with RecorderProcess(tmp_path / "run.csv", CHANNELS, {}) as recorder:
            fill(recorder, 0, 10)
            raise ValueError("a limit tripped")

    with pytest.raises(ValueError, match="limit"):
        failing_loop()
    recording = read_recording(tmp_path / "run.csv")
    assert recording.rows == 10
    assert recording.metadata["ended"] == {"error": "a limit tripped"}


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(capacity=st.integers(1, 9), steps=st.lists(st.tuples(st.integers(0, 12), st.integers(1, 12)), max_size=20))
def test_what_is_taken_from_a_ring_is_what_was_put_in_order(capacity: int, steps: list[tuple[int, int]]) -> None:
    ring = Ring(1, capacity)
    put = taken = 0
    for wanted, limit in steps:
        for _ in range(min(wanted, capacity - (put - taken))):
            ring.rows[put % capacity] = put
            put += 1
        ring.counters[0] = put
        rows = ring.take(taken, limit)
        np.testing.assert_array_equal(rows[:, 0], np.arange(taken, taken + len(rows)))
        assert len(rows) > 0 or taken == put
        taken += len(rows)
    ring.close()
