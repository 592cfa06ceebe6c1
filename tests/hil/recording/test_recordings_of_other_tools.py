"""MDF4 of several rasters, Parquet, MCAP and CSV as other tools write them, and the names that channels get."""

from __future__ import annotations

import json
import warnings
from datetime import timedelta
from pathlib import Path

import jsonschema
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from asammdf import MDF, Signal
from asammdf.blocks.conversion_utils import from_dict
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from refusals import answer_or_refusal

from hil import extras
from hil.errors import RecordingError, UnusableInputError
from hil.machine import Machine, load_machine
from hil.recording import Channel, Recording, RecordingWarning, read_recording, write_recording
from hil.recording.naming import Target, read_names

RATE_Hz = 256.0
FILES = settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
DEG = np.pi / 180.0


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def quietly(path: Path, machine: Machine, names: dict[str, str | Target] | None = None) -> tuple[Recording, dict[str, list[str]]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        recording = read_recording(path, machine, names)
    return recording, recording.metadata.get("source", {})


# ---- MDF4 of several rasters -----------------------------------------------------------------------------------------------------


def mf4(path: Path, *rasters: list[Signal]) -> Path:
    with MDF() as mdf:
        for signals in rasters:
            mdf.append(signals, common_timebase=True)
        mdf.save(path, overwrite=True)
    return path


def test_slower_signals_come_onto_the_machines_rows_interpolated_and_that_is_said(carm: Machine, tmp_path: Path) -> None:
    fast, slow = np.arange(512) / RATE_Hz, 3e-4 + np.arange(200) / 100.0
    path = mf4(
        tmp_path / "two.mf4",
        [
            Signal(np.sin(slow), slow, unit="rad", name="position_roll"),
            Signal(np.arange(200, dtype=np.uint16), slow, name="statusword_roll"),
        ],
        [Signal(np.cos(fast), fast, unit="A", name="current_roll")],
    )
    with pytest.warns(RecordingWarning, match=r"position_roll, statusword_roll \(100 Hz\) put onto the rows of current_roll \(256 Hz\)"):
        recording = read_recording(path, carm)
    np.testing.assert_array_equal(recording.time, fast)
    np.testing.assert_array_equal(recording["current_roll"], np.cos(fast))
    inside = (fast >= slow[0]) & (fast <= slow[-1])
    assert np.isnan(recording["position_roll"][~inside]).all()
    np.testing.assert_allclose(recording["position_roll"][inside], np.interp(fast[inside], slow, np.sin(slow)), atol=1e-12)
    held = np.floor((fast - slow[0]) * 100.0 + 1e-9)
    np.testing.assert_array_equal(recording["statusword_roll"][inside], held[inside])


def test_faster_signals_come_onto_the_machines_rows_too(carm: Machine, tmp_path: Path) -> None:
    rows, fast = np.arange(256) / RATE_Hz, np.arange(1000) / 1000.0
    path = mf4(
        tmp_path / "two.mf4",
        [Signal(fast**2, fast, unit="A", name="current_roll")],
        [Signal(rows, rows, unit="rad", name="position_roll")],
    )
    recording, _ = quietly(path, carm)
    np.testing.assert_array_equal(recording.time, rows)
    np.testing.assert_allclose(recording["current_roll"], np.interp(rows, fast, fast**2), atol=1e-12)


def test_where_a_signal_lost_samples_nothing_is_invented(carm: Machine, tmp_path: Path) -> None:
    rows = np.arange(256) / RATE_Hz
    slow = np.delete(np.arange(100) / 100.0, slice(40, 60))
    path = mf4(
        tmp_path / "two.mf4", [Signal(rows, rows, unit="A", name="current_roll")], [Signal(slow, slow, unit="rad", name="position_roll")]
    )
    recording, _ = quietly(path, carm)
    lost = (rows > 0.39) & (rows < 0.60)
    assert np.isnan(recording["position_roll"][lost]).all()
    np.testing.assert_allclose(recording["position_roll"][~lost & (rows <= 0.99)], rows[~lost & (rows <= 0.99)], atol=1e-12)


def test_without_a_raster_of_the_machines_rate_the_rows_are_those_of_most_samples(carm: Machine, tmp_path: Path) -> None:
    thousand, ten = np.arange(1000) / 1000.0, np.arange(10) / 10.0
    burst = np.array([0.5, 0.500001])
    path = mf4(
        tmp_path / "three.mf4",
        [Signal(burst, burst, unit="rad", name="position_propeller")],
        [Signal(ten, ten, unit="rad", name="position_roll")],
        [Signal(thousand, thousand, unit="A", name="current_roll")],
    )
    assert read_recording_rows(path, carm) == 1000


def read_recording_rows(path: Path, machine: Machine) -> int:
    return quietly(path, machine)[0].rows


@pytest.mark.parametrize("suffix", [".mdf", ".dat", ".mf4"])
def test_mdf_3_is_read_as_mdf_4_is(carm: Machine, tmp_path: Path, suffix: str) -> None:
    rows = np.arange(256) / RATE_Hz
    with MDF(version="3.30") as mdf:
        mdf.append([Signal(rows**2, rows, unit="A", name="current_roll")])
        mdf.append([Signal(np.degrees(rows), rows, unit="deg", name="position_roll")])
        mdf.save(tmp_path / "old.mdf")
    recording, _ = quietly((tmp_path / "old.mdf").rename(tmp_path / f"log{suffix}"), carm)
    np.testing.assert_array_equal(recording["current_roll"], rows**2)
    np.testing.assert_allclose(recording["position_roll"], rows, atol=1e-12)


def test_a_name_in_two_groups_is_refused_with_the_names_that_tell_them_apart(carm: Machine, tmp_path: Path) -> None:
    rows = np.arange(256) / RATE_Hz
    path = mf4(
        tmp_path / "twice.mf4",
        [Signal(rows, rows, unit="deg", name="angle")],
        [Signal(2 * rows, rows, unit="deg", name="angle"), Signal(rows, rows, unit="knot", name="speed_roll")],
    )
    for names in (None, {"angle": "position_roll"}):
        with pytest.raises(RecordingError, match="angle@0; angle@1"):
            read_recording(path, carm, names)
    recording, source = quietly(path, carm, {"angle@1": "position_roll"})
    np.testing.assert_allclose(recording["position_roll"], 2 * rows * DEG)
    assert source["names"] == {"angle@1": "position_roll"}
    assert "angle@0" in recording
    assert source["not_taken"] == [
        "speed_roll: channel speed_roll: unknown unit [knot]; [rad/s] or [deg/s] or [mrad/s] or [rev/s] or [rpm] would be right;"
        ' a file of names takes any other with its scale: "NAME" = { channel = "speed_roll", unit = "...", scale = ... } (--map FILE)'
    ]


def test_texts_and_arrays_of_an_mf4_are_listed(carm: Machine, tmp_path: Path) -> None:
    rows = np.arange(4) / RATE_Hz
    path = mf4(
        tmp_path / "text.mf4",
        [
            Signal(rows, rows, unit="rad", name="position_roll"),
            Signal(np.array([b"a", b"b", b"c", b"d"]), rows, name="mode", encoding="utf-8"),
        ],
    )
    with pytest.warns(RecordingWarning, match="not taken: mode: text or an array"):
        read_recording(path, carm)


# ---- Parquet and MCAP ------------------------------------------------------------------------------------------------------------


def test_readings_that_a_conversion_table_makes_texts_are_missing_and_said(carm: Machine, tmp_path: Path) -> None:
    counts = np.array([0, 10, 32767, 30, 32767, 50, -32768, 70], dtype=np.int16)
    table = from_dict(
        {
            "lower_0": -1000, "upper_0": 1000, "text_0": {"a": 0.1, "b": 0.0},
            "lower_1": 32767, "upper_1": 32767, "text_1": b"no signal",
            "lower_2": -32768, "upper_2": -32768, "text_2": b"fault",
        }
    )  # fmt: skip
    signal = Signal(counts, np.arange(8) / 256.0, unit="deg", name="position_roll", conversion=table)
    path = mf4(tmp_path / "log.mf4", [signal])
    with pytest.warns(
        RecordingWarning, match=r"position_roll: 3 of 8 readings are texts .*: 'no signal' \(2\), 'fault' \(1\), first sample 2"
    ):
        recording = read_recording(path, carm)
    expected = [0.0, 1.0, np.nan, 3.0, np.nan, 5.0, np.nan, 7.0]
    np.testing.assert_allclose(np.degrees(recording["position_roll"]), expected)


@pytest.fixture
def recording() -> Recording:
    rng = np.random.default_rng(11)
    current = rng.normal(size=50)
    current[7] = np.nan
    status = np.full(50, 39.0)
    status[3] = np.nan
    return Recording(
        {
            "time": Channel("s", np.arange(50) / RATE_Hz),
            "current_roll": Channel("A", current),
            "statusword_roll": Channel("", status),
            "estimate_x": Channel("mm/s^3", rng.normal(size=50)),
        },
        {
            "machine": {"name": "carm", "axes": ["roll"], "text": "a = 1\n", "hash": "0"},
            "experiment": {"seed": 3},
            "started": "2025-06-30T12:00:00+00:00",
        },
    )


@pytest.mark.parametrize("suffix", [".parquet", ".mcap"])
def test_a_recording_comes_back_bit_for_bit_with_units_holes_and_metadata(tmp_path: Path, recording: Recording, suffix: str) -> None:
    write_recording(recording, tmp_path / f"run{suffix}")
    again = read_recording(tmp_path / f"run{suffix}")
    assert list(again.channels) == list(recording.channels)
    for name, channel in recording.channels.items():
        assert again.channels[name].unit == channel.unit
        np.testing.assert_array_equal(again[name], channel.values)
    assert again.metadata == recording.metadata
    first = (tmp_path / f"run{suffix}").read_bytes()
    write_recording(recording, tmp_path / f"run{suffix}")
    assert (tmp_path / f"run{suffix}").read_bytes() == first


def test_parquet_is_a_table_with_units_for_any_tool(tmp_path: Path, recording: Recording) -> None:
    write_recording(recording, tmp_path / "run.parquet")
    table = pq.read_table(tmp_path / "run.parquet")
    assert table["current_roll"].null_count == 1
    assert table.schema.field("current_roll").metadata[b"unit"] == b"A"
    assert table.schema.field("statusword_roll").type == pa.int64()


def test_mcap_has_a_message_per_row_for_any_tool(tmp_path: Path, recording: Recording) -> None:
    write_recording(recording, tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as file:
        read = list(make_reader(file).iter_messages())
    messages = [(message.log_time, json.loads(message.data, parse_constant=pytest.fail)) for _, _, message in read]
    assert len(messages) == 50
    assert messages[1][0] - messages[0][0] == round(1e9 / RATE_Hz)
    assert "current_roll" not in messages[7][1]
    assert messages[8][1]["current_roll"] == recording["current_roll"][8]
    schema, channel, _ = read[0]
    assert schema is not None
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")  # well-known encodings of the MCAP registry
    described = json.loads(schema.data)
    jsonschema.Draft7Validator.check_schema(described)
    assert {name: entry["type"] for name, entry in described["properties"].items()} == dict.fromkeys(recording.channels, "number")
    assert [error.message for _, message in messages for error in jsonschema.Draft7Validator(described).iter_errors(message)] == []


def test_infinities_are_valid_json_and_come_back(tmp_path: Path, recording: Recording) -> None:
    values = recording["current_roll"].copy()
    values[3:5] = np.inf, -np.inf
    write_recording(Recording({**recording.channels, "current_roll": Channel("A", values)}, recording.metadata), tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as file:
        for _, _, message in make_reader(file).iter_messages():
            json.loads(message.data, parse_constant=pytest.fail)
    np.testing.assert_array_equal(read_recording(tmp_path / "run.mcap")["current_roll"], values)


def test_a_table_of_another_tool_is_named_and_the_rest_is_listed(carm: Machine, tmp_path: Path) -> None:
    stamps = pa.array([timedelta(milliseconds=4 * k) for k in range(5)])
    table = pa.table(
        {
            "t": stamps,
            "q [deg]": pa.array(np.arange(5.0)).cast(pa.decimal128(9, 3)),
            "i": pa.array([1, 2, None, 4, 5]),
            "note": pa.array(list("abcde")),
            "v": pa.array(range(5)),
        }
    )
    pq.write_table(table, tmp_path / "lab.parquet")
    names = {"t": "time", "q": "position_roll", "i": Target("current_roll", "mA", scale=-2.0, offset=1.0)}
    recording, source = quietly(tmp_path / "lab.parquet", carm, names)
    np.testing.assert_allclose(recording.time, 4e-3 * np.arange(5))
    np.testing.assert_allclose(recording["position_roll"], np.arange(5) * DEG)
    np.testing.assert_allclose(recording["current_roll"], (-2.0 * np.array([1, 2, np.nan, 4, 5]) + 1.0) * 1e-3)
    assert source["not_taken"] == ["v", "note, of type string"]
    with pytest.raises(RecordingError, match="no column is time; it has t, q, i, v, note; say which is which"):
        read_recording(tmp_path / "lab.parquet", carm)
    with pytest.raises(RecordingError, match="name the machine with --machine"):
        read_recording(tmp_path / "lab.parquet")


@pytest.mark.parametrize("suffix", [".parquet", ".mcap"])
@FILES
@given(place=st.integers(0, 10_000), byte=st.integers(0, 255), keep=st.integers(0, 10_000))
def test_a_damaged_file_is_read_or_refused_in_one_line(
    carm: Machine, tmp_path: Path, recording: Recording, suffix: str, place: int, byte: int, keep: int
) -> None:
    path = tmp_path / f"run{suffix}"
    write_recording(recording.part(slice(0, 5)), path)
    content = bytearray(path.read_bytes())
    content[place % len(content)] = byte
    path.write_bytes(content[: keep + 1] if keep % 3 == 0 else content)
    _, refusal = answer_or_refusal(RecordingError, quietly, path, carm)
    assert refusal is None or "\n" not in refusal


@pytest.mark.parametrize(("module", "name"), [("pyarrow", "run.parquet"), ("mcap", "run.mcap")])
def test_a_missing_package_is_said_with_the_extra_that_brings_it(
    tmp_path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch, module: str, name: str
) -> None:
    def absent(asked: str) -> object:
        if asked.partition(".")[0] == module:
            raise ImportError(asked)
        return __import__(asked)

    monkeypatch.setattr(extras.importlib, "import_module", absent)
    with pytest.raises(UnusableInputError, match=rf"need {module}: pip install 'isocenter\[logs\]'"):
        write_recording(recording, tmp_path / name)


# ---- CSV -------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "time [s];position_roll [deg];current_roll [A]\n0;1,5;-2\n0,5;2,5E-1;\n",
        "sep=;\r\ntime [s];position_roll [deg];current_roll [A]\r\n0,0;1,5;-2,0\r\n0,5;0,25;\r\n",
        "time [s];position_roll [deg];current_roll [A];\n0;1.5;-2;\n0.5;0.25;;\n",
        "time [s]\tposition_roll [deg]\tcurrent_roll [A]\n0\t1,5\t-2\n0,5\t0,25\t\n",
        "\ufefftime [ms],position_roll [deg],current_roll [mA]\n0,1.5,-2000\n500,0.25,\n",
    ],
    ids=["semicolons", "a spreadsheet's first line", "a semicolon behind each row", "tabs", "commas"],
)
def test_csv_of_other_places_gives_the_same_recording(carm: Machine, tmp_path: Path, text: str) -> None:
    (tmp_path / "run.csv").write_bytes(text.encode())
    recording = read_recording(tmp_path / "run.csv", carm)
    np.testing.assert_allclose(recording.time, [0.0, 0.5])
    np.testing.assert_allclose(recording["position_roll"], np.array([1.5, 0.25]) * DEG)
    np.testing.assert_array_equal(recording["current_roll"], [-2.0, np.nan])


def test_columns_of_a_csv_get_names_and_what_is_no_channel_is_listed(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text("Zeit (s);Winkel [deg];Strom;Bemerkung, frei;x\n0;1,5;3;gut;7\n0,5;2;4;schlecht;8\n")
    names = {"Zeit (s)": "time", "Winkel": "position_roll", "Strom": "current_roll [mA]"}
    recording, source = quietly(tmp_path / "lab.csv", carm, names)
    np.testing.assert_allclose(recording["position_roll"], np.array([1.5, 2.0]) * DEG)
    np.testing.assert_allclose(recording["current_roll"], [3e-3, 4e-3])
    assert list(recording["x"]) == [7.0, 8.0]
    assert len(source["not_taken"]) == 1
    assert source["not_taken"][0].startswith("Bemerkung, frei: ")


def test_a_column_of_words_is_refused_with_the_way_out(carm: Machine, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time [s],position_roll [rad],comment\n0,0.1,up\n0.00390625,0.2,down\n")
    with pytest.raises(RecordingError, match="line 2: comment = 'up' is no number; where --map names columns, others that hold no numbers"):
        read_recording(path, carm)
    recording, _ = quietly(path, carm, {"time": "time", "position_roll": "position_roll"})
    np.testing.assert_array_equal(recording["position_roll"], [0.1, 0.2])


@FILES
@given(
    numbers=st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), min_size=1, max_size=8),
    mark=st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", ",")]),
)
def test_whatever_separates_cells_and_decimals_the_numbers_are_the_same(
    carm: Machine, tmp_path: Path, numbers: list[tuple[float, float]], mark: tuple[str, str]
) -> None:
    cell, decimal = mark
    lines = [cell.join(("time [s]", "position_roll [rad]", "current_roll [A]"))]
    lines += [cell.join(repr(value).replace(".", decimal) for value in (float(k), *row)) for k, row in enumerate(numbers)]
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    recording = read_recording(tmp_path / "run.csv", carm)
    np.testing.assert_array_equal(recording.matrix(["position_roll", "current_roll"]), numbers)


@FILES
@given(text=st.text(alphabet="time [s];,.\t\n\"'0123456789eE-xnaif", max_size=80), head=st.booleans())
def test_any_text_as_csv_is_a_recording_or_refused_in_one_line(carm: Machine, tmp_path: Path, text: str, head: bool) -> None:
    (tmp_path / "any.csv").write_text(("time [s];x\n" if head else "") + text)
    _, refusal = answer_or_refusal(RecordingError, quietly, tmp_path / "any.csv", carm)
    assert refusal is None or "\n" not in refusal


# ---- names -----------------------------------------------------------------------------------------------------------------------


def test_a_file_of_names_has_units_factors_and_offsets(tmp_path: Path) -> None:
    (tmp_path / "names.toml").write_text(
        '[channels]\n"a b" = "time [ms]"\n"s.v" = { channel = "position_roll", unit = "deg", scale = -1, offset = 2.5 }\n'
    )
    assert read_names(tmp_path / "names.toml") == {"a b": Target("time", "ms"), "s.v": Target("position_roll", "deg", -1.0, 2.5)}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"no table \[channels\]"),
        ("[channels]\n", r"no table \[channels\]"),
        ('[channels]\nx = "time"\n[units]\n', "key units; a file of names is a table"),
        ("[channels]\nx = 3\n", r'channels\.x: must be "CHANNEL \[unit\]" or a table'),
        ('[channels]\nx = { channel = "time", factor = 2 }\n', r"channels\.x: unknown key factor; channel, unit, scale, offset are known"),
        ('[channels]\nx = { channel = "time", scale = 0 }\n', r"channels\.x: scale = 0: must be a finite number other than 0"),
        ('[channels]\nx = { channel = "time", offset = inf }\n', r"channels\.x: offset = inf: must be a finite number"),
        ('[channels]\nx = { channel = "time", unit = 1 }\n', r"channels\.x: unit = 1: must be a text"),
        ('[channels]\nx = "a]b"\n', r"channels\.x: 'a\]b' is not `CHANNEL` or `CHANNEL \[unit\]`"),
        ("[channels\n", "no TOML"),
    ],
)
def test_a_file_of_names_with_a_fault_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "names.toml").write_text(text)
    with pytest.raises(RecordingError, match=message) as refusal:
        read_names(tmp_path / "names.toml")
    assert "\n" not in str(refusal.value)


def test_a_channel_has_one_source_and_a_wrong_name_is_answered_with_the_closest(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text("t,angle,angles\n0,1,2\n1,2,3\n")
    with pytest.raises(RecordingError, match="both angle and angles are to be position_roll; a channel has one source"):
        read_recording(tmp_path / "lab.csv", carm, {"t": "time", "angle": "position_roll", "angles": "position_roll"})
    with pytest.raises(RecordingError, match=r"no variable angel; did you mean angles? or"):
        read_recording(tmp_path / "lab.csv", carm, {"t": "time", "angel": "position_roll"})


def test_a_can_log_has_no_names_to_give(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "bus.log").write_text("(0.0) can0 080#\n")
    with pytest.raises(RecordingError, match="leave --map out"):
        read_recording(tmp_path / "bus.log", carm, {"x": "time"})


def test_a_time_that_is_no_number_is_refused_whatever_is_named(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text("time [s],q\n0,1\nlate,2\n")
    with pytest.raises(RecordingError, match=r"line 3: time \[s\] = 'late' is no number"):
        read_recording(tmp_path / "lab.csv", carm, {"q": "position_roll"})
