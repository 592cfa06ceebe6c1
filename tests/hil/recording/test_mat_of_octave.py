"""MATLAB's level 4, and Octave's own text, which its `save` writes unless told otherwise."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import answer_or_refusal
from scipy.io import savemat

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

FILES = settings(max_examples=examples(80), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
T, Q = np.arange(4) / 256.0, np.array([0.5, -1.0, 2.0, 3.0])
TEXT = """# Created by Octave 7.3.0, Mon Jan 05 12:00:00 2026 UTC <me@rig>
# name: t
# type: matrix
# rows: 1
# columns: 4
 0 0.00390625 0.0078125 0.01171875


# name: k
# type: double_range
# base, limit, increment
0 3 1


# name: note
# type: sq_string
# elements: 1
# length: 9
third run


# name: z
# type: complex matrix
# rows: 2
# columns: 1
 (0,1)
 (0,2)


# name: s
# type: scalar struct
# ndims: 2
 1 1
# length: 3
# name: m
# type: float matrix
# rows: 4
# columns: 2
 0.5 1
 -1 2
 2 NA
 3 4


# name: d
# type: struct
# ndims: 2
 1 2
# length: 1
# name: v
# type: cell
# rows: 1
# columns: 2
# name: <cell-element>
# type: int16 matrix
# ndims: 2
 4 1
  5
  6
  7
  8


# name: <cell-element>
# type: null_matrix
# rows: 0
# columns: 0





# name: c
# type: cell
# rows: 1
# columns: 2
# name: <cell-element>
# type: bool
1


# name: <cell-element>
# type: matrix
# rows: 4
# columns: 1
 1
 2
 3
 4







"""


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def read(path: Path, machine: Machine, names: dict[str, str]) -> tuple[Recording, list[str]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        recording = read_recording(path, machine, names)
    return recording, recording.metadata["source"].get("not_taken", [])


def octave(folder: Path, text: str = TEXT) -> Path:
    (folder / "log.mat").write_text(text)
    return folder / "log.mat"


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("s.m(:,1)", Q),
        ("s.m(:,2)", [1.0, 2.0, np.nan, 4.0]),
        ("s.d(1).v", [5.0, 6.0, 7.0, 8.0]),
        ("s.c{2}", [1.0, 2.0, 3.0, 4.0]),
        ("k", [0.0, 1.0, 2.0, 3.0]),
    ],
)
def test_variables_of_octaves_text_have_the_names_that_octave_gives_them(
    carm: Machine, tmp_path: Path, name: str, values: list[float]
) -> None:
    recording, not_taken = read(octave(tmp_path), carm, {"t": "time", name: "position_roll"})
    np.testing.assert_array_equal(recording.time, T)
    np.testing.assert_array_equal(recording["position_roll"], values)
    assert "z, neither numbers nor text" in not_taken


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("# columns: 4", "# columns: 5", "damaged"),
        ("0 3 1", "0 3e99 1", "damaged: line 12: a range of 3e\\+99 numbers"),
        ("# type: matrix", "# kind: matrix", r"line 3: '# kind: matrix' where `# type:` would be right"),
    ],
)
def test_damaged_text_is_told_by_its_line(carm: Machine, tmp_path: Path, before: str, after: str, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        read(octave(tmp_path, TEXT.replace(before, after, 1)), carm, {"t": "time", "k": "position_roll"})


@FILES
@given(place=st.integers(0, len(TEXT) - 1), letters=st.text(alphabet="#: \n0aE(", min_size=1, max_size=6))
def test_any_damage_of_octaves_text_is_read_or_refused_in_one_line(carm: Machine, tmp_path: Path, place: int, letters: str) -> None:
    path = octave(tmp_path, TEXT[:place] + letters + TEXT[place + len(letters) :])
    _, refusal = answer_or_refusal(RecordingError, read, path, carm, {"t": "time", "k": "position_roll"})
    assert refusal is None or "\n" not in refusal


def test_level_4_holds_vectors_matrices_and_texts(carm: Machine, tmp_path: Path) -> None:
    content = {"t": T, "m": np.column_stack([Q, 2 * Q]).astype(np.int16), "note": "third run", "z": Q * 1j, "position_roll": Q}
    savemat(tmp_path / "log.mat", content, format="4")
    recording, not_taken = read(tmp_path / "log.mat", carm, {"t": "time", "m(:,2)": "current_roll"})
    np.testing.assert_array_equal(recording.time, T)
    np.testing.assert_array_equal(recording["current_roll"], (2 * Q).astype(np.int16))
    assert {"m(:,1)", "z, neither numbers nor text", "position_roll"} <= set(not_taken)


@FILES
@given(place=st.integers(0, 10_000), bytes_=st.binary(min_size=1, max_size=4), keep=st.integers(0, 10_000))
def test_damaged_level_4_is_read_or_refused_in_one_line(carm: Machine, tmp_path: Path, place: int, bytes_: bytes, keep: int) -> None:
    savemat(tmp_path / "log.mat", {"t": T, "q": Q}, format="4")
    content = bytearray((tmp_path / "log.mat").read_bytes())
    place %= len(content)
    content[place : place + len(bytes_)] = bytes_
    (tmp_path / "log.mat").write_bytes(content[: keep + 1] if keep % 3 == 0 else content)
    _, refusal = answer_or_refusal(RecordingError, read, tmp_path / "log.mat", carm, {"t": "time", "q": "position_roll"})
    assert refusal is None or "\n" not in refusal


def test_hdf5_that_matlab_did_not_write_is_refused_with_what_would_be_right(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "log.mat").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))
    with pytest.raises(RecordingError, match="`save -v7` would be right"):
        read_recording(tmp_path / "log.mat", carm)
