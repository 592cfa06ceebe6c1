"""Revolutions, rpm, counts, percent and other spellings of units are read; what is not names the option that takes it."""

from __future__ import annotations

import math
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

TURN = 2.0 * math.pi


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def table(folder: Path, cell: str, values: list[float]) -> Path:
    path = folder / "log.csv"
    path.write_text(f"time [s],{cell}\n" + "".join(f"{0.005 * k},{value}\n" for k, value in enumerate(values)))
    return path


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("rev", TURN), ("revs", TURN), ("turns", TURN), ("Revolutions", TURN), ("°", TURN / 360), ("degrees", TURN / 360), ("radians", 1.0),
    ],
)  # fmt: skip
def test_angles(carm: Machine, tmp_path: Path, unit: str, factor: float) -> None:
    recording = read_recording(table(tmp_path, f"position_roll [{unit}]", [0.1, 0.3, 0.2]), carm)
    np.testing.assert_allclose(recording["position_roll"], factor * np.array([0.1, 0.3, 0.2]))
    assert recording.channels["position_roll"].unit == "rad"


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("rpm", TURN / 60), ("RPM", TURN / 60), ("1/min", TURN / 60), ("rev/min", TURN / 60), ("rev/s", TURN), ("dps", TURN / 360)],
)
def test_speeds(carm: Machine, tmp_path: Path, unit: str, factor: float) -> None:
    recording = read_recording(table(tmp_path, f"speed_roll [{unit}]", [10.0, 30.0]), carm)
    np.testing.assert_allclose(recording["speed_roll"], factor * np.array([10.0, 30.0]))


@pytest.mark.parametrize(
    ("cell", "factor", "unit"),
    [
        ("current_roll [mA]", 1e-3, "A"), ("current_roll [Amps]", 1.0, "A"), ("effort_roll [N*m]", 1.0, "Nm"),
        ("effort_roll [N·m]", 1.0, "Nm"), ("effort_roll [mNm]", 1e-3, "Nm"), ("imu_x [m/s2]", 1.0, "m/s^2"),
        ("imu_x [m/s²]", 1.0, "m/s^2"), ("imu_x [mg]", 9.80665e-3, "m/s^2"),
        ("temperature_roll [C]", 1.0, "degC"), ("temperature_roll [°C]", 1.0, "degC"),
    ],
)  # fmt: skip
def test_efforts_accelerations_and_temperatures(carm: Machine, tmp_path: Path, cell: str, factor: float, unit: str) -> None:
    recording = read_recording(table(tmp_path, cell, [10.0, 30.0]), carm)
    name = cell.partition(" ")[0]
    np.testing.assert_allclose(recording[name], factor * np.array([10.0, 30.0]))
    assert recording.channels[name].unit == unit


@pytest.mark.parametrize(
    ("cell", "factor", "said"),
    [
        ("position_roll [counts]", TURN / 4096 / 500, "[counts] taken as 3.06796e-06 rad each, by the machine file"),
        ("reference_roll [inc]", TURN / 4096 / 500, "[counts] taken as"),
        ("link_position_roll [counts]", TURN / 2**23, "[counts] taken as"),
        ("speed_roll [counts/s]", TURN / 4096 / 500, "rad/s each"),
        ("current_roll [%]", 0.05, "[%] taken as 0.05 A each"),
        ("command_roll [permille]", 0.005, "[permille] taken as 0.005 A each"),
    ],
)
def test_counts_and_parts_of_the_rated_effort_have_the_machine_files_size(
    carm: Machine, tmp_path: Path, cell: str, factor: float, said: str
) -> None:
    path = table(tmp_path, cell, [10.0, 30.0])
    name = cell.partition(" ")[0]
    for names in (None, {name: name}):
        with pytest.warns(RecordingWarning) as caught:
            recording = read_recording(path, carm, names)
        np.testing.assert_allclose(recording[name], factor * np.array([10.0, 30.0]), rtol=1e-12)
        assert any(said in str(one.message) for one in caught)


