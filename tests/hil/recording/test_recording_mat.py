"""MATLAB files: the real EMPS records, general files by a map of names, and files that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import DATA, needs_data
from refusals import answer_or_refusal

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import convert, read_recording
from hil.recording.mat5 import numeric_arrays

EMPS = DATA / "emps"
needs_emps = needs_data("emps", "the EMPS records are")


@pytest.fixture(scope="module")
def emps() -> Machine:
    return load_machine("emps")


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


@needs_emps
@pytest.mark.parametrize("name", ["DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"])
def test_the_emps_records_are_reference_position_and_command_of_the_one_axis(emps: Machine, name: str) -> None:
    recording = read_recording(EMPS / name, emps)
    raw = scipy.io.loadmat(EMPS / name)
    axis = emps.axes[0]
    assert (recording.rows, recording.sample_rate_Hz) == (24841, pytest.approx(1000.0, abs=1e-3))
    for variable, quantity, unit in (("qg", "reference", "m"), ("qm", "position", "m"), ("vir", "command", "V")):
        assert recording.channels[f"{quantity}_{axis}"].unit == unit
        np.testing.assert_array_equal(recording[f"{quantity}_{axis}"], raw[variable].ravel())
    assert recording.machine_hash == emps.hash
    assert recording.metadata["source"]["constants"]["kp"] == 160.18


@needs_emps
def test_the_pulses_are_an_excitation_in_volts(emps: Machine) -> None:
    recording = read_recording(EMPS / "DATA_EMPS_PULSES.mat", emps)
    excitation = recording.channels[f"excitation_{emps.axes[0]}"]
    assert excitation.unit == "V"
    np.testing.assert_array_equal(excitation.values, scipy.io.loadmat(EMPS / "DATA_EMPS_PULSES.mat")["pulses_N"].ravel())
    assert f"excitation_{emps.axes[0]}" not in read_recording(EMPS / "DATA_EMPS.mat", emps)


@needs_emps
def test_a_converted_emps_record_needs_no_machine_any_more(emps: Machine, tmp_path: Path) -> None:
    convert(EMPS / "DATA_EMPS.mat", tmp_path / "emps.mf4", emps)
    again = read_recording(tmp_path / "emps.mf4")
    np.testing.assert_array_equal(again[f"command_{emps.axes[0]}"], scipy.io.loadmat(EMPS / "DATA_EMPS.mat")["vir"].ravel())
    assert again.machine_text == emps.text


def save(path: Path, **variables: list[float | list[float] | str] | np.ndarray | str) -> Path:
    scipy.io.savemat(path, variables)
    return path


def test_a_map_of_names_makes_channels_in_the_machines_units(carm: Machine, tmp_path: Path) -> None:
    path = save(tmp_path / "x.mat", zeit=[0.0, 0.5], u=[[1.0], [2.0]], a=[3.0, 4.0], unused=[[1.0, 2.0], [3.0, 4.0]])
    recording = read_recording(path, carm, {"zeit": "time", "u": "command_roll", "a": "imu_x"})
    assert {name: channel.unit for name, channel in recording.channels.items()} == {"time": "s", "command_roll": "A", "imu_x": "m/s^2"}
    np.testing.assert_array_equal(recording["command_roll"], [1.0, 2.0])


def test_variables_that_bear_channel_names_need_no_map(carm: Machine, tmp_path: Path) -> None:
    path = save(tmp_path / "x.mat", time=[0.0, 0.5], position_roll=[0.1, 0.2], statusword_roll=np.array([39, 39], dtype=np.uint16))
    assert read_recording(path, carm)["statusword_roll"].tolist() == [39.0, 39.0]


@pytest.mark.parametrize(
    ("variables", "names", "message"),
    [
        ({"t": [0.0, 1.0], "q": [0.0, 1.0]}, None, "say which is which"),
        ({"t": [0.0, 1.0]}, {"t": "time", "q": "position_roll"}, "no variable q; it has t"),
        ({"t": [0.0, 1.0], "q": [0.0, 1.0, 2.0]}, {"t": "time", "q": "position_roll"}, "channel position_roll: shape"),
        ({"t": [0.0, 1.0], "q": [[0.0, 1.0], [0.0, 1.0]]}, {"t": "time", "q": "position_roll"}, "q is no vector of numbers"),
        ({"t": [0.0, 1.0], "q": ["a", "b"]}, {"t": "time", "q": "position_roll"}, "q is no vector of numbers"),
        ({"t": [0.0, 1.0], "q": [0.0, 1.0]}, {"t": "time", "q": "position_yaw"}, "position_yaw is no channel of machine carm"),
        ({"t": [0.0, 0.0], "q": [0.0, 1.0]}, {"t": "time", "q": "position_roll"}, "rows 0 and 1 have the same stamp and other values"),
    ],
)
def test_a_file_that_does_not_fit_is_one_line(
    carm: Machine, tmp_path: Path, variables: dict[str, list[float | list[float] | str]], names: dict[str, str] | None, message: str
) -> None:
    path = save(tmp_path / "x.mat", **variables)
    with pytest.raises(RecordingError, match=message) as refusal:
        read_recording(path, carm, names)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_a_mat_without_machine_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="--machine"):
        read_recording(save(tmp_path / "x.mat", time=[0.0]))


def test_a_matlab_7_3_file_that_is_none_is_one_line(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "x.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + bytes(512))
    with pytest.raises(RecordingError, match=r"no MATLAB 7\.3 file, or damaged"):
        read_recording(tmp_path / "x.mat", carm)


def test_whatever_numeric_type_scipy_saves_is_read_as_it_is(tmp_path: Path) -> None:
    kinds = ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]
    wanted = {f"v_{kind}": np.array([[1, 2, 3], [4, 5, 6]], dtype=kind) for kind in kinds}
    others = {"complex": np.array([1j]), "lines": np.array(["ab", "cd"]), "sparse": scipy.sparse.eye(2).tocsc()}
    inside = {"text": "abc", "structure": {"a": 1.0, "b": {"c": "d"}}, "cell": np.array([1, "a"], dtype=object)}
    for compressed in (False, True):
        scipy.io.savemat(tmp_path / "x.mat", wanted | others | inside, do_compression=compressed)
        found = numeric_arrays((tmp_path / "x.mat").read_bytes())
        assert all(found[name] is None for name in others)
        assert (found["text"], found["structure.a"], found["structure.b.c"]) == ("abc", 1.0, "d")
        assert (found["cell{1}"], found["cell{2}"]) == (1, "a")
        for name, values in wanted.items():
            assert found[name].dtype == values.dtype
            np.testing.assert_array_equal(found[name], values)


@settings(max_examples=examples(200), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0, 10_000), byte=st.integers(0, 255), keep=st.integers(0, 10_000))
def test_a_damaged_mat_is_read_or_refused_in_one_line(carm: Machine, tmp_path: Path, place: int, byte: int, keep: int) -> None:
    path = save(tmp_path / "x.mat", time=[0.0, 0.5], position_roll=[0.1, 0.2], text="abc")
    content = bytearray(path.read_bytes())
    content[place % len(content)] = byte
    path.write_bytes(content[: keep + 1])
    _, refusal = answer_or_refusal(RecordingError, read_recording, path, carm)
    assert refusal is None or "\n" not in refusal
