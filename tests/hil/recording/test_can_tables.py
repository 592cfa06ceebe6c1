"""CAN frames in tables of python-can and in MDF 4's bus logging: the same frames give the same recording as any log."""

from __future__ import annotations

import sqlite3
import time
import warnings
from pathlib import Path

import can
import numpy as np
import pytest
from asammdf import MDF, Signal
from bus_ticks import PERIOD_S, START_S, roll_current, tick_frames
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import answer_or_refusal

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

TICKS = 12
SUFFIXES = [".csv", ".db", ".mf4"]
FILES = settings(max_examples=examples(40), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def written(path: Path) -> Path:
    """The ticks, an error frame, a remote frame and one of CAN FD, by python-can."""
    content = [can.Message(START_S + at, can_id, False, data=data, channel=0) for at, can_id, data in tick_frames(TICKS)]
    content.append(can.Message(START_S + 1.0, 0x123, False, is_fd=True, data=bytes(48), channel=0))
    content.append(can.Message(START_S + 1.0, 0x701, False, is_remote_frame=True, dlc=1, channel=0))
    content.append(can.Message(START_S + 1.0, is_error_frame=True, channel=0))
    with can.Logger(path) as logger:
        for message in content:
            logger(message)
        while getattr(logger, "num_frames", len(content)) < len(content):  # the one of SQLite drops what waits when it is closed
            time.sleep(0.01)
    return path


def read(path: Path, machine: Machine | None, names: dict[str, str] | None = None) -> tuple[Recording, list[str]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        recording = read_recording(path, machine, names)
    return recording, recording.metadata["source"].get("not_taken", [])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_frames_are_decoded_and_what_is_no_frame_of_the_machine_is_counted(carm: Machine, tmp_path: Path, suffix: str) -> None:
    recording, not_taken = read(written(tmp_path / f"bus{suffix}"), carm)
    roll = carm.bus.scalings[1]
    np.testing.assert_allclose(recording.time, np.arange(TICKS) * PERIOD_S, atol=1e-12)
    np.testing.assert_allclose(recording["current_roll"], roll_current(TICKS, roll.rated, roll.sign), atol=1e-12)
    np.testing.assert_allclose(recording["sync_lateness"], 0.0, atol=3e-6)
    assert {"1 error frame", "1 remote frame", "1 CAN FD frame"} <= set(not_taken)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_without_a_machine_the_frames_are_the_rows(tmp_path: Path, suffix: str) -> None:
    recording, _ = read(written(tmp_path / f"bus{suffix}"), None)
    assert recording.rows == 3 * TICKS + 2
    np.testing.assert_array_equal(recording["can_id"][:3], [0x080, 0x182, 0x202])
    np.testing.assert_allclose(recording.time[: 3 * TICKS], [at for at, _, _ in tick_frames(TICKS)], atol=1e-6)


def test_beside_signals_frames_are_listed_and_the_signals_taken(carm: Machine, tmp_path: Path) -> None:
    rows = np.arange(4) / 256.0
    with MDF(written(tmp_path / "bus.mf4")) as mdf:
        mdf.append([Signal(rows, rows, unit="A", name="current_roll")])
        mdf.save(tmp_path / "both.mf4")
    recording, not_taken = read(tmp_path / "both.mf4", carm)
    np.testing.assert_array_equal(recording["current_roll"], rows)
    assert [name for name in recording.channels if "CAN" in name] == []
    assert f"CAN frames of group 0: {3 * TICKS + 1} of them, beside signals" in not_taken


def test_a_database_of_something_else_is_refused(carm: Machine, tmp_path: Path) -> None:
    base = sqlite3.connect(tmp_path / "x.db")
    base.execute("CREATE TABLE log (t REAL)")
    base.commit()
    base.close()
    with pytest.raises(RecordingError, match=r"x\.db: has no table `messages` of CAN frames"):
        read_recording(tmp_path / "x.db", carm)
    (tmp_path / "y.db").write_bytes(b"nothing of the kind")
    with pytest.raises(RecordingError, match=r"y\.db: no SQLite file of CAN frames"):
        read_recording(tmp_path / "y.db", carm)


def test_a_damaged_line_is_told(carm: Machine, tmp_path: Path) -> None:
    path = written(tmp_path / "bus.csv")
    path.write_text(path.read_text().replace("0x182", "0xzzz", 1))
    with pytest.raises(RecordingError, match=r"bus\.csv: line 3: .*0xzzz"):
        read_recording(path, carm)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("buses")
    return {suffix: written(folder / f"bus{suffix}").read_bytes() for suffix in SUFFIXES}


@pytest.mark.parametrize("suffix", SUFFIXES)
@FILES
@given(place=st.integers(0, 100_000), bytes_=st.binary(min_size=1, max_size=4))
def test_a_damaged_table_is_read_or_refused_in_one_line(
    carm: Machine, tmp_path: Path, whole: dict[str, bytes], suffix: str, place: int, bytes_: bytes
) -> None:
    content = bytearray(whole[suffix])
    place %= len(content)
    content[place : place + len(bytes_)] = bytes_
    (tmp_path / f"damaged{suffix}").write_bytes(content)
    _, refusal = answer_or_refusal(RecordingError, read, tmp_path / f"damaged{suffix}", carm)
    assert refusal is None or "\n" not in refusal
