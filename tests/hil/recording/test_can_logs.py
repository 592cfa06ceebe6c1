"""CAN logs as recordings: frames written by python-can and candump's own lines, PDOs packed here by hand."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import numpy as np
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import DATA, needs_data
from refusals import answer_or_refusal

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import FrameLog, RecordingWarning, convert, read_recording

CONFORMANCE = DATA / "canopen" / "canopennode_cct_conformance.log"
PERIOD_S = 1.0 / 256.0
START_S = 1.7e9  # a Unix time: what logs of real buses begin with
FILES = settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def tick(k: int, carm: Machine, status: int = 0x1237, counts: int | None = None) -> list[tuple[int, bytes]]:
    """Frames of one tick: SYNC, what propeller and roll drive and the roll encoder answer, and the loop's targets."""
    counts = 100 * k if counts is None else counts
    return [
        (0x080, b""),
        (0x181, struct.pack("<Hih", status, -counts, -k)),
        (0x182, struct.pack("<Hih", status, counts, k)),
        (0x18C, struct.pack("<I", carm.bus.scalings[1].link_zero_counts + 1000 + k)),
        (0x201, struct.pack("<Hh", 0x0F, -10 * k)),
        (0x202, struct.pack("<Hh", 0x0F, 10 * k)),
    ]


def messages(ticks: list[int] | range, carm: Machine, times: np.ndarray | None = None) -> list[can.Message]:
    times = START_S + np.array(ticks) * PERIOD_S if times is None else times
    return [
        can.Message(timestamp=time + 1e-4 * place, arbitration_id=can_id, data=data, is_extended_id=False, channel=0)
        for k, time in zip(ticks, times, strict=True)
        for place, (can_id, data) in enumerate(tick(k, carm))
    ]


def write(path: Path, content: list[can.Message]) -> Path:
    with can.Logger(path) as logger:
        for message in content:
            logger(message)
    return path


@pytest.mark.parametrize("suffix", [".log", ".blf"])
def test_pdos_become_rows_per_sync_in_si(carm: Machine, tmp_path: Path, suffix: str) -> None:
    recording = read_recording(write(tmp_path / f"bus{suffix}", messages(range(8), carm)), carm)
    k = np.arange(8)
    propeller, roll = carm.bus.scalings
    np.testing.assert_allclose(recording.time, k * PERIOD_S, atol=1e-12)
    np.testing.assert_allclose(recording["sync_lateness"], 0.0, atol=2e-6)
    np.testing.assert_allclose(recording["command_roll"], roll.sign * 10 * k / 1000 * roll.rated)
    np.testing.assert_allclose(recording["current_propeller"], -propeller.sign * k / 1000 * propeller.rated)
    np.testing.assert_allclose(recording["link_position_roll"], roll.sign * (1000 + k) * roll.link_resolution)
    np.testing.assert_array_equal(recording["statusword_roll"], np.full(8, 0x1237))
    assert {name: channel.unit for name, channel in recording.channels.items()} == {
        "time": "s", "command_propeller": "A", "command_roll": "A", "current_propeller": "A", "current_roll": "A",
        "position_propeller": "rad", "position_roll": "rad", "link_position_propeller": "rad", "link_position_roll": "rad",
        "statusword_propeller": "", "statusword_roll": "", "sync_lateness": "s",
    }  # fmt: skip
    assert np.isnan(recording["link_position_propeller"]).all()


def test_the_motor_side_is_homed_on_the_link_encoder_where_there_is_one(carm: Machine, tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path / "bus.log", messages(range(8), carm)), carm)
    propeller, roll = carm.bus.scalings
    moved = 100 * np.arange(8)
    offset = roll.sign * 1000 * roll.link_resolution
    np.testing.assert_allclose(recording["position_roll"], offset + roll.sign * moved * roll.position_resolution)
    np.testing.assert_allclose(recording["position_propeller"], -propeller.sign * moved * propeller.position_resolution)
    assert recording.metadata["can_log"]["position_offsets"] == {"propeller": 0.0, "roll": offset}


def test_a_frame_that_did_not_come_is_a_missing_sample(carm: Machine, tmp_path: Path) -> None:
    content = messages(range(4), carm)
    assert content.pop(14).arbitration_id == 0x182  # of tick 2
    recording = read_recording(write(tmp_path / "bus.log", content), carm)
    np.testing.assert_array_equal(np.isnan(recording["position_roll"]), [False, False, True, False])
    np.testing.assert_array_equal(np.isnan(recording["position_propeller"]), [False] * 4)


def test_a_skipped_tick_leaves_its_step_in_time(carm: Machine, tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path / "bus.log", messages([0, 1, 2, 5, 6], carm)), carm)
    np.testing.assert_allclose(recording.time / PERIOD_S, [0, 1, 2, 5, 6])
    with pytest.raises(RecordingError, match="between rows 2 and 3"):
        _ = recording.sample_rate_Hz


