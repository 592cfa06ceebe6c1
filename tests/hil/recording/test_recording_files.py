"""Recordings through files and back: nothing is lost, nothing is invented, and damage is one clear line."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from asammdf import MDF
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import answer_or_refusal

from hil.errors import RecordingError
from hil.files.toml_text import plain, toml_text
from hil.recording import Channel, Recording, convert, read_recording, write_recording

FILES = settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

text = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
scalars = st.one_of(st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False), text)
tables = st.recursive(
    st.dictionaries(text, scalars, max_size=4),
    lambda inner: st.dictionaries(text, st.one_of(scalars, inner, st.lists(st.one_of(scalars, inner), max_size=3)), max_size=4),
    max_leaves=8,
)
values = st.one_of(st.floats(allow_nan=False, width=64), st.just(float("nan")))
counts = st.one_of(st.integers(-(2**31), 2**40).map(float), st.just(float("nan")))
KINDS = {"position_roll": ("rad", values), "effort_x": ("N", values), "estimate_ϑ": ("µm", values), "statusword_roll": ("", counts)}


@st.composite
def recordings(draw: Callable[..., object]) -> Recording:
    steps = draw(st.lists(st.floats(1e-6, 1e3), min_size=1, max_size=12))
    rows = len(steps)
    channels = {"time": Channel("s", np.cumsum(steps))}
    for name in draw(st.permutations(list(KINDS)))[: draw(st.integers(1, 4))]:
        unit, samples = KINDS[name]
        channels[name] = Channel(unit, draw(st.lists(samples, min_size=rows, max_size=rows)))
    return Recording(channels, {"note": draw(tables), "machine": {"name": draw(text), "hash": "h", "text": draw(text), "axes": ["roll"]}})


def assert_same(found: Recording, wanted: Recording) -> None:
    assert list(found.channels) == list(wanted.channels)
    for name, channel in wanted.channels.items():
        assert found.channels[name].unit == channel.unit
        np.testing.assert_array_equal(found[name], channel.values)
        present = ~np.isnan(channel.values)
        if not name.startswith("statusword"):  # a whole number has no signed zero
            np.testing.assert_array_equal(np.signbit(found[name][present]), np.signbit(channel.values[present]))
    assert found.metadata == wanted.metadata


@FILES
@given(recordings(), st.sampled_from([".mf4", ".csv"]))
def test_what_is_written_reads_back_bit_for_bit(tmp_path: Path, recording: Recording, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    write_recording(recording, path)
    assert_same(read_recording(path), recording)
    path.unlink()


@pytest.mark.parametrize("suffix", [".mf4", ".csv", ".parquet"])
def test_a_row_that_jumps_off_the_raster_stays_in_a_recording_of_ours(tmp_path: Path, suffix: str) -> None:
    """In another's log such a row is a second sender's; a faulty encoder's is what was recorded."""
    time_s, position = np.array([1.0, 2.0, 4.0, 6.0, 7.0, 8.0, 10.0]), np.array([np.nan, 1.0, np.nan, 0.0, 21.0, 0.0, np.nan])
    recording = replace(example(), channels={"time": Channel("s", time_s), "position_roll": Channel("rad", position)})
    write_recording(recording, tmp_path / f"run{suffix}")
    assert_same(read_recording(tmp_path / f"run{suffix}"), recording)


@settings(max_examples=examples(200), deadline=None)
@given(tables)
def test_toml_text_reads_back_equal(table: dict[str, object]) -> None:
    assert tomllib.loads(toml_text(table)) == plain(table)


def example(rows: int = 6) -> Recording:
    position = np.linspace(0.0, 1.0, rows)
    position[2] = np.nan
    status = np.full(rows, 0x1237, dtype=float)
    status[3] = np.nan
    channels = {
        "time": Channel("s", np.arange(rows) / 256.0),
        "position_roll": Channel("rad", position),
        "statusword_roll": Channel("", status),
        "imu_x": Channel("m/s^2", np.full(rows, 9.81)),
    }
    machine = {"name": "carm", "hash": "0f", "axes": ["roll"], "text": 'name = "carm"\n# Prüfstand\n' * 9}
    return Recording(channels, {"machine": machine, "experiment": {"seed": 3}})


def test_asammdf_sees_ordinary_signals_with_units_and_invalid_samples(tmp_path: Path) -> None:
    write_recording(example(), tmp_path / "run.mf4")
    with MDF(tmp_path / "run.mf4") as mdf:
        position = mdf.get("position_roll", ignore_invalidation_bits=True)
        assert (position.unit, mdf.get("imu_x").unit) == ("rad", "m/s^2")
        np.testing.assert_array_equal(position.invalidation_bits, [False, False, True, False, False, False])
        np.testing.assert_array_equal(mdf.get("position_roll").timestamps, np.delete(np.arange(6), 2) / 256.0)
        status = mdf.get("statusword_roll")
        assert status.samples.dtype.kind == "i"
        np.testing.assert_array_equal(status.samples, [0x1237] * 5)
        assert [attachment.file_name for attachment in mdf.attachments] == ["recording.toml"]


