"""Units that stand in a column's name are read and said; nothing is taken in another unit, or for another quantity, without a word."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import RecordingWarning, read_recording

TURN = 2.0 * math.pi
STEP_S = 1.0 / 256.0
VALUES = np.array([0.1, 0.3, -0.2, 0.25])


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def table(folder: Path, head: str, values: np.ndarray = VALUES, time: str = "t [s]", per_s: float = 1.0, name: str = "log.csv") -> Path:
    path = folder / name
    rows = "".join(f"{per_s * STEP_S * k!r};{value!r}\n" for k, value in enumerate(values.tolist()))
    path.write_text(f"{time};{head}\n{rows}", encoding="utf-8")
    return path


def said(path: Path, machine: Machine, names: dict[str, str] | None, channel: str) -> tuple[np.ndarray, str]:
    """Return a channel's values, and what was warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(path, machine, names)
    assert recording.time[1] - recording.time[0] == pytest.approx(STEP_S)
    return recording[channel], " ".join(str(one.message) for one in caught if issubclass(one.category, RecordingWarning))


@pytest.mark.parametrize(
    ("head", "channel", "factor"),
    [
        ("position_deg", "position_roll", TURN / 360), ("Position (deg)", "position_roll", TURN / 360),
        ("Position / deg", "position_roll", TURN / 360), ("posDeg", "position_roll", TURN / 360), ("angle.mrad", "position_roll", 1e-3),
        ("pos_rev", "position_roll", TURN), ("pos_turns", "position_roll", TURN), ("enc_counts", "position_roll", TURN / 4096 / 500),
        ("speed_rpm", "speed_roll", TURN / 60), ("vel_deg_s", "speed_roll", TURN / 360), ("velRadPerS", "speed_roll", 1.0),
        ("Drehzahl 1/min", "speed_roll", TURN / 60), ("v_degps", "speed_roll", TURN / 360), ("Iq_mA", "current_roll", 1e-3),
        ("load_pct", "current_roll", 0.05), ("torque {N*m}", "effort_roll", 1.0), ("acc_x_mg", "imu_x", 9.80665e-3),
    ],
)  # fmt: skip
def test_a_unit_in_a_name_is_taken_and_said(carm: Machine, tmp_path: Path, head: str, channel: str, factor: float) -> None:
    values, words = said(table(tmp_path, head), carm, {"t": "time", head: channel}, channel)
    np.testing.assert_allclose(values, factor * VALUES, rtol=1e-12)
    assert f"{head} is taken in " in words


@pytest.mark.parametrize("head", ["q_rot", "pos_in", "position_r", "q(r)", "pos_m", "phase_A", "roll_turn", "q_min", "log(1,:)"])
def test_what_only_looks_like_a_unit_leaves_the_machines(carm: Machine, tmp_path: Path, head: str) -> None:
    values, words = said(table(tmp_path, head), carm, {"t": "time", head: "position_roll"}, "position_roll")
    np.testing.assert_array_equal(values, VALUES)
    assert words == ""


def test_a_given_unit_and_that_of_the_file_come_before_the_name(carm: Machine, tmp_path: Path) -> None:
    path = table(tmp_path, "pos_deg")
    np.testing.assert_array_equal(said(path, carm, {"t": "time", "pos_deg": "position_roll [rad]"}, "position_roll")[0], VALUES)
    path = table(tmp_path, "pos_deg [mrad]")
    np.testing.assert_allclose(said(path, carm, {"t": "time", "pos_deg": "position_roll"}, "position_roll")[0], 1e-3 * VALUES)


@pytest.mark.parametrize(("head", "unit"), [("pos (mm)", "mm"), ("pos [mm]", "mm"), ("pos (rpm)", "rpm"), ("pos [lsb]", "lsb")])
def test_another_quantity_is_refused_with_the_scale(carm: Machine, tmp_path: Path, head: str, unit: str) -> None:
    name = head.removesuffix(" [mm]").removesuffix(" [lsb]")
    with pytest.raises(RecordingError, match=rf"\[{unit}\].*\[rad\] or .*\[deg\].*scale = \.\.\. }} \(--map FILE\)"):
        read_recording(table(tmp_path, head), carm, {"t": "time", name: "position_roll"})


@pytest.mark.parametrize(("time", "per_s"), [("time_ms", 1e3), ("Time (us)", 1e6), ("time", 1e3), ("time", 1e9)])
def test_channels_names_with_units_need_no_map(carm: Machine, tmp_path: Path, time: str, per_s: float) -> None:
    values, words = said(table(tmp_path, "position_roll_deg", time=time, per_s=per_s), carm, None, "position_roll")
    np.testing.assert_allclose(values, VALUES * TURN / 360)
    assert "position_roll_deg is taken in deg, by its name" in words
    assert "by its name" in words.split("position_roll_deg")[0] or "so it has the 256 Hz of machine" in words


def test_a_time_of_no_known_rate_stays_in_seconds_and_names_the_option(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,q\n" + "".join(f"{10 * k},{k}\n" for k in range(9)))
    with pytest.warns(RecordingWarning, match=r"t has no unit and is taken in s, .*--map 't=time \[ms\]' takes it in ms"):
        recording = read_recording(tmp_path / "log.csv", carm, {"t": "time", "q": "position_roll [rad]"})
    assert recording.time[-1] == 80.0


def test_parquet_of_pandas_and_mat_know_the_same_names(carm: Machine, tmp_path: Path) -> None:
    columns = {"time_ms": 1e3 * STEP_S * np.arange(4), "position_roll_deg": VALUES}
    pd.DataFrame(columns).to_parquet(tmp_path / "log.parquet")
    scipy.io.savemat(tmp_path / "log.mat", columns)
    names = {"time_ms": "time", "position_roll_deg": "position_roll"}
    for file, mapped in (("log.parquet", None), ("log.parquet", names), ("log.mat", names)):
        np.testing.assert_allclose(said(tmp_path / file, carm, mapped, "position_roll")[0], VALUES * TURN / 360)


def test_a_position_without_a_unit_and_a_table_without_time_say_what_to_map(carm: Machine, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no unit; .* say which with --map 'position_roll=position_roll \[UNIT\]'"):
        read_recording(table(tmp_path, "position_roll", time="time"), carm)
    with pytest.raises(RecordingError, match=r"no column `time \[s\]`; say which is with --map 'NAME=time \[s\]': tick; position_roll"):
        read_recording(table(tmp_path, "position_roll [deg]", time="tick"), carm)


@pytest.mark.parametrize(
    ("suffix", "way"), [(".bag", "rosbags-convert"), (".gz", "unpack"), (".xlsx", "CSV"), (".tdms", "nptdms"), (".h5", "pandas")]
)
def test_a_file_of_another_kind_is_refused_with_what_makes_a_readable_one(carm: Machine, tmp_path: Path, suffix: str, way: str) -> None:
    (tmp_path / f"log{suffix}").write_bytes(b"\0")
    with pytest.raises(RecordingError, match=rf"cannot be read as `{suffix}`; .*: .*{way}"):
        read_recording(tmp_path / f"log{suffix}", carm)


@pytest.mark.parametrize("name", ["log.txt", "log.tsv"])
def test_a_table_may_be_a_text(carm: Machine, tmp_path: Path, name: str) -> None:
    values, _ = said(table(tmp_path, "position_roll [rad]", time="time [s]", name=name), carm, None, "position_roll")
    np.testing.assert_array_equal(values, VALUES)
