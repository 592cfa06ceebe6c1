"""The crash-safe row file: whatever is cut off or damaged, the rows before it are read, and none is invented."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.errors import RecordingError
from hil.recording import JournalSink, Recording, RecordingWarning, read_recording
from hil.recording.journal import Journal, recover

CHANNELS = [("time", "s"), ("position_roll", "rad"), ("statusword_roll", "")]
METADATA = {"machine": {"name": "carm", "hash": "ab", "axes": ["roll"], "text": "ä"}, "experiment": {"seed": 1}}
FILES = settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def rows(first: int, last: int) -> np.ndarray:
    index = np.arange(first, last, dtype=float)
    return np.column_stack([index / 256.0, np.sin(index), np.where(index % 5 == 0, np.nan, 39.0)])


def journal_of(path: Path, blocks: list[tuple[int, int]]) -> bytes:
    with Journal.create(path, CHANNELS, METADATA) as journal:
        for first, last in blocks:
            journal.append(rows(first, last))
    return path.read_bytes()


def assert_rows(recording: Recording, count: int) -> None:
    for column, (name, unit) in enumerate(CHANNELS):
        assert recording.channels[name].unit == unit
        np.testing.assert_array_equal(recording[name], rows(0, count)[:, column])


def test_everything_appended_is_recovered_with_its_metadata(tmp_path: Path) -> None:
    journal_of(tmp_path / "run.mf4.part", [(0, 3), (3, 10)])
    recording = recover(tmp_path / "run.mf4.part")
    assert_rows(recording, 10)
    assert recording.metadata == {**METADATA, "recovered": {"rows": 10, "unread_bytes": 0}}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, dict[int, int]]:
    """A journal of blocks of 3, 4 and 5 rows, its content and the size after each block."""
    path = tmp_path_factory.mktemp("journal") / "run.mf4.part"
    sizes = [len(journal_of(path.with_name(f"{n}.part"), [(0, 3), (3, 7), (7, 12)][:n])) for n in range(4)]
    return path.with_name("3.part").read_bytes(), dict(zip(sizes, (0, 3, 7, 12), strict=True))


def complete_rows(sizes: dict[int, int], length: int) -> int:
    return max(count for size, count in sizes.items() if size <= length) if length >= min(sizes) else 0


@FILES
@given(data=st.data())
def test_a_torn_journal_yields_exactly_its_complete_blocks(
    tmp_path: Path, whole: tuple[bytes, dict[int, int]], data: st.DataObject
) -> None:
    content, sizes = whole
    length = data.draw(st.integers(0, len(content)))
    part = tmp_path / "run.csv.part"
    part.write_bytes(content[:length])
    count = complete_rows(sizes, length)
    if count:
        assert_rows(recover(part), count)
    else:
        with pytest.raises(RecordingError, match=r"^[^\n]*(no journal of a recording|header is damaged|no complete row)$"):
            recover(part)


@FILES
@given(data=st.data())
def test_a_flipped_bit_costs_its_block_and_what_follows_never_a_wrong_number(
    tmp_path: Path, whole: tuple[bytes, dict[int, int]], data: st.DataObject
) -> None:
    content, sizes = whole
    place, bit = data.draw(st.integers(0, len(content) - 1)), data.draw(st.integers(0, 7))
    damaged = bytearray(content)
    damaged[place] ^= 1 << bit
    part = tmp_path / "run.csv.part"
    part.write_bytes(damaged)
    count = complete_rows(sizes, place)
    if count:
        assert_rows(recover(part), count)
    else:
        with pytest.raises(RecordingError, match=r"^[^\n]*$"):
            recover(part)


@FILES
@given(data=st.data())
def test_a_recorder_that_takes_over_goes_on_behind_the_last_complete_row(
    tmp_path: Path, whole: tuple[bytes, dict[int, int]], data: st.DataObject
) -> None:
    content, sizes = whole
    part = tmp_path / "run.csv.part"
    part.write_bytes(content[: data.draw(st.integers(min(sizes), len(content)))])
    with Journal.resume(part) as journal:
        journal.append(rows(journal.rows, 20))
    assert_rows(recover(part), 20)


def test_a_journal_left_without_rows_makes_way(tmp_path: Path) -> None:
    Journal.create(tmp_path / "run.csv.part", CHANNELS, METADATA).close()
    with JournalSink(tmp_path / "run.csv", CHANNELS, METADATA) as sink:
        sink.put(rows(0, 1)[0])
    assert_rows(read_recording(tmp_path / "run.csv"), 1)


def test_two_runs_cannot_record_into_one_file(tmp_path: Path) -> None:
    with JournalSink(tmp_path / "run.csv", CHANNELS, METADATA) as first:
        first.put(rows(0, 1)[0])
        with pytest.raises(RecordingError, match="is being recorded by another process; choose another name"):
            JournalSink(tmp_path / "run.csv", CHANNELS, METADATA)
    assert_rows(read_recording(tmp_path / "run.csv"), 1)


def test_an_unfinished_recording_is_not_overwritten(tmp_path: Path) -> None:
    journal_of(tmp_path / "run.mf4.part", [(0, 3)])
    with pytest.raises(RecordingError, match=r"3 rows of a recording .*`isocenter convert run\.mf4 OTHER\.mf4`"):
        JournalSink(tmp_path / "run.mf4", CHANNELS, METADATA)
    assert_rows(recover(tmp_path / "run.mf4.part"), 3)


def test_reading_a_recording_that_was_never_closed_says_so(tmp_path: Path) -> None:
    journal_of(tmp_path / "run.mf4.part", [(0, 4)])
    with pytest.warns(RecordingWarning, match=r"was not closed; 4 rows read from run\.mf4\.part"):
        recording = read_recording(tmp_path / "run.mf4")
    assert_rows(recording, 4)
    assert recording.metadata["recovered"]["rows"] == 4


@pytest.fixture
def small_disk() -> Iterator[None]:
    """Lets no file grow beyond 4096 bytes, as a full disk would."""
    resource = pytest.importorskip("resource", reason="file sizes are limited with POSIX's resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.usefixtures("small_disk")
def test_a_full_disk_is_one_line_and_costs_only_what_no_longer_fits(tmp_path: Path) -> None:
    with Journal.create(tmp_path / "run.mf4.part", CHANNELS, METADATA) as journal:
        journal.append(rows(0, 100))
        with pytest.raises(RecordingError, match=r"run\.mf4\.part: cannot be written: File too large; the 100 rows before are kept$"):
            journal.append(rows(100, 300))
        assert_rows(recover(journal.path), 100)
        journal.append(rows(100, 110))
        assert_rows(recover(journal.path), 110)


@pytest.mark.parametrize("suffix", [".mf4", ".csv"])
def test_a_closed_sink_leaves_the_recording_and_nothing_else(tmp_path: Path, suffix: str) -> None:
    sink = JournalSink(tmp_path / f"run{suffix}", CHANNELS, METADATA)
    for row in rows(0, 1500):
        sink.put(row)
    assert sink.close({"initial": {"seed": 5}}) == 1500
    assert {path.name for path in tmp_path.iterdir()} == {f"run{suffix}"} | ({"run.toml"} if suffix == ".csv" else set())
    recording = read_recording(tmp_path / f"run{suffix}")
    assert_rows(recording, 1500)
    assert recording.metadata == {**METADATA, "initial": {"seed": 5}}


def test_a_sink_keeps_the_row_it_was_given_not_what_the_caller_makes_of_it(tmp_path: Path) -> None:
    row = rows(0, 1)[0]
    with JournalSink(tmp_path / "run.csv", CHANNELS, {}) as sink:
        sink.put(row)
        row[:] = 7.0
    assert_rows(read_recording(tmp_path / "run.csv"), 1)


@pytest.mark.parametrize("rate_Hz", [10.0, 256.0, 1000.0])
def test_at_any_rate_less_than_a_second_is_in_memory_only(tmp_path: Path, rate_Hz: float) -> None:
    sink = JournalSink(tmp_path / "run.mf4", CHANNELS, METADATA)
    for k in range(int(5 * rate_Hz)):
        sink.put(np.array([k / rate_Hz, 0.0, 0.0]))
    assert recover(tmp_path / "run.mf4.part").time[-1] > 5.0 - 1.0


def test_a_run_that_fails_is_kept_with_its_reason(tmp_path: Path) -> None:
    def failing_loop() -> None:
        with JournalSink(tmp_path / "run.csv", CHANNELS, METADATA) as sink:
            sink.put(rows(0, 1)[0])
            raise ZeroDivisionError("the loop broke")

    with pytest.raises(ZeroDivisionError):
        failing_loop()
    assert read_recording(tmp_path / "run.csv").metadata["ended"] == {"error": "the loop broke"}


def test_a_run_without_rows_leaves_no_file(tmp_path: Path) -> None:
    assert JournalSink(tmp_path / "run.mf4", CHANNELS, METADATA).close() == 0
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_cannot_be_finished_keeps_its_journal(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("a = 1\n")
    sink = JournalSink(tmp_path / "run.csv", CHANNELS, METADATA)
    for row in rows(0, 9):
        sink.put(row)
    with pytest.raises(RecordingError, match=r"its 9 rows are kept in run\.csv\.part$"):
        sink.close()
    assert_rows(recover(tmp_path / "run.csv.part"), 9)


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ([("time", "s"), ("x", ""), ("x", "")], "stands twice"),
        ([("position_roll", "rad")], "no channel `time"),
        ([("time", "s"), ("position_roll", "ell")], "unknown unit"),
    ],
)
def test_columns_that_could_not_be_read_back_are_refused_before_the_run(
    tmp_path: Path, channels: list[tuple[str, str]], message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        JournalSink(tmp_path / "run.mf4", channels, METADATA)
    assert list(tmp_path.iterdir()) == []
