"""Logs whose stamps and order disagree: the known signal comes back, with a word on what was done, or the log is refused with its rows."""

from __future__ import annotations

import json
import shutil
import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import pytest
from asammdf import MDF, Signal
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from test_bags import bag, joint_state

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

STEP_S = 0.005
START_ns = 1_760_000_000_000_000_000
COUNT = 1e-4  # rad between neighbouring samples of the known signal: its value says which sample it is
EACH = settings(max_examples=examples(40), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

Sample = tuple[int, float]  # stamp [us], number of the sample


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def csv_file(folder: Path, samples: list[Sample], carm: Machine) -> Path:
    path = folder / "log.csv"
    path.write_text("time [s],position_roll [rad]\n" + "".join(f"{stamp * 1e-6!r},{COUNT * k!r}\n" for stamp, k in samples))
    return path


def json_bag(folder: Path, samples: list[Sample], carm: Machine) -> Path:
    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/arm", "json", 0)
        for stamp, k in samples:
            writer.add_message(channel, START_ns + 1000 * stamp, json.dumps({"position_roll": COUNT * k}).encode(), START_ns)
        writer.finish()
    return path


def mdf(folder: Path, samples: list[Sample], carm: Machine) -> Path:
    path = folder / "log.mf4"
    times = np.array([stamp * 1e-6 for stamp, _ in samples])
    with MDF(version="4.10") as file:
        file.append([Signal(np.array([COUNT * k for _, k in samples]), times, unit="rad", name="position_roll")])
        file.save(path, overwrite=True)
    return path


def candump(folder: Path, samples: list[Sample], carm: Machine) -> Path:
    """A SYNC and the roll drive's answer each; counts say the number of the sample."""
    path = folder / "log.log"
    lines = []
    for stamp, k in samples:
        answer = struct.pack("<Hih", 0x1237, int(k), 0).hex()
        lines += [f"({1760000000 + stamp * 1e-6:.6f}) can0 080#", f"({1760000000 + (stamp + 200) * 1e-6:.6f}) can0 182#{answer}"]
    path.write_text("\n".join(lines) + "\n")
    return path


def frames(samples: list[Sample]) -> list[tuple[int, str, str]]:
    """The same as stamp [us], identifier and bytes, long after the log began: none is before it."""
    found = []
    for stamp, k in samples:
        found += [(10**9 + stamp, "080", ""), (10**9 + stamp + 200, "182", struct.pack("<Hih", 0x1237, int(k), 0).hex(" ").upper())]
    return found


def asc(folder: Path, samples: list[Sample], carm: Machine) -> Path:
    path = folder / "log.asc"
    head = "date Thu Mar 6 09:12:40.000 am 2025\nbase hex  timestamps absolute\nno internal events logged\n"
    lines = [f"{at * 1e-6:.6f} 1  {name}             Rx   d {len(data.split())} {data}".rstrip() for at, name, data in frames(samples)]
    path.write_text(head + "\n".join(lines) + "\n")
    return path


def trc(folder: Path, samples: list[Sample], carm: Machine) -> Path:
    path = folder / "log.trc"
    head = [";$FILEVERSION=2.1", ";$STARTTIME=45722.3838", ";$COLUMNS=N,O,T,B,I,d,R,L,D"]
    each = enumerate(frames(samples), 1)
    lines = [f"{n:7d} {at * 1e-3:13.3f} DT 1 {int(name, 16):04X} Rx - {len(data.split())} {data}".rstrip() for n, (at, name, data) in each]
    path.write_text("\n".join(head + lines) + "\n")
    return path


def ros_bag(folder: Path, samples: list[Sample], carm: Machine) -> Path:
    """Logged in this order, a millisecond apart, whatever the stamps say."""
    place = folder / "bag"
    shutil.rmtree(place, ignore_errors=True)
    messages = []
    for number, (stamp, k) in enumerate(samples):
        sent = joint_state(START_ns + 1000 * stamp, ["roll"], [COUNT * k])
        messages.append(("/joint_states", START_ns + number * 1_000_000, sent))
    return bag(place, messages)


WRITERS: dict[str, Callable[[Path, list[Sample], Machine], Path]] = {
    "csv": csv_file, "mcap": json_bag, "mf4": mdf, "candump": candump, "asc": asc, "trc": trc, "bag": ros_bag,
}  # fmt: skip
PERIOD_us = dict.fromkeys(WRITERS, 5000) | dict.fromkeys(("candump", "asc", "trc"), 3906)


def read(path: Path, carm: Machine) -> tuple[Recording | None, str]:
    """Return the recording, or None where it is refused, and what was said, without the path, in which the test's name is."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            recording = read_recording(path, carm)
        except RecordingError as refusal:
            return None, str(refusal).replace(str(path), "")
    said = " ".join(str(one.message) for one in caught if issubclass(one.category, RecordingWarning))
    return recording, said.replace(str(path), "")


def numbers(recording: Recording, carm: Machine) -> np.ndarray:
    """Return which samples the rows are."""
    position = recording["position_roll"]
    if "statusword_roll" in recording:
        scaling = carm.bus.scalings[1]
        return position / (scaling.sign * scaling.position_resolution)
    return position / COUNT


@st.composite
def disorders(draw: st.DrawFn, step_us: int) -> tuple[str, list[Sample]]:
    """A log of a known signal, disturbed in one way.

    No clock is set back by as much as puts what follows right before the log's start: frames alone do not tell that from two files joined
    in the wrong order.
    """
    rows = draw(st.integers(60, 120))
    samples: list[Sample] = [(step_us * k, k) for k in range(rows)]
    kind = draw(st.sampled_from(["none", "shuffled", "near", "block", "twice", "gap", "back", "forth"]))
    at = draw(st.integers(10, rows - 10))
    match kind:
        case "shuffled":
            samples = draw(st.permutations(samples))
        case "near":
            places = np.arange(rows) + np.array(draw(st.lists(st.integers(0, 4), min_size=rows, max_size=rows)))
            samples = [samples[k] for k in np.argsort(places, kind="stable")]
        case "block":
            samples = samples[at:] + samples[:at]
        case "twice":
            many = draw(st.integers(1, 9))
            samples = samples[: at + many] + samples[at:]
        case "gap":
            samples = samples[:at] + samples[at + draw(st.integers(1, 9)) :]
        case "back" | "forth":
            by_us = draw(st.integers(2 * step_us, 100 * step_us).filter(lambda by: abs(by - rows * step_us) > 2 * step_us))
            by_us *= -1 if kind == "back" else 1
            samples = samples[:at] + [(stamp + by_us, k) for stamp, k in samples[at:]]
    return kind, samples


@pytest.mark.parametrize("form", WRITERS)
@EACH
@given(data=st.data())
def test_any_disorder_is_recovered_or_said(form: str, carm: Machine, tmp_path: Path, data: st.DataObject) -> None:
    step_us = PERIOD_us[form]
    kind, samples = data.draw(disorders(step_us))
    recording, said = read(WRITERS[form](tmp_path, samples, carm), carm)
    disturbed = samples != sorted(samples) or kind in ("gap", "forth")
    if recording is None:
        assert "first" in said or "have the same stamp" in said
        assert any(word in said for word in ("row", "line", "message", "sample", "frame")), said
        return
    known = np.isfinite(recording["position_roll"])
    which = np.rint(numbers(recording, carm)[known])
    steps = np.rint(np.diff(recording.time[known]) / (step_us * 1e-6))
    assert np.all(np.diff(which) >= 1.0), (kind, which)  # no row before its time, none twice, no two stretches mixed
    elsewhere = np.diff(which) == 1.0
    assert np.count_nonzero(steps[elsewhere] != 1.0) <= (kind in ("back", "forth")), (kind, steps)
    if disturbed:
        words = said.replace("not taken: the PDOs' 6040", "")
        assert any(word in words for word in ("order", "twice", "of earlier ones", "missing", "another", "clock", "put in")), (kind, said)


def two_senders(second_every: int, phase_ns: int, frame: str = "") -> list[tuple[str, int, object]]:
    """200 Hz of the known signal, and a second sender that says 0 at a lower rate."""
    messages = [
        ("/joint_states", START_ns + k * 5_000_000, joint_state(START_ns + k * 5_000_000, ["roll"], [0.3 + COUNT * k])) for k in range(200)
    ]
    for k in range(0, 200, second_every):
        stamp = START_ns + k * 5_000_000 + phase_ns
        second = joint_state(stamp, ["roll"], [0.0])
        second.header.frame_id = frame  # type: ignore[attr-defined]
        messages.append(("/joint_states", stamp, second))
    return sorted(messages, key=lambda one: one[1])


@pytest.mark.parametrize("phase_ns", [-1_700_000, 0, 2_500_000])
@pytest.mark.parametrize("every", [1, 4, 5])
@pytest.mark.parametrize("frame", ["", "panel"])
def test_two_senders_of_a_joint_are_refused_with_the_option_that_takes_one(
    carm: Machine, tmp_path: Path, every: int, phase_ns: int, frame: str
) -> None:
    folder = bag(tmp_path / "bag", two_senders(every, phase_ns, frame))
    recording, said = read(folder, carm)
    assert recording is None
    assert "senders" in said
    options = [word.split("=")[0].strip("'") for word in said.split() if word.startswith("'/joint_states.position[roll]@")]
    assert len(options) == 2
    taken = []
    for option in options:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)
            taken.append(read_recording(folder, carm, {option: "position_roll"})["position_roll"])
    first, second = sorted(taken, key=lambda values: -values.max())
    np.testing.assert_allclose(first, 0.3 + COUNT * np.arange(200), atol=1e-12)
    np.testing.assert_array_equal(second, np.zeros(len(range(0, 200, every))))


def test_messages_without_a_stamp_among_others_stay_where_they_were_logged(carm: Machine, tmp_path: Path) -> None:
    messages = [
        ("/joint_states", START_ns + k * 5_000_000 + 300_000, joint_state(0 if k == 7 else START_ns + k * 5_000_000, ["roll"], [COUNT * k]))
        for k in range(20)
    ]
    recording, _ = read(bag(tmp_path / "bag", messages), carm)
    assert recording is not None
    np.testing.assert_allclose(recording.time, STEP_S * np.arange(20), atol=1e-9)


def test_another_clock_tells_a_clock_that_was_set_on_from_rows_that_are_missing(carm: Machine, tmp_path: Path) -> None:
    set_on = [
        ("/joint_states", START_ns + k * 5_000_000, joint_state(START_ns + k * 5_000_000 + 10**9 * (k >= 30), ["roll"], [COUNT * k]))
        for k in range(60)
    ]
    recording, said = read(bag(tmp_path / "set", set_on), carm)
    assert recording is not None
    np.testing.assert_allclose(recording.time, STEP_S * np.arange(60), atol=1e-9)
    assert "the stamps leap by 1.005 s at message 30" in said


def test_stamps_coarser_than_the_rows_are_spread(carm: Machine, tmp_path: Path) -> None:
    recording, said = read(csv_file(tmp_path, [(10_000 * (k // 2), k) for k in range(80)], carm), carm)
    assert recording is not None
    np.testing.assert_allclose(np.diff(recording.time), STEP_S, atol=1e-9)
    assert "coarser than the lines" in said


def test_two_runs_in_one_file_are_not_joined(carm: Machine, tmp_path: Path) -> None:
    first, second = [(5000 * k, k) for k in range(60)], [(2500 + 5000 * k, 5000 + k) for k in range(60)]
    recording, said = read(csv_file(tmp_path, first + second, carm), carm)
    assert recording is None
    assert "do not go on from line 61 to 62: several runs" in said


def test_frames_logged_twice_are_taken_once(carm: Machine, tmp_path: Path) -> None:
    path = candump(tmp_path, [(3906 * k, k) for k in range(50)], carm)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line for one in lines for line in (one, one)) + "\n")
    recording, said = read(path, carm)
    assert recording is not None
    np.testing.assert_array_equal(np.rint(numbers(recording, carm)), np.arange(50))
    assert "100 frames logged twice" in said or "50 frames logged twice" in said


def test_a_sync_that_was_lost_costs_no_row(carm: Machine, tmp_path: Path) -> None:
    path = candump(tmp_path, [(3906 * k, k) for k in range(50)], carm)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line for place, line in enumerate(lines) if place not in (40, 60)) + "\n")
    recording, said = read(path, carm)
    assert recording is not None
    np.testing.assert_array_equal(np.rint(numbers(recording, carm)), np.arange(50))
    assert "2 SYNCs missing" in said


def test_a_second_node_with_the_drives_answer_is_refused(carm: Machine, tmp_path: Path) -> None:
    path = candump(tmp_path, [(3906 * k, k) for k in range(50)], carm)
    lines = []
    for line in path.read_text().splitlines():
        lines.append(line)
        if "182#" in line:
            lines.append(line.split("#")[0] + "#" + struct.pack("<Hih", 0x1237, 0, 0).hex())
    path.write_text("\n".join(lines) + "\n")
    recording, said = read(path, carm)
    assert recording is None
    assert "182 comes twice to a SYNC, with other contents, in 49 of 50 rows, first row 1" in said


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".log"])
def test_a_clock_set_back_in_a_can_log_of_any_format(carm: Machine, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"bus{suffix}"
    with can.Logger(path) as logger:
        for k in range(200):
            start = 100.0 + k / 256.0 - 0.35 * (k >= 90)
            logger(can.Message(timestamp=start, arbitration_id=0x80, is_extended_id=False, channel=0))
            answer = struct.pack("<Hih", 0x1237, k, 0)
            logger(can.Message(timestamp=start + 3e-4, arbitration_id=0x182, data=answer, is_extended_id=False, channel=0))
    recording, said = read(path, carm)
    assert recording is not None
    np.testing.assert_array_equal(np.rint(numbers(recording, carm)), np.arange(200))
    np.testing.assert_allclose(recording.time, np.arange(200) / 256.0, atol=1e-9)
    assert "clock was set back by 0.3" in said


def test_values_tell_a_clock_that_was_set_from_files_that_were_joined_in_the_wrong_order(carm: Machine, tmp_path: Path) -> None:
    set_back = [(5000 * (k if k < 20 else k - 60), k) for k in range(60)]
    joined = [(5000 * k, k) for k in [*range(40, 60), *range(40)]]
    for samples, words in ((set_back, "clock was set back"), (joined, "put in the order of their stamps")):
        recording, said = read(csv_file(tmp_path, samples, carm), carm)
        assert recording is not None
        np.testing.assert_array_equal(np.rint(numbers(recording, carm)), np.arange(60))
        assert words in said


def test_a_clock_that_was_set_back_and_on_again_leaves_no_trace(carm: Machine, tmp_path: Path) -> None:
    for place, by in enumerate((60_000, 61_000, 300_000)):
        folder = tmp_path / str(place)
        folder.mkdir()
        samples = [(5000 * k - by * (50 <= k < 90), k) for k in range(140)]
        recording, said = read(csv_file(folder, samples, carm), carm)
        assert recording is not None
        np.testing.assert_array_equal(np.rint(numbers(recording, carm)), np.arange(140))
        np.testing.assert_allclose(np.diff(recording.time), STEP_S, atol=1e-9)
        assert "set back" in said
        assert "set on again" in said


def test_rows_that_are_missing_in_a_bag_are_said(carm: Machine, tmp_path: Path) -> None:
    stamps = [START_ns + k * 5_000_000 for k in range(60) if not 20 <= k < 30]
    messages = [("/joint_states", stamp, joint_state(stamp, ["roll"], [float(k)])) for k, stamp in enumerate(stamps)]
    recording, said = read(bag(tmp_path / "bag", messages), carm)
    assert recording is not None
    assert "about 10 rows of 0.005 s missing in 1 place, first 0.055 s after row 19" in said


@pytest.mark.parametrize("phase", [0.3, 0.7])
def test_syncs_of_another_sender_that_nobody_answers_are_left_out(carm: Machine, tmp_path: Path, phase: float) -> None:
    path = candump(tmp_path, [(3906 * k, k) for k in range(50)], carm)
    extra = [f"({1760000000 + (k + phase) * 3906e-6:.6f}) can0 080#" for k in range(49)]
    path.write_text("\n".join(sorted([*path.read_text().splitlines(), *extra])) + "\n")
    recording, said = read(path, carm)
    assert recording is not None
    np.testing.assert_array_equal(np.rint(numbers(recording, carm)), np.arange(50))
    assert "SYNCs between two of the period, which no node answered" in said


@pytest.mark.parametrize("form", ["csv", "mf4"])
def test_rows_of_two_senders_in_a_table_are_refused(form: str, carm: Machine, tmp_path: Path) -> None:
    mine = [(5000 * k, k) for k in range(200)]
    path = WRITERS[form](tmp_path, sorted([*mine, *((stamp + 1300, 9000) for stamp, _ in mine[::4])]), carm)
    recording, said = read(path, carm)
    assert recording is None
    assert "the values jump there and back 50 times, first at" in said


def test_a_noisy_column_is_no_second_sender(carm: Machine, tmp_path: Path) -> None:
    """Uneven stamps, a position that creeps, and a measured time with spikes."""
    rng = np.random.default_rng(8)
    stamps = np.cumsum(rng.uniform(0.001, 0.02, 300))
    spikes = np.where(rng.random(300) < 0.1, 0.5, 1e-4 * rng.random(300))
    position = np.round(1e3 * np.cumsum(rng.normal(0.0, 1e-4, 300))) * 1e-3
    rows = "".join(f"{t!r},{q!r},{w!r}\n" for t, q, w in zip(stamps.tolist(), position.tolist(), spikes.tolist(), strict=True))
    (tmp_path / "log.csv").write_text(f"time [s],position_roll [rad],work_time [s]\n{rows}")
    recording, said = read(tmp_path / "log.csv", carm)
    assert recording is not None
    assert said == ""
