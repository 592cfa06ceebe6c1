"""Clocks that do not count in seconds: times are right, and what is said of them is in seconds."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from asammdf import MDF, Signal

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

RATE_Hz, ROWS = 256.0, 400
TIME_s, POSITION_rad = np.arange(ROWS) / RATE_Hz, 1e-3 * np.arange(ROWS)


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def read(path: Path, carm: Machine) -> tuple[Recording, str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(path, carm)
    return recording, " ".join(str(one.message) for one in caught if issubclass(one.category, RecordingWarning))


def csv_file(folder: Path, time_us: np.ndarray) -> Path:
    rows = "".join(f"{t!r},{q!r}\n" for t, q in zip(time_us.tolist(), POSITION_rad.tolist(), strict=True))
    (folder / "log.csv").write_text(f"time [us],position_roll [rad]\n{rows}")
    return folder / "log.csv"


def parquet(folder: Path, time_us: np.ndarray) -> Path:
    schema = pa.schema([pa.field("time", pa.float64(), metadata={"unit": "us"}), pa.field("position_roll", pa.float64())])
    pq.write_table(pa.table({"time": time_us, "position_roll": POSITION_rad}, schema=schema), folder / "log.parquet")
    return folder / "log.parquet"


def matlab(folder: Path, time_us: np.ndarray) -> Path:
    scipy.io.savemat(folder / "log.mat", {"time": time_us, "position_roll": POSITION_rad})
    return folder / "log.mat"


@pytest.mark.parametrize("write", [csv_file, parquet, matlab])
def test_a_counter_of_microseconds_that_runs_over_is_told_in_seconds(
    write: Callable[[Path, np.ndarray], Path], carm: Machine, tmp_path: Path
) -> None:
    recording, said = read(write(tmp_path, (2.0**32 - 5e5 + 1e6 * TIME_s) % 2.0**32), carm)
    assert f"the clock was set back by {2.0**32 * 1e-6:.6g} s" in said
    assert f"is taken to go on {1.0 / RATE_Hz:.6g} s later" in said
    np.testing.assert_allclose(recording.time - recording.time[0], TIME_s, atol=1e-6)
    np.testing.assert_array_equal(recording["position_roll"], POSITION_rad)


def mdf(path: Path, name: str, unit: str, scale: float, version: str, kind: int = 1) -> Path:
    """Positions over seconds, and in a second group currents over another base."""
    with MDF(version=version) as file:
        file.append([Signal(POSITION_rad, TIME_s, unit="rad", name="position_roll")])
        file.append([Signal(2.0 * POSITION_rad, scale * TIME_s, unit="A", name="current_roll")])
        base = file.groups[1].channels[0]
        base.name = name
        if version < "4":
            base.conversion.unit = unit
        else:
            base.unit, base.sync_type = unit, kind
        file.save(path, overwrite=True)
    return path


@pytest.mark.parametrize(("name", "version"), [("two.mf4", "4.10"), ("two.mdf", "3.30")])
@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6)])
def test_groups_of_an_mdf_may_count_time_in_different_units(
    name: str, version: str, unit: str, scale: float, carm: Machine, tmp_path: Path
) -> None:
    recording, said = read(mdf(tmp_path / name, "time", unit, scale, version), carm)
    np.testing.assert_allclose(recording.time, TIME_s, atol=1e-12)
    np.testing.assert_allclose(recording["current_roll"][1:-1], 2.0 * POSITION_rad[1:-1], atol=1e-9)
    assert f"group 1: time [{unit}] is its time base, which the standard has in s: taken in {unit}" in said


def test_samples_of_an_mdf_over_an_angle_have_no_time(carm: Machine, tmp_path: Path) -> None:
    recording, said = read(mdf(tmp_path / "angle.mf4", "phi", "deg", 1.0, "4.10", kind=2), carm)
    assert "current_roll" not in recording
    assert "not taken: current_roll: over an angle, phi [deg] of group 1" in said


def test_an_mdf_without_a_time_base_is_refused_with_the_way_out(carm: Machine, tmp_path: Path) -> None:
    path = tmp_path / "none.mf4"
    with MDF(version="4.10") as file:
        file.append([Signal(POSITION_rad, TIME_s, unit="rad", name="position_roll")])
        file.groups[0].channels[0].channel_type = 0
        file.save(path, overwrite=True)
    with pytest.raises(
        RecordingError, match=r"no numeric signals with a time; others: without a time base in group 0; of a \.csv, --map NAME=time"
    ):
        read_recording(path, carm)