def test_jitter_and_a_drifting_adapter_clock_lose_no_tick(carm: Machine, tmp_path: Path) -> None:
    ticks = np.arange(2000)
    times = START_S + ticks * PERIOD_S * (1.0 + 200e-6) + np.random.default_rng(2).uniform(-0.3, 0.3, 2000) * PERIOD_S
    content = [can.Message(timestamp=time, arbitration_id=0x080, is_extended_id=False, channel=0) for time in times]
    content.insert(1, can.Message(timestamp=times[0], arbitration_id=0x181, data=bytes(8), is_extended_id=False, channel=0))
    recording = read_recording(write(tmp_path / "bus.log", content), carm)
    np.testing.assert_allclose(recording.time / PERIOD_S, ticks)


def test_counts_that_run_over_32_bits_go_on(carm: Machine, tmp_path: Path) -> None:
    with FrameLog(tmp_path / "bus.log", "vcan0") as log:
        for k, counts in enumerate((2**31 - 2, 2**31 - 1, -(2**31), -(2**31) + 1)):
            log.write(k * PERIOD_S, 0x080, b"")
            log.write(k * PERIOD_S, 0x182, struct.pack("<Hih", 0, counts, 0))
    steps = np.diff(read_recording(tmp_path / "bus.log", carm)["position_roll"])
    np.testing.assert_allclose(steps, carm.bus.scalings[1].sign * carm.bus.scalings[1].position_resolution, rtol=1e-6)


def test_time_stamps_that_are_not_the_buss_are_not_believed_and_that_is_said(carm: Machine, tmp_path: Path) -> None:
    with pytest.warns(RecordingWarning, match=r" ms between SYNCs .* 3\.906 ms by the machine file"):
        recording = read_recording(write(tmp_path / "bus.log", messages(range(4), carm, START_S + np.arange(4) * 1e-3)), carm)
    np.testing.assert_allclose(recording.time / PERIOD_S, np.arange(4))
    assert np.isnan(recording["sync_lateness"]).all()


def test_a_blf_without_a_start_time_and_out_of_order_is_read(carm: Machine, tmp_path: Path) -> None:
    content = messages(range(4), carm, np.arange(4) * PERIOD_S)  # times that are no Unix times: the log's start is written as none
    content[0:12] = content[6:12] + content[0:6]
    with can.BLFWriter(tmp_path / "bus.blf") as writer:
        writer.start_timestamp = 0.0
        for message in content:
            writer(message)
    recording = read_recording(tmp_path / "bus.blf", carm)
    np.testing.assert_allclose(recording.time / PERIOD_S, np.arange(4), atol=1e-9)
    np.testing.assert_array_equal(recording["command_roll"] / carm.bus.scalings[1].rated * 100, np.arange(4))


def test_a_blf_that_was_cut_off_is_refused(tmp_path: Path, carm: Machine) -> None:
    path = write(tmp_path / "bus.blf", messages(range(8), carm))
    size = path.stat().st_size
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(RecordingError, match=f"{size - 50} bytes of {size}; it was cut off"):
        read_recording(path)


def test_an_object_of_length_0_in_a_blf_does_not_read_for_ever(tmp_path: Path, carm: Machine) -> None:
    with can.BLFWriter(tmp_path / "bus.blf", compression_level=0) as writer:
        for message in messages(range(2), carm):
            writer(message)
    content = (tmp_path / "bus.blf").read_bytes()
    second = content.index(b"LOBJ", content.index(b"LOBJ") + 4)  # the first is the container
    (tmp_path / "bus.blf").write_bytes(content[: second + 8] + bytes(4) + content[second + 12 :])
    with pytest.raises(RecordingError, match="an object of length 0"):
        read_recording(tmp_path / "bus.blf")


def test_without_a_machine_the_frames_themselves_are_the_rows(tmp_path: Path) -> None:
    (tmp_path / "bus.log").write_text("(1.5) can0 181#0102 R\n(1.5) can0 1FFFFFFF#R\n(2.0) can1 000#\n(2.1) can0 20000004#00\n")
    recording = read_recording(tmp_path / "bus.log")
    np.testing.assert_array_equal(recording.time, [0.0, 0.0, 0.5])
    np.testing.assert_array_equal(recording["can_id"], [0x181, 0x1FFFFFFF, 0])
    np.testing.assert_array_equal(recording["can_extended"], [0, 1, 0])
    np.testing.assert_array_equal(recording["can_remote"], [0, 1, 0])
    np.testing.assert_array_equal(recording["byte_1"], [2, np.nan, np.nan])
    assert recording.metadata == {
        "kind": "can_frames",
        "buses": ["can0", "can1"],
        "source": {"file": "bus.log", "not_taken": ["1 error frame"]},
    }