def test_a_row_of_such_units_below_the_header_is_one(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time,position_roll,speed_roll\nsec,revs,RPM\n0,0.5,60\n0.005,0.25,30\n")
    recording = read_recording(tmp_path / "log.csv", carm)
    np.testing.assert_allclose(recording["position_roll"], [0.5 * TURN, 0.25 * TURN])
    np.testing.assert_allclose(recording["speed_roll"], [TURN, TURN / 2])


@pytest.mark.parametrize("cell", ["position_roll [gon]", "speed_roll [knot]", "current_roll [counts]"])
def test_a_unit_that_is_not_read_names_the_scale_and_only_units_of_that_axis(carm: Machine, tmp_path: Path, cell: str) -> None:
    with pytest.raises(
        RecordingError, match=r"unknown unit .* takes any other with its scale: .*scale = \.\.\. } \(--map FILE\)"
    ) as refused:
        read_recording(table(tmp_path, cell, [1.0, 2.0]), carm)
    assert "[mm" not in str(refused.value)  # the axis turns


# ---- Modelica results ------------------------------------------------------------------------------------


def matrix(name: str, values: np.ndarray, *, letters: bool = False) -> bytes:
    """A matrix of MATLAB's level 4: doubles, or letters as bytes."""
    kind, data = (51, values.astype(np.uint8)) if letters else (0, values.astype("<f8"))
    head = struct.pack("<5i", kind, values.shape[0], values.shape[1], 0, len(name) + 1)
    return head + name.encode() + b"\0" + data.tobytes(order="F")


def letters(texts: list[str]) -> np.ndarray:
    width = max(map(len, texts))
    return np.array([list(text.encode().ljust(width)) for text in texts])


def result(path: Path, *, turned: bool = True) -> Path:
    """As OpenModelica writes one: time, a state, its opposite under another name, a speed, a constant; an event after the third row."""
    names = ["time", "turn.phi", "motor.phi", "turn.w", "turn.J"]
    descriptions = ["Simulation time [s]", "Angle [rad|deg]", "Opposite [rad]", "Speed [rpm]", "Inertia [kg.m2]"]
    info = np.array([[0, 1, 0, -1], [2, 2, 0, -1], [2, -2, 0, -1], [2, 3, 0, -1], [1, 2, 0, 0]])
    time_s = np.array([0.0, 0.1, 0.2, 0.2, 0.3])
    data = np.column_stack([time_s, [0.0, 0.1, 0.2, 0.25, 0.3], [60.0, 60.0, 60.0, 30.0, 30.0]])
    constants = np.array([[0.0, 7.0], [0.3, 7.0]])
    classes = letters(["Atrajectory", "1.1", "", "binTrans" if turned else "binNormal"])
    parts = [matrix("Aclass", classes, letters=True)]
    for name, values, text in (
        ("name", letters(names), True), ("description", letters(descriptions), True), ("dataInfo", info, False),
        ("data_1", constants, False), ("data_2", data, False),
    ):  # fmt: skip
        parts.append(matrix(name, values.T if turned else values, letters=text))
    path.write_bytes(b"".join(parts))
    return path


def quietly(path: Path, machine: Machine, names: dict[str, str]) -> Recording:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        return read_recording(path, machine, names)


@pytest.mark.parametrize("turned", [True, False])
def test_a_modelica_result_is_read_by_its_names_with_its_units(carm: Machine, tmp_path: Path, turned: bool) -> None:
    path = result(tmp_path / "arm_res.mat", turned=turned)
    recording = quietly(path, carm, {"turn.phi": "position_roll", "motor.phi": "reference_roll", "turn.w": "speed_roll"})
    np.testing.assert_allclose(recording.time, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(recording["position_roll"], [0.0, 0.1, 0.25, 0.3])
    np.testing.assert_allclose(recording["reference_roll"], [0.0, -0.1, -0.25, -0.3])
    np.testing.assert_allclose(recording["speed_roll"], np.array([60.0, 60.0, 30.0, 30.0]) * TURN / 60.0)
    assert recording.metadata["source"]["not_taken"] == [
        "1 constants of the model, which are no signals",
        "1 rows before events, of whose time there is another",
    ]


def test_a_modelica_result_without_channels_names_lists_its_own(carm: Machine, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"say which is which, such as --map NAME=position_<axis>: turn\.phi; motor\.phi; turn\.w"):
        read_recording(result(tmp_path / "arm_res.mat"), carm)


def test_a_modelica_result_that_is_cut_is_one_line(carm: Machine, tmp_path: Path) -> None:
    path = result(tmp_path / "arm_res.mat")
    path.write_bytes(path.read_bytes()[: path.read_bytes().index(b"data_1") - 20])
    with pytest.raises(RecordingError, match="a Modelica result without data_2"):
        read_recording(path, carm)