@pytest.mark.parametrize("suffix", [".mf4", ".csv"])
def test_the_same_recording_is_the_same_file(tmp_path: Path, suffix: str) -> None:
    write_recording(example(), tmp_path / f"a{suffix}")
    write_recording(example(), tmp_path / f"b{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_the_start_of_a_recording_is_the_start_in_asammdf(tmp_path: Path) -> None:
    write_recording(example().with_metadata(started="2025-06-30T12:00:00+02:00"), tmp_path / "run.mf4")
    with MDF(tmp_path / "run.mf4") as mdf:
        assert mdf.header.start_time.isoformat() == "2025-06-30T12:00:00+02:00"
    with pytest.raises(RecordingError, match="a time with its zone would be right"):
        write_recording(example().with_metadata(started="yesterday"), tmp_path / "run.mf4")


@pytest.mark.parametrize("name", ["run.mf4", "run.csv"])
def test_a_file_that_cannot_be_written_whole_leaves_the_old_one(tmp_path: Path, name: str) -> None:
    resource = pytest.importorskip("resource", reason="file sizes are limited with POSIX's resource")
    write_recording(example(), tmp_path / name)
    rows = 2000
    longer = Recording({"time": Channel("s", np.arange(rows) + 0.0), "x": Channel("", np.random.default_rng(1).normal(size=rows))}, {})
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(RecordingError, match=rf"{name}: cannot be written: File too large"):
            write_recording(longer, tmp_path / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not [entry.name for entry in tmp_path.iterdir() if entry.name.endswith(".tmp")]
    assert_same(read_recording(tmp_path / name), example())


def test_numpy_alone_reads_the_csv(tmp_path: Path) -> None:
    write_recording(example(), tmp_path / "run.csv")
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True, deletechars="", replace_space=" ")
    np.testing.assert_array_equal(table["position_roll [rad]"], example()["position_roll"])
    assert (tmp_path / "run.csv").read_text().splitlines()[3].split(",")[1] == ""


class Machine:
    """As much of a machine as reading a recording without metadata asks for."""

    name, text, hash, axes = "carm", 'name = "carm"', "ab", ("roll",)

    def axis_of_channel(self, name: str) -> str | None:
        """It knows no channels."""


def test_a_csv_without_metadata_needs_the_machine(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time [s],position_roll [deg]\n0,1\n0.5,\n")
    with pytest.raises(RecordingError, match="--machine"):
        read_recording(path)
    recording = read_recording(path, Machine())
    assert recording.machine_hash == "ab"
    np.testing.assert_allclose(recording["position_roll"], [np.pi / 180.0, np.nan])


def test_an_mf4_of_another_tool_needs_the_machine_and_is_read_with_it(tmp_path: Path) -> None:
    write_recording(example(), tmp_path / "run.mf4")
    with MDF(tmp_path / "run.mf4") as mdf, mdf.cut(start=1 / 256, stop=4 / 256) as cut:
        cut.save(tmp_path / "cut.mf4")
    with pytest.raises(RecordingError, match="--machine"):
        read_recording(tmp_path / "cut.mf4")
    part = read_recording(tmp_path / "cut.mf4", Machine())
    np.testing.assert_array_equal(part["position_roll"], example()["position_roll"][1:5])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("time [s],x\n0,1\n0.5\n", "line 3: 1 cells, the header has 2"),
        ("time [s],x\n0,1\n,2\n", "line 3: time is missing"),
        ("time [s],x\n\n0,1\n0,2\n", "lines 3 and 4 have the same stamp and other values"),
        ("time [s],x\n0,1\n1,zwei\n", "line 3: x = 'zwei' is no number"),
        ("time [s],position_roll [ell]\n0,1\n", r"line 1: channel position_roll: unknown unit \[ell\]"),
        ("time [s],x,x\n0,1,2\n", "line 1: channel x stands there twice"),
        ("t [s],x\n0,1\n", "line 1: no column `time"),
        ("time [s];x\n0;1,5\n1;1.5\n", "line 3: decimal commas and points"),
        ("time [s];x\n0;1.23,5\n", r"line 2: x = '1\.23,5' is no number"),
        ("time [s];x\n0;1,5\n1;1,234.5\n", "line 3: decimal commas and points"),
        ("time [s];x\n0;1,5\n1;1,234,567\n", "line 3: commas mark decimals and thousands"),
        ("time [s];x\n0,0;1;2\n", "line 2: 3 cells, the header has 2"),
        ("time [s],x\n", "line 1: a header and no rows"),
        ("", "line 1: empty"),
        ('time [s],"x\n0,1\n', "line 2: unexpected end of data"),
    ],
)
def test_a_csv_with_a_fault_is_refused_by_its_line(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text(content)
    with pytest.raises(RecordingError, match=message) as refusal:
        read_recording(path, Machine())
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("rows_kept", [2, 5])
def test_a_csv_that_was_cut_off_between_rows_is_noticed(tmp_path: Path, rows_kept: int) -> None:
    write_recording(example(), tmp_path / "run.csv")
    lines = (tmp_path / "run.csv").read_text().splitlines(keepends=True)
    (tmp_path / "run.csv").write_text("".join(lines[: rows_kept + 1]))
    with pytest.raises(RecordingError, match=f"{rows_kept} rows, but run.toml says rows = 6"):
        read_recording(tmp_path / "run.csv")


def test_a_machine_file_of_the_same_name_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "carm.toml").write_text('name = "carm"\n')
    with pytest.raises(RecordingError, match="choose another name"):
        write_recording(example(), tmp_path / "carm.csv")
    assert (tmp_path / "carm.toml").read_text() == 'name = "carm"\n'
    assert not (tmp_path / "carm.csv").exists()


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("written") / "run.mf4"
    write_recording(example(), path)
    return path.read_bytes()


