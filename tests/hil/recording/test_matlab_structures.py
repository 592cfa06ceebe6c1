"""MATLAB's structures, cells and matrices, in files of version 7 by SciPy and of version 7.3 as MATLAB lays them out in HDF5."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import answer_or_refusal

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

Save = Callable[[Path, dict[str, Any]], Path]
TIME = np.arange(6) / 256.0
ANGLE = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
FILES = settings(max_examples=examples(80), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def save_7(path: Path, variables: dict[str, Any], compressed: bool = True) -> Path:
    scipy.io.savemat(path, {name: _as_scipy_needs(value) for name, value in variables.items()}, do_compression=compressed)
    return path


def _as_scipy_needs(value: object) -> object:
    """A list of structures as an array of structures."""
    if isinstance(value, dict):
        return {field: _as_scipy_needs(one) for field, one in value.items()}
    if isinstance(value, list):
        return np.array([tuple(one.values()) for one in value], dtype=[(field, object) for field in value[0]])
    return value


def save_73(path: Path, variables: dict[str, Any]) -> Path:
    """As MATLAB does: a user block with its mark, structures as groups, arrays of structures and cells as references, columns first."""
    with h5py.File(path, "w", userblock_size=512) as file:
        refs = file.create_group("#refs#")
        for name, value in variables.items():
            _put(file, refs, name, value)
    content = bytearray(path.read_bytes())
    content[:128] = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(content)
    return path


def _put(group: h5py.Group, refs: h5py.Group, name: str, value: object) -> None:
    if isinstance(value, dict):
        inner = group.create_group(name)
        inner.attrs["MATLAB_class"] = np.bytes_("struct")
        for field, one in value.items():
            _put(inner, refs, field, one)
    elif isinstance(value, list):  # an array of structures
        inner = group.create_group(name)
        inner.attrs["MATLAB_class"] = np.bytes_("struct")
        for field in value[0]:
            inner[field] = np.array([[_referred(refs, element[field])] for element in value], dtype=h5py.ref_dtype)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        group[name] = np.array([[_referred(refs, one)] for one in value.ravel()], dtype=h5py.ref_dtype)
        group[name].attrs["MATLAB_class"] = np.bytes_("cell")
    elif isinstance(value, str):
        group[name] = np.array([[ord(letter)] for letter in value], dtype=np.uint16)
        group[name].attrs["MATLAB_class"] = np.bytes_("char")
    else:
        group[name] = np.atleast_2d(np.asarray(value, dtype=np.float64)).T
        group[name].attrs["MATLAB_class"] = np.bytes_("double")


def _referred(refs: h5py.Group, value: object) -> h5py.Reference:
    name = f"v{len(refs)}"
    _put(refs, refs, name, value)
    return refs[name].ref


def signals(*labelled: tuple[str, np.ndarray]) -> list[dict[str, Any]]:
    return [{"values": values.reshape(-1, 1), "dimensions": 1.0, "label": label} for label, values in labelled]


def scope(*labelled: tuple[str, np.ndarray]) -> dict[str, Any]:
    """Simulink's structure with time."""
    return {"time": TIME.reshape(-1, 1), "signals": signals(*labelled), "blockName": "model/Scope"}


