"""Several senders, buses, runs or joints in one log: told apart where the file does, and taken by the option that the refusal names."""

from __future__ import annotations

import struct
import warnings
from datetime import UTC, datetime
from pathlib import Path

import can
import numpy as np
import pytest
from asammdf import MDF, Signal, Source
from asammdf.blocks import v4_constants as v4c
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_bags import bag, joint_state

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

ROWS, STEP_S = 200, 1.0 / 256.0
COUNT = 1e-4  # rad from one sample of the known signal to the next
START_ns = 1_760_000_000_000_000_000
EACH = settings(max_examples=examples(12), deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def swing(rows: int = ROWS) -> np.ndarray:
    """A position that goes to and fro, as a machine's does."""
    angle: np.ndarray = 0.02 * np.sin(2.0 * np.pi * np.arange(rows) / 67.0)
    return angle


def read(path: Path, machine: Machine, names: dict[str, str] | None = None) -> tuple[Recording | None, str]:
    """Return the recording, None where it is refused, and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            recording = read_recording(path, machine, names)
        except RecordingError as refusal:
            return None, str(refusal)
    return recording, " ".join(str(one.message) for one in caught if issubclass(one.category, RecordingWarning))


def csv_file(folder: Path, samples: list[tuple[float, float]], head: str = "time [s],position_roll [rad]") -> Path:
    path = folder / "log.csv"
    path.write_text(head + "\n" + "".join(f"{stamp!r},{value!r}\n" for stamp, value in samples))
    return path


def mdf(folder: Path, samples: list[tuple[float, float]]) -> Path:
    path = folder / "log.mf4"
    with MDF(version="4.10") as file:
        stamps, values = (np.array(column) for column in zip(*samples, strict=True))
        file.append([Signal(values, stamps, unit="rad", name="position_roll")])
        file.save(path, overwrite=True)
    return path


@EACH
@given(
    phase=st.sampled_from([0.0, 0.2, 0.3]),
    offset=st.sampled_from([-1e-4, 2e-5, 3e-4, 0.5]),
    noise=st.sampled_from([0.0, 5e-6]),
    seed=st.integers(0, 99),
)
def test_a_second_sender_however_near_is_refused_and_each_can_be_taken(
    carm: Machine, tmp_path: Path, phase: float, offset: float, noise: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    first = swing() + noise * rng.standard_normal(ROWS)
    second = swing() + offset + noise * rng.standard_normal(ROWS)
    samples = [(STEP_S * k, value) for k, value in enumerate(first.tolist())]
    samples += [(STEP_S * (k + phase), value) for k, value in enumerate(second.tolist())]
    path = csv_file(tmp_path, sorted(samples, key=lambda one: one[0]))
    recording, said = read(path, carm)
    assert recording is None, (phase, offset, said)
    assert "two senders of one signal" in said
    for part, truth in (("@1", first), ("@2", second)):
        assert f"{part}=part (200 " in said
        taken, _ = read(path, carm, {part: "part"})
        assert taken is not None
        np.testing.assert_array_equal(taken["position_roll"], truth)


def test_a_signal_of_an_mdf_with_two_senders_is_taken_in_parts(carm: Machine, tmp_path: Path) -> None:
    samples = [(STEP_S * k, value) for k, value in enumerate(swing().tolist())]
    path = mdf(tmp_path, sorted([*samples, *((stamp + 1e-3, 0.4) for stamp, _ in samples[::4])]))
    _, said = read(path, carm)
    assert "@1=part (200 samples) or @2=part (50 samples)" in said
    recording, _ = read(path, carm, {"@1": "part"})
    assert recording is not None
    np.testing.assert_array_equal(recording["position_roll"], swing())


@pytest.mark.parametrize("pattern", [(0.2, 0.8), (0.0, 1.0), (0.3, 0.7), (0.1, 0.2, 0.7)])
@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-4])
def test_one_sender_whose_rows_come_in_bursts_is_one(carm: Machine, tmp_path: Path, pattern: tuple[float, ...], noise: float) -> None:
    steps = np.resize(2.0 * STEP_S * np.array(pattern), ROWS)
    values = swing() + noise * np.random.default_rng(4).standard_normal(ROWS)
    samples = list(zip((np.cumsum(steps) - steps[0]).tolist(), values.tolist(), strict=True))
    recording, said = read(csv_file(tmp_path, samples), carm)
    assert recording is not None, said
    np.testing.assert_array_equal(recording["position_roll"], values)
    assert "missing" not in said or 0.0 in pattern  # its first row is alone at its stamp


@pytest.mark.parametrize("many", [1, 4, 7])
def test_a_few_samples_of_another_sender_are_left_out_and_said(carm: Machine, tmp_path: Path, many: int) -> None:
    samples = [(STEP_S * k, value) for k, value in enumerate(swing().tolist())]
    strange = [(STEP_S * (20 * k + 30.3), 1.0) for k in range(many)]
    recording, said = read(csv_file(tmp_path, sorted([*samples, *strange])), carm)
    assert recording is not None
    np.testing.assert_array_equal(recording["position_roll"], swing())
    assert f"{many} line{'s' if many > 1 else ''} between two of the raster" in said
    assert "first line 33" in said


@pytest.mark.parametrize("turns", [True, False])
def test_a_column_says_whose_the_lines_are(carm: Machine, tmp_path: Path, turns: bool) -> None:
    lines = [(k, name, value + shift) for k, value in enumerate(swing().tolist()) for name, shift in (("arm", 0.0), ("lift", 1e-4))]
    lines = lines if turns else sorted(lines, key=lambda one: one[1])
    path = tmp_path / "log.csv"
    path.write_text("stamp [s],joint,angle [rad]\n" + "".join(f"{STEP_S * k!r},{name},{value!r}\n" for k, name, value in lines))
    names = {"stamp": "time", "angle": "position_roll"}
    _, said = read(path, carm, names)
    assert "column joint says whose a line is; take one with --map 'joint@arm=part' (200 lines) or 'joint@lift=part' (200 lines)" in said
    recording, said = read(path, carm, names | {"joint@lift": "part"})
    assert recording is not None
    np.testing.assert_allclose(recording["position_roll"], swing() + 1e-4, atol=1e-12)
    assert "the 200 lines of joint@lift are taken of 400" in said
    assert "no such line" in read(path, carm, names | {"joint@wrist": "part"})[1]


def test_a_header_that_stands_there_again_is_passed_over(carm: Machine, tmp_path: Path) -> None:
    path = csv_file(tmp_path, [(STEP_S * k, value) for k, value in enumerate(swing().tolist())])
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:80], lines[0], *lines[80:]]) + "\n")
    recording, said = read(path, carm)
    assert recording is not None
    np.testing.assert_array_equal(recording["position_roll"], swing())
    assert "the header stands there again in 1 line, first line 81" in said


def test_runs_written_one_behind_another_are_taken_in_parts(carm: Machine, tmp_path: Path) -> None:
    runs = [swing(), swing(150)[::-1]]  # the second begins where a clock that was set would go on
    path = csv_file(tmp_path, [(STEP_S * k, value) for run in runs for k, value in enumerate(run.tolist())])
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[: ROWS + 1], lines[0], *lines[ROWS + 1 :]]) + "\n")
    recording, said = read(path, carm)
    assert recording is None, said
    assert "the header stands there again before line 203, where the stamps go back: several runs" in said
    assert "@1=part (200 lines) or @2=part (150 lines)" in said
    for part, run in zip(("@1", "@2"), runs, strict=True):
        taken, _ = read(path, carm, {part: "part"})
        assert taken is not None
        np.testing.assert_array_equal(taken["position_roll"], run)
    path.write_text("\n".join([*lines[: ROWS + 1], *lines[: ROWS + 1]]) + "\n")  # one run, twice
    recording, said = read(path, carm)
    assert recording is not None, said
    np.testing.assert_array_equal(recording["position_roll"], swing())


@pytest.mark.parametrize("head", ["frame", "Number", "nr"])
@pytest.mark.parametrize("lost", [0, 3])
def test_a_count_of_the_lines_does_not_say_whose_they_are(carm: Machine, tmp_path: Path, head: str, lost: int) -> None:
    lines = [f"{STEP_S * k!r},{(k + 5) % 16},{value!r}" for k, value in enumerate(swing().tolist()) if not 50 < k <= 50 + lost]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([f"time [s],{head},position_roll [rad]", *lines]) + "\n")
    recording, said = read(path, carm)
    assert recording is not None, said
    np.testing.assert_array_equal(recording["position_roll"], np.delete(swing(), np.s_[51 : 51 + lost]))


@pytest.mark.parametrize("own_times", [True, False])
def test_numbers_of_joints_that_take_turns_are_no_count(carm: Machine, tmp_path: Path, own_times: bool) -> None:
    lines = [
        f"{STEP_S * (k + own_times * joint / 6)!r},{joint},{value + 0.3 * joint!r}"
        for k, value in enumerate(swing().tolist())
        for joint in range(6)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time [s],nr,position_roll [rad]", *lines]) + "\n")
    assert "column nr says whose a line is; take one with --map 'nr@0=part' (200 lines)" in read(path, carm)[1]


def test_a_part_that_is_not_there_is_refused(carm: Machine, tmp_path: Path) -> None:
    path = csv_file(tmp_path, [(STEP_S * k, value) for k, value in enumerate(swing().tolist())])
    assert "there is no part; leave it out" in read(path, carm, {"@1": "part"})[1]
    assert "one is taken at a time" in read(path, carm, {"@1": "part", "@2": "part"})[1]


# ---- stamps ----------------------------------------------------------------------------------------------


@EACH
@given(
    disorder=st.sampled_from(["copied", "back by a step", "on and back", "stamps of zero"]),
    at=st.integers(20, 120),
    many=st.integers(8, 60),
)
def test_copies_and_stamps_that_leave_and_return_are_put_right(carm: Machine, tmp_path: Path, disorder: str, at: int, many: int) -> None:
    samples = [(STEP_S * k, value) for k, value in enumerate(swing().tolist())]
    match disorder:
        case "copied":
            samples = [*samples[: at + many], *samples[at : at + many], *samples[at + many :]]
        case "back by a step":
            samples = [(stamp - STEP_S * (k >= at), value) for k, (stamp, value) in enumerate(samples)]
        case "on and back":
            samples = [(stamp + 0.7 * (at <= k < at + many), value) for k, (stamp, value) in enumerate(samples)]
        case _:
            samples = [(100.0 + stamp if k not in (at, at + many) else 0.0, value) for k, (stamp, value) in enumerate(samples)]
    recording, said = read(csv_file(tmp_path, samples), carm)
    assert recording is not None, said
    np.testing.assert_array_equal(recording["position_roll"], swing())
    np.testing.assert_allclose(np.diff(recording.time), STEP_S, rtol=1e-4)
    assert "of earlier ones" in said or "the clock was set" in said


@pytest.mark.parametrize("rate_Hz", [1001.0, 1010.0, 1020.0, 1024.0, 1100.0])
@pytest.mark.parametrize("disorder", ["none", "jitter", "row lost", "clock set", "quantized"])
def test_stamps_in_whole_milliseconds_keep_the_rate_and_every_row(carm: Machine, tmp_path: Path, rate_Hz: float, disorder: str) -> None:
    rows = 3000
    time_s = np.arange(rows) / rate_Hz
    truth = 0.3 * np.sin(2.0 * np.pi * 3.0 * time_s)
    if disorder == "quantized":
        truth = np.round(truth / 1e-3) * 1e-3
    if disorder == "row lost":
        time_s, truth = np.delete(time_s, 777), np.delete(truth, 777)
    stamps = time_s + 5.0 - 2.0 * (disorder == "clock set") * (time_s > 1.5)
    stamps += 5e-5 * (disorder == "jitter") * np.random.default_rng(3).standard_normal(time_s.size)
    stamps = np.maximum.accumulate(np.floor(1e3 * stamps)) if disorder == "jitter" else np.floor(1e3 * stamps)
    recording, said = read(csv_file(tmp_path, list(zip((stamps / 1e3).tolist(), truth.tolist(), strict=True))), carm)
    assert recording is not None, said
    np.testing.assert_array_equal(recording["position_roll"], truth)
    np.testing.assert_allclose(recording.time - recording.time[0], time_s, atol=2.5e-3)
    assert "coarser than the lines" in said


def test_lines_written_twice_at_an_even_pace_are_no_coarse_clock(carm: Machine, tmp_path: Path) -> None:
    samples = [(STEP_S * k, value) for k, value in enumerate(swing().tolist()) for _ in range(1 + (k % 40 == 20))]
    recording, said = read(csv_file(tmp_path, samples), carm)
    assert recording is not None, said
    np.testing.assert_array_equal(recording["position_roll"], swing())
    assert "5 samples at the time of another left out" in said


def test_a_rest_that_is_stamped_anew_is_no_copy(carm: Machine, tmp_path: Path) -> None:
    truth = np.concatenate([swing(100), np.full(160, swing(101)[-1]), swing(201)[101:]])
    stamps = STEP_S * (np.arange(truth.size) - 40 * (np.arange(truth.size) >= 180))
    recording, said = read(csv_file(tmp_path, list(zip(stamps.tolist(), truth.tolist(), strict=True))), carm)
    assert recording is not None, said
    np.testing.assert_array_equal(recording["position_roll"], truth)
    np.testing.assert_allclose(np.diff(recording.time), STEP_S, rtol=1e-4)
    assert "the clock was set back" in said


def test_the_rest_before_a_second_run_is_the_second_runs(carm: Machine, tmp_path: Path) -> None:
    runs = [np.concatenate([np.full(30, 0.1), 0.1 + way * np.arange(1, 171) * COUNT]) for way in (1.0, -1.0)]
    path = csv_file(tmp_path, [(STEP_S * k, value) for run in runs for k, value in enumerate(run.tolist())])
    assert "@1=part (200 lines) or @2=part (200 lines)" in read(path, carm)[1]
    for part, run in zip(("@1", "@2"), runs, strict=True):
        taken, _ = read(path, carm, {part: "part"})
        assert taken is not None
        np.testing.assert_array_equal(taken["position_roll"], run)


@EACH
@given(share=st.floats(0.02, 0.3), seed=st.integers(0, 99))
def test_rows_that_are_missing_here_and_there_are_told(carm: Machine, tmp_path: Path, share: float, seed: int) -> None:
    kept = np.flatnonzero(np.random.default_rng(seed).random(ROWS) >= share)
    samples = [(STEP_S * k, float(swing()[k])) for k in kept.tolist()]
    recording, said = read(csv_file(tmp_path, samples), carm)
    assert recording is not None
    np.testing.assert_array_equal(recording["position_roll"], swing()[kept])
    lost = int(kept[-1] - kept[0]) + 1 - kept.size
    assert f"about {lost} row{'' if lost == 1 else 's'} of" in said or not lost


@pytest.mark.parametrize("stamps", ["of zero", "that stand still", "of a simulation", "that begin again"])
def test_bags_whose_stamps_say_nothing_go_by_their_times_of_logging(carm: Machine, tmp_path: Path, stamps: str) -> None:
    messages = []
    for k, value in enumerate(swing().tolist()):
        logged = START_ns + k * 4_000_000
        stamp = {"of zero": 0, "that stand still": START_ns, "of a simulation": 4_000_000 * k, "that begin again": 4_000_000 * (k % 80)}
        messages.append(("/joint_states", logged, joint_state(stamp[stamps], ["roll"], [value])))
    recording, said = read(bag(tmp_path / "bag", messages), carm)
    assert recording is not None, said
    np.testing.assert_array_equal(recording["position_roll"], swing())
    np.testing.assert_allclose(np.diff(recording.time), 4e-3, atol=1e-9)
    words = {"that stand still": "199 of 200 messages have no stamp or that of those before", "that begin again": "set back by 0.32 s"}
    assert words.get(stamps, "") in said


def test_joints_in_another_order_are_of_the_same_sender(carm: Machine, tmp_path: Path) -> None:
    messages = []
    for k, value in enumerate(swing().tolist()):
        names = ["roll", "lift"][:: 1 if k % 2 else -1]
        positions = [value if name == "roll" else 0.5 for name in names]
        messages.append(("/joint_states", START_ns + k * 4_000_000, joint_state(START_ns + k * 4_000_000, names, positions)))
    recording, _ = read(bag(tmp_path / "bag", messages), carm)
    assert recording is not None
    np.testing.assert_array_equal(recording["position_roll"], swing())


# ---- CAN -------------------------------------------------------------------------------------------------

Frame = tuple[float, int, bytes, int]  # stamp [s], identifier, data, bus


def frames(bus: int = 0, late_s: float = 3e-4, shift: int = 0) -> list[Frame]:
    """A SYNC and the roll drive's answer each; counts say the number of the sample."""
    found: list[Frame] = []
    for k in range(ROWS):
        found += [(STEP_S * k, 0x80, b"", bus), (STEP_S * k + late_s, 0x182, struct.pack("<Hih", 0x1237, k + shift, 0), bus)]
    return found


def log(folder: Path, those: list[Frame], suffix: str) -> Path:
    path = folder / f"bus{suffix}"
    with can.Logger(path) as logger:
        for stamp, ident, data, bus in those:
            logger(can.Message(timestamp=1000.0 + stamp, arbitration_id=ident, data=data, is_extended_id=False, channel=bus))
    return path


def numbers(recording: Recording | None, carm: Machine) -> np.ndarray:
    """Return which samples the rows are."""
    assert recording is not None
    scaling = carm.bus.scalings[1]
    which: np.ndarray = np.rint(recording["position_roll"] / (scaling.sign * scaling.position_resolution))
    return which


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".log", ".mf4"])
def test_one_of_two_buses_and_of_two_answers_is_taken(carm: Machine, tmp_path: Path, suffix: str) -> None:
    path = log(tmp_path, sorted([*frames(), *frames(bus=1, late_s=4e-4, shift=1000)]), suffix)
    _, said = read(path, carm)
    buses = [word.removesuffix("=part") for word in said.split() if word.endswith("=part")]
    assert len(buses) == 2
    for bus, shift in zip(buses, (0, 1000), strict=True):
        np.testing.assert_array_equal(numbers(read(path, carm, {bus: "part"})[0], carm), np.arange(ROWS) + shift)
    second = [one for one in frames(late_s=5e-4, shift=3) if one[1] != 0x80]
    path = log(tmp_path, sorted([*frames(), *second]), suffix)
    assert "take the first with --map @1=part or the last with @2=part" in read(path, carm)[1]
    for part, shift in (("@1", 0), ("@2", 3)):
        np.testing.assert_array_equal(numbers(read(path, carm, {part: "part"})[0], carm), np.arange(ROWS) + shift)


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".log", ".mf4"])
def test_a_clock_set_back_by_whole_periods_leaves_every_row(carm: Machine, tmp_path: Path, suffix: str) -> None:
    shifted = [(stamp - 64 * STEP_S * (place >= 180), *rest) for place, (stamp, *rest) in enumerate(frames())]
    recording, said = read(log(tmp_path, shifted, suffix), carm)  # type: ignore[arg-type]
    np.testing.assert_array_equal(numbers(recording, carm), np.arange(ROWS))
    assert "the clock was set back by 0.25 s at frame 180" in said