@pytest.mark.slow
@settings(FILES, max_examples=examples(30))
@given(cut=st.integers(1, 2400))
def test_a_truncated_mf4_is_refused_or_whole(tmp_path: Path, written: bytes, cut: int) -> None:
    read_or_refused(tmp_path / "cut.mf4", written[: max(len(written) - cut, 0)])


@FILES
@given(place=st.integers(0, 10_000), bit=st.integers(0, 7))
def test_a_flipped_bit_anywhere_in_an_mf4_is_refused_or_harmless(tmp_path: Path, written: bytes, place: int, bit: int) -> None:
    content = bytearray(written)
    content[place % len(content)] ^= 1 << bit
    read_or_refused(tmp_path / "flipped.mf4", bytes(content))


def test_a_file_that_is_no_mf4_is_refused_by_what_it_is_not(tmp_path: Path) -> None:
    (tmp_path / "run.mf4").write_bytes(b"something else altogether")
    with pytest.raises(RecordingError, match=r"run\.mf4: no MDF file, or damaged: it is not a valid"):
        read_recording(tmp_path / "run.mf4")


def read_or_refused(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    found, refusal = answer_or_refusal(RecordingError, read_recording, path)
    if found is None:
        assert refusal.startswith(str(path))
        assert "\n" not in refusal
        assert "BytesIO" not in refusal
    else:
        assert_same(found, example())


@FILES
@given(place=st.integers(0, 10_000), byte=st.integers(0, 255), keep=st.integers(0, 10_000))
def test_a_damaged_csv_is_read_or_refused_in_one_line(tmp_path: Path, place: int, byte: int, keep: int) -> None:
    write_recording(example(), tmp_path / "run.csv")
    content = bytearray((tmp_path / "run.csv").read_bytes())
    content[place % len(content)] = byte
    (tmp_path / "run.csv").write_bytes(content[: keep + 1])
    _, refusal = answer_or_refusal(RecordingError, read_recording, tmp_path / "run.csv")
    assert refusal is None or "\n" not in refusal


@FILES
@given(place=st.integers(0, 10_000), byte=st.integers(0, 255))
def test_damaged_metadata_are_read_or_refused_in_one_line(tmp_path: Path, place: int, byte: int) -> None:
    write_recording(example(), tmp_path / "run.csv")
    content = bytearray((tmp_path / "run.toml").read_bytes())
    content[place % len(content)] = byte
    (tmp_path / "run.toml").write_bytes(content)
    _, refusal = answer_or_refusal(RecordingError, read_recording, tmp_path / "run.csv")
    assert refusal is None or "\n" not in refusal
    (tmp_path / "run.toml").unlink()


def test_convert_goes_both_ways_without_loss(tmp_path: Path) -> None:
    write_recording(example(), tmp_path / "a.csv")
    convert(tmp_path / "a.csv", tmp_path / "b.mf4")
    convert(tmp_path / "b.mf4", tmp_path / "c.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "c.csv").read_bytes()
    assert (tmp_path / "a.toml").read_bytes() == (tmp_path / "c.toml").read_bytes()


@pytest.mark.parametrize("target", ["b.mat", "b.log", "b"])
def test_a_format_that_cannot_be_written_is_refused_before_reading(tmp_path: Path, target: str) -> None:
    with pytest.raises(RecordingError, match=r"cannot be written as .*\.mf4, \.csv, \.parquet, \.mcap can"):
        convert(tmp_path / "absent.csv", tmp_path / target)


@pytest.mark.parametrize("name", ["absent.mf4", "absent.csv", "absent.mat", "absent.log", "absent.blf"])
def test_a_missing_file_is_one_line(tmp_path: Path, name: str) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(tmp_path / name)


@pytest.mark.parametrize("name", ["run.mf4", "run.csv"])
def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path, name: str) -> None:
    with pytest.raises(RecordingError, match=r"cannot be written: No such file or directory"):
        write_recording(example(), tmp_path / "absent" / name)
