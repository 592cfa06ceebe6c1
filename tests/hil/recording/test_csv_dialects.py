"""Tables of text as tools of many places write them: each gives the numbers that a person reads in it."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

NAMES = {"t": "time [s]", "i": "current_roll [mA]"}


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def read(
    folder: Path, content: str | bytes, machine: Machine, names: dict[str, str] | None = None
) -> tuple[Recording, dict[str, list[str]]]:
    """The recording, and what its reader said of its source."""
    path = folder / "log.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        recording = read_recording(path, machine, names)
    return recording, recording.metadata.get("source", {})


@pytest.mark.parametrize(
    "rows",
    [
        "t;i\n0;1.234,5\n0,1;-2\n",
        "t;i\n0;1,234.5\n0.1;-2\n",
        't,i\n0,"1,234.5"\n0.1,-2\n',
        't,i\n"0","1234,5"\n"0,1",-2\n',
        "t;i\n0;1\u202f234,5\n0,1;-2\n",
        "t;i\n0;1'234.5\n0.1;-2\n",
        "t|i\n0|1234.5\n0.1|-2\n",
        "t\ti\n0\t1.2345E3\n0.1\t-2\n",
        "t,i\r0,1234.5\r0.1,-2\r",
        "# rig 3\n% of January\nt,i\n0,1234.5\n0.1,-2\n",
        "# rig 3\n# t,i\n0,1234.5\n0.1,-2\n",
        '"t"\t"i"\n"1"\t0\t1234.5\n"2"\t0.1\t-2\n',
        "t,i,\n0,1234.5,\n0.1,-2,\n",
        "t,i\n2026-01-05 23:59:59.95,1234.5\n2026-01-06 00:00:00.05,-2\n",
        "t;i\n12:00:00,000;1234,5\n12:00:00,100;-2\n",
    ],
)
def test_marks_separators_and_times_of_many_places_give_the_same_numbers(carm: Machine, tmp_path: Path, rows: str) -> None:
    recording, _ = read(tmp_path, rows, carm, NAMES)
    np.testing.assert_allclose(recording.time, [0.0, 0.1], atol=1e-12)
    np.testing.assert_allclose(recording["current_roll"], [1.2345, -0.002], atol=1e-12)


@pytest.mark.parametrize(
    ("rows", "times_ms", "currents_mA"),
    [
        ("t;i\n995.000;0,5\n1.003.000;-2\n", [995_000, 1_003_000], [0.5, -2]),
        ("t;i\n995.000;0,5\n999.000;-2\n", [995_000, 999_000], [0.5, -2]),
        ("t;i\n1,5;2,500\n2,5;-3,500\n", [1.5, 2.5], [2.5, -3.5]),
        ("t;i\n1,000;0.5\n1,004;-2\n", [1000, 1004], [0.5, -2]),
        ("t;i\n1,000;0\n1,004.5;-2,000\n", [1000, 1004.5], [0, -2000]),
        ("t;i\n995,000;1\n1003,000;-2\n", [995, 1003], [1, -2]),
        ("t\ti\n0.000\t1.000\n1.004\t-2\n", [0, 1.004], [1, -2]),
        ("t;i\n1\u202f000;1,234\n1\u202f004;-2\n", [1000, 1004], [1.234, -2]),
        ('t,i\n"1,000","1,234,567"\n"1,004",-2.125\n', [1000, 1004], [1_234_567, -2.125]),
        ('t,i\n"1,000",0.5\n"1,004",-2\n', [1000, 1004], [0.5, -2]),
        ("t,i\n1.000,1.500\n1.004,-2.125\n", [1, 1.004], [1.5, -2.125]),
    ],
)
def test_a_mark_before_three_digits_is_what_another_cell_says(
    carm: Machine, tmp_path: Path, rows: str, times_ms: list[float], currents_mA: list[float]
) -> None:
    recording, _ = read(tmp_path, rows, carm, NAMES | {"t": "time [ms]"})
    np.testing.assert_allclose(recording.time, np.array(times_ms) / 1e3, rtol=1e-12)
    np.testing.assert_allclose(recording["current_roll"], np.array(currents_mA) / 1e3, rtol=1e-12)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_encodings_of_spreadsheets_are_read_and_a_guessed_one_is_said(carm: Machine, tmp_path: Path, encoding: str) -> None:
    recording, source = read(
        tmp_path, "t;Strom für roll\n0;1\n1;2\n".encode(encoding), carm, {"t": "time", "Strom für roll": "current_roll"}
    )
    np.testing.assert_array_equal(recording["current_roll"], [1.0, 2.0])
    assert ("notes" in source) == (encoding == "cp1252")


def test_a_row_of_units_gives_the_units(carm: Machine, tmp_path: Path) -> None:
    recording, _ = read(tmp_path, "time,position_roll,current_roll\n[ms],deg,mA\n0,180,1500\n100,0,0\n", carm)
    np.testing.assert_allclose(recording.time, [0.0, 0.1])
    np.testing.assert_allclose(recording["position_roll"], [np.pi, 0.0])
    np.testing.assert_allclose(recording["current_roll"], [1.5, 0.0])


@pytest.mark.parametrize("word", ["NA", "NaN", "NULL", "#N/A", "--", ""])
def test_words_for_a_missing_number_are_missing_samples(carm: Machine, tmp_path: Path, word: str) -> None:
    recording, _ = read(tmp_path, f"t,i\n0,1\n1,{word}\n", carm, NAMES)
    np.testing.assert_array_equal(recording["current_roll"], [1e-3, np.nan])


def test_a_column_without_a_name_is_left_out_and_said(carm: Machine, tmp_path: Path) -> None:
    recording, source = read(tmp_path, ",time [s],current_roll [A]\n0,0.0,1\n1,0.1,2\n", carm)
    np.testing.assert_array_equal(recording["current_roll"], [1.0, 2.0])
    assert source["not_taken"] == ["column without a name"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("t,i\n0,1\nlater,2\n", "line 3: t = 'later' is no number"),
        ("t,i\n12:00:00,1\n0.1,2\n", "line 3: t = '0.1' is no number"),
        ("# rig\nt,i\n0,1\n0,2\n", "lines 3 and 4 have the same stamp and other values"),
        ("t,i\ns,mA\n0,1\n0.1,two\n", "line 4: i = 'two' is no number"),
        (b"t,i\n0,\x81\n", "no UTF-8 text"),
        ('t,i\n"1,000",5\n"1,004",7\n', "line 2: '1,000' is 1 or 1000, and no number in the table says which; one like '0,5' would"),
        ("t;i\n1;5\n2;-1.250\n", "line 3: '-1.250' is -1.25 or -1250, and no number in the table says which; one like '0.5' would"),
        ("t;i\n1.000;5,250\n2.000;7\n", "line 2: '1.000' is 1 or 1000, and"),
        ("t;i\n1.000;0,5\n1,5;0.5\n", "line 3: decimal commas and points in one file"),
        ("t;i\n1\u202f000,5;1.250\n1\u202f004;7\n", "line 2: decimal commas and points in one file"),
    ],
)
def test_what_is_no_number_is_told_by_its_line(carm: Machine, tmp_path: Path, content: str | bytes, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        read(tmp_path, content, carm, NAMES)


def test_a_recording_of_ours_is_held_to_its_own_form(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "log.toml").write_text("recording_format = 1\nrows = 2\n")
    with pytest.raises(RecordingError, match="line 3: x = 'NA' is no number"):
        read(tmp_path, "time [s],x\n0,1\n1,NA\n", carm)