def test_an_mdf_with_a_group_an_identifier_is_in_the_order_of_the_log(carm: Machine, tmp_path: Path) -> None:
    row = [(f"CAN_DataFrame.{name}", kind) for name, kind in (("BusChannel", "u1"), ("ID", "<u4"), ("IDE", "u1"), ("DLC", "u1"))]
    row += [("CAN_DataFrame.DataLength", "u1"), ("CAN_DataFrame.DataBytes", "(64,)u1"), ("CAN_DataFrame.Dir", "u1")]
    row += [(f"CAN_DataFrame.{name}", "u1") for name in ("EDL", "BRS", "ESI")]
    shifted = [(stamp - 0.3 * (place >= 180), ident, data) for place, (stamp, ident, data, _) in enumerate(frames())]
    with MDF(version="4.10") as file:
        file.start_time = datetime(2026, 1, 1, tzinfo=UTC)
        for wanted in (0x80, 0x182):
            mine = [one for one in shifted if one[1] == wanted]
            samples = np.zeros(len(mine), np.dtype(row))
            for k, (_, ident, data) in enumerate(mine):
                padded = np.frombuffer(data.ljust(64, b"\0"), np.uint8)
                samples[k] = (1, ident, 0, len(data), len(data), padded, 0, 0, 0, 0)
            source = Source("CAN_DataFrame", "CAN1", "", v4c.SOURCE_BUS, v4c.BUS_TYPE_CAN)
            file.append([Signal(samples, np.array([stamp for stamp, *_ in mine]), name="CAN_DataFrame", source=source)])
            file.groups[-1].channel_group.flags = v4c.FLAG_CG_BUS_EVENT
        file.save(tmp_path / "bus.mf4", overwrite=True)
    recording, said = read(tmp_path / "bus.mf4", carm)
    np.testing.assert_array_equal(numbers(recording, carm), np.arange(ROWS))
    assert "the clock was set back by 0.3 s at frame 180" in said