@needs_data("canopen", "the conformance trace is")
def test_the_conformance_trace_converts_and_comes_back(tmp_path: Path, carm: Machine) -> None:
    converted = convert(CONFORMANCE, tmp_path / "trace.mf4")
    again = read_recording(tmp_path / "trace.mf4")
    assert again.rows == 17719
    assert int(np.sum(again["can_id"] == 0x604)) == 7352  # grep -c ' 604#'
    np.testing.assert_array_equal(again["byte_7"], converted["byte_7"])
    with pytest.raises(RecordingError, match=r"none of the machine's PDOs in the log \(181, 182, 18B, 18C, 201, 202\)"):
        read_recording(CONFORMANCE, carm)


def test_the_frame_log_is_what_candump_writes(tmp_path: Path) -> None:
    frames = [(0.0, 0x080, b""), (0.003906, 0x181, bytes(range(8))), (1.7e9 + 0.25, 0x1FFFFFFF, b"\xab")]
    with FrameLog(tmp_path / "ours.log", "vcan0") as log:
        for frame in frames:
            log.write(*frame)
    assert (tmp_path / "ours.log").read_text() == (
        "(0.000000) vcan0 080#\n(0.003906) vcan0 181#0001020304050607\n(1700000000.250000) vcan0 1FFFFFFF#AB\n"
    )
    with can.LogReader(tmp_path / "ours.log") as reader:
        assert [(message.timestamp, message.arbitration_id, bytes(message.data)) for message in reader] == frames


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("(0.0) can0 080#\n(0.1) can0 18#00\n", r"line 2: '\(0\.1\) can0 18#00' is no line of candump"),
        ("vcan0  080   [0] 00\n", "line 1: \\[0\\] and 1 bytes"),
        ("vcan0  080\n", "line 1: .*no line of candump"),
        ("(0.0) can0 080#\n (000.1)  can0  080   [0]\n", "line 2: another kind of time stamp"),
        (" (2025-02-30 09:12:40.000000)  can0  080   [0]\n", "line 1: 2025-02-30 09:12:40.000000 is no time"),
        ("(0.0) can0 181#0\n", "line 1"),
        ("(0.0) can0 080#\n\n(0.1) can0 080#\xe9\n", "line 3: no ASCII"),
        ("", "holds no frames"),
        ("(0.0) can0 181#0011223344556677\n", "no SYNC"),
        ("(0.0) can0 080#\n(0.0) can1 080#\n", "SYNCs on can0 and can1"),
        ("(0.0) can0 080#\n(0.0) can0 181#00\n", r"frame 181 after SYNC 0: PDO of 1 bytes where 8 are mapped"),
    ],
)
def test_a_log_that_is_none_is_one_line(carm: Machine, tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "bus.log"
    path.write_text(content, encoding="latin-1")
    with pytest.raises(RecordingError, match=message) as refusal:
        read_recording(path, carm)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_a_machine_without_a_bus_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "bus.log").write_text("(0.0) can0 080#\n")
    with pytest.raises(RecordingError, match="machine emps has no bus"):
        read_recording(tmp_path / "bus.log", load_machine("emps"))


@FILES
@given(st.lists(st.tuples(st.integers(0, 10**9), st.integers(0, 0x7FF), st.binary(max_size=8)), min_size=1, max_size=20))
def test_any_frames_survive_the_frame_log(tmp_path: Path, frames: list[tuple[int, int, bytes]]) -> None:
    frames.sort(key=lambda frame: frame[0])
    with FrameLog(tmp_path / "bus.log", "can0") as log:
        for microseconds, can_id, data in frames:
            log.write(microseconds * 1e-6, can_id, data)
    recording = read_recording(tmp_path / "bus.log")
    np.testing.assert_allclose(recording.time, [(frame[0] - frames[0][0]) * 1e-6 for frame in frames], atol=1e-9)
    np.testing.assert_array_equal(recording["can_id"], [frame[1] for frame in frames])
    np.testing.assert_array_equal(recording["can_length"], [len(frame[2]) for frame in frames])


@FILES
@given(place=st.integers(0, 10_000), byte=st.integers(0, 255), keep=st.integers(0, 10_000), suffix=st.sampled_from([".log", ".blf"]))
def test_a_damaged_log_is_read_or_refused_in_one_line(carm: Machine, tmp_path: Path, place: int, byte: int, keep: int, suffix: str) -> None:
    path = write(tmp_path / f"bus{suffix}", messages(range(3), carm))
    content = bytearray(path.read_bytes())
    content[place % len(content)] = byte
    path.write_bytes(content[: keep + 1])
    _, refusal = answer_or_refusal(RecordingError, read_recording, path)
    assert refusal is None or "\n" not in refusal