def quietly(path: Path, machine: Machine, names: dict[str, str] | None = None) -> tuple[Recording, dict[str, Any]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        recording = read_recording(path, machine, names)
    return recording, recording.metadata["source"]


versions = pytest.mark.parametrize("save", [save_7, save_73])


@versions
def test_simulinks_structure_with_time_whose_labels_are_channels_needs_no_names(carm: Machine, tmp_path: Path, save: Save) -> None:
    variables = {"ScopeData": scope(("reference_roll", ANGLE), ("position_roll", 2 * ANGLE), ("noise", ANGLE)), "gain": 3.5}
    recording, source = quietly(save(tmp_path / "scope.mat", variables), carm)
    np.testing.assert_array_equal(recording.time, TIME)
    np.testing.assert_array_equal(recording["position_roll"], 2 * ANGLE)
    assert source["not_taken"] == ["ScopeData.signals(3).values"]
    assert source["constants"]["gain"] == 3.5


@versions
def test_signals_of_a_structure_are_named_by_their_number(carm: Machine, tmp_path: Path, save: Save) -> None:
    path = save(tmp_path / "scope.mat", {"ScopeData": scope(("a", ANGLE), ("b", 2 * ANGLE))})
    recording, _ = quietly(path, carm, {"ScopeData.time": "time", "ScopeData.signals(2).values": "position_roll [deg]"})
    np.testing.assert_allclose(recording["position_roll"], 2 * ANGLE * np.pi / 180.0)
    with pytest.raises(RecordingError, match=r"stands for several; name one: ScopeData\.signals\(1\)\.values \(a\); .*\(2\)\.values \(b\)"):
        read_recording(path, carm, {"ScopeData.time": "time", "ScopeData.signals.values": "position_roll"})


@versions
def test_a_name_for_several_signals_is_the_one_with_the_channels_label(carm: Machine, tmp_path: Path, save: Save) -> None:
    path = save(tmp_path / "scope.mat", {"ScopeData": scope(("a", ANGLE), ("position_roll", 2 * ANGLE))})
    recording, _ = quietly(path, carm, {"ScopeData.time": "time", "ScopeData.signals.values": "position_roll"})
    np.testing.assert_array_equal(recording["position_roll"], 2 * ANGLE)


@versions
def test_cells_and_structures_in_structures_are_named_as_matlab_does(carm: Machine, tmp_path: Path, save: Save) -> None:
    runs = np.empty(2, dtype=object)
    runs[:] = [{"q": ANGLE}, {"q": 3 * ANGLE}]
    path = save(tmp_path / "runs.mat", {"bench": {"log": {"t": TIME}}, "runs": runs})
    for name in ("runs{2}.q", "runs(2).q"):
        recording, _ = quietly(path, carm, {"bench.log.t": "time", name: "position_roll"})
        np.testing.assert_array_equal(recording["position_roll"], 3 * ANGLE)


@versions
@pytest.mark.parametrize("upright", [True, False])
def test_columns_and_rows_of_a_matrix_are_named_and_the_others_are_listed(carm: Machine, tmp_path: Path, save: Save, upright: bool) -> None:
    log = np.column_stack([TIME, ANGLE, 2 * ANGLE])
    path = save(tmp_path / "log.mat", {"log": log if upright else log.T})
    columns = [f"log(:,{k})" if upright else f"log({k},:)" for k in (1, 2, 3)]
    recording, source = quietly(path, carm, {columns[0]: "time", columns[2]: "position_roll"})
    np.testing.assert_array_equal(recording["position_roll"], 2 * ANGLE)
    assert source["not_taken"] == [columns[1]]
    with pytest.raises(RecordingError, match="log is no vector of numbers but stands for several; name one: ") as refusal:
        read_recording(path, carm, {"log": "time"})
    assert str(refusal.value).endswith("; ".join(columns))


@versions
def test_samples_of_a_signal_with_dimensions_lie_along_its_longest_side(carm: Machine, tmp_path: Path, save: Save) -> None:
    path = save(tmp_path / "deep.mat", {"t": TIME, "R": np.arange(24.0).reshape(2, 2, 6)})
    recording, _ = quietly(path, carm, {"t": "time", "R(2,1,:)": "position_roll"})
    np.testing.assert_array_equal(recording["position_roll"], np.arange(12.0, 18.0))


@versions
def test_what_a_file_has_is_listed_where_nothing_says_which_is_which(carm: Machine, tmp_path: Path, save: Save) -> None:
    path = save(tmp_path / "lab.mat", {"zeit": TIME, "scope": {"q": ANGLE}})
    with pytest.raises(
        RecordingError, match=r"its variables \((zeit; scope\.q|scope\.q; zeit)\) are not channels' names; say which is which"
    ):
        read_recording(path, carm)


def test_a_speed_of_a_mat_is_in_the_machines_unit(carm: Machine, tmp_path: Path) -> None:
    recording, _ = quietly(save_7(tmp_path / "lab.mat", {"t": TIME, "v": ANGLE}), carm, {"t": "time", "v": "speed_roll"})
    assert recording.channels["speed_roll"].unit == "rad/s"


@versions
@FILES
@given(place=st.integers(0, 100_000), bytes_=st.binary(min_size=1, max_size=4), keep=st.integers(0, 100_000))
def test_damaged_structures_are_read_or_refused_in_one_line(
    carm: Machine, tmp_path: Path, save: Save, place: int, bytes_: bytes, keep: int
) -> None:
    path = tmp_path / "scope.mat"
    variables = {"ScopeData": scope(("reference_roll", ANGLE), ("position_roll", ANGLE))}
    if save is save_7:
        save_7(path, variables, compressed=False)  # so that the structure itself is damaged
    else:
        save(path, variables)
    content = bytearray(path.read_bytes())
    place %= len(content)
    content[place : place + len(bytes_)] = bytes_
    path.write_bytes(content[: keep + 1] if keep % 3 == 0 else content)
    _, refusal = answer_or_refusal(RecordingError, quietly, path, carm)
    assert refusal is None or "\n" not in refusal