def printed(those: list[Frame], form: str) -> str:
    stamps = [f" ({stamp:010.6f})" if form == "count" else "" for stamp, *_ in those]
    words = [" ".join(f"{byte:02X}" for byte in data) for _, _, data, _ in those]
    lines = zip(stamps, those, words, strict=True)
    return "".join(f"{stamp}  can0  {ident:03X}   [{len(data)}]  {text}\n" for stamp, (_, ident, data, _), text in lines)


@pytest.mark.parametrize("name", ["dump.log", "dump.txt"])
def test_counts_that_begin_again_are_no_differences(carm: Machine, tmp_path: Path, name: str) -> None:
    shifted = [(stamp - 0.3 * (place >= 180), *rest) for place, (stamp, *rest) in enumerate(frames())]
    (tmp_path / name).write_text(printed(shifted, "count"))  # type: ignore[arg-type]
    recording, said = read(tmp_path / name, carm)
    np.testing.assert_array_equal(numbers(recording, carm), np.arange(ROWS))
    assert "the clock was set back by 0.299999 s at frame 180" in said
    assert "differences" not in said


def test_logs_without_stamps_hear_of_copies_and_of_a_second_sender(carm: Machine, tmp_path: Path) -> None:
    path = tmp_path / "dump.log"
    path.write_text(printed([one for one in frames() for _ in range(2)], "none"))
    recording, said = read(path, carm)
    np.testing.assert_array_equal(numbers(recording, carm), np.arange(ROWS))
    assert "400 frames logged twice" in said
    both = [two for one in frames() for two in ([one] if one[1] == 0x80 else [one, (one[0], one[1], struct.pack("<Hih", 0x1237, 0, 0), 0)])]
    path.write_text(printed(both, "none"))
    assert "182 comes twice to a SYNC, with other contents, in 199 of 200 rows, first row 1" in read(path, carm)[1]
    np.testing.assert_array_equal(numbers(read(path, carm, {"@1": "part"})[0], carm), np.arange(ROWS))
