"""CAN logs of Vector, BUSMASTER, PEAK and candump: the same frames in each give the same recording; what is no frame is counted."""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import can
import numpy as np
import pytest
from bus_ticks import PERIOD_S, START_S, Frame, roll_current, tick_frames
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import answer_or_refusal

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, read_recording

TICKS = 12
FILES = settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
ASC_HEAD = "date Thu Mar 6 09:12:40.000 am 2025\nbase hex  timestamps absolute\nno internal events logged\n"


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def read(path: Path, machine: Machine | None) -> tuple[Recording, list[str]]:
    """The recording, and what its reader said was not taken."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        recording = read_recording(path, machine)
    return recording, recording.metadata["source"].get("not_taken", [])


def is_the_run(recording: Recording, carm: Machine, ticks: int = TICKS) -> None:
    roll = carm.bus.scalings[1]
    np.testing.assert_allclose(recording.time, np.arange(ticks) * PERIOD_S, atol=1e-12)
    np.testing.assert_allclose(recording["current_roll"], roll_current(ticks, roll.rated, roll.sign), atol=1e-12)
    np.testing.assert_allclose(recording["command_roll"], 10 * roll_current(ticks, roll.rated, roll.sign), atol=1e-12)
    np.testing.assert_allclose(recording["sync_lateness"], 0.0, atol=3e-6)


def spaced(data: bytes) -> str:
    return data.hex(" ").upper()


# ---- candump ---------------------------------------------------------------------------------------------------------------------


def plain(frame: Frame) -> str:
    return f"can0  {frame[1]:03X}   [{len(frame[2])}]  {spaced(frame[2])}"


def seconds(time_s: float) -> str:
    return f"({int(time_s):03d}.{round(time_s % 1 * 1e6):06d})"


def absolute(frames: list[Frame]) -> list[str]:
    return [f" ({START_S + frame[0]:.6f})  {plain(frame)}" for frame in frames]


def filed(frames: list[Frame]) -> list[str]:
    return [f"({START_S + time_s:.6f}) can0 {can_id:03X}#{data.hex().upper()}" for time_s, can_id, data in frames]


def dated(frames: list[Frame]) -> list[str]:
    return [f" ({datetime.fromtimestamp(START_S + frame[0], UTC):%Y-%m-%d %H:%M:%S.%f})  {plain(frame)}" for frame in frames]


def from_zero(frames: list[Frame]) -> list[str]:
    return [f" {seconds(frame[0])}  {plain(frame)}" for frame in frames]


def differences(frames: list[Frame]) -> list[str]:
    before = itertools.chain([frames[0]], frames)
    return [f" {seconds(frame[0] - last[0])}  {plain(frame)}" for last, frame in zip(before, frames, strict=False)]


def with_directions(frames: list[Frame]) -> list[str]:
    return [f" {seconds(frame[0])}  can0  RX - -  {plain(frame).removeprefix('can0  ')}" for frame in frames]


def with_letters(frames: list[Frame]) -> list[str]:
    return [f"{line}   '{'.' * len(frame[2])}'" for line, frame in zip(from_zero(frames), frames, strict=True)]


def turned_round(frames: list[Frame]) -> list[str]:
    heads = [line.partition("]")[0] for line in from_zero(frames)]
    return [f"{head}]  {frame[2][::-1].hex('`').upper()}" for head, frame in zip(heads, frames, strict=True)]


def in_bits(frames: list[Frame]) -> list[str]:
    heads = [line.partition("]")[0] for line in from_zero(frames)]
    return [f"{head}]  {' '.join(f'{byte:08b}' for byte in frame[2])}" for head, frame in zip(heads, frames, strict=True)]


def in_colours(frames: list[Frame]) -> list[str]:
    return [f"\x1b[32m{line}\x1b[0m" for line in from_zero(frames)]


@pytest.mark.parametrize(
    "printed", [absolute, dated, from_zero, differences, with_directions, with_letters, in_colours, turned_round, in_bits]
)
def test_what_candump_prints_is_read_with_any_time_stamp(
    carm: Machine, tmp_path: Path, printed: Callable[[list[Frame]], list[str]]
) -> None:
    path = tmp_path / "dump.log"
    path.write_text("\n".join(printed(tick_frames(TICKS))) + "\n")
    is_the_run(read(path, carm)[0], carm)


def test_without_time_stamps_syncs_are_counted_and_without_a_machine_there_are_no_rows(carm: Machine, tmp_path: Path) -> None:
    path = tmp_path / "dump.log"
    path.write_text("\n".join(f"  {plain(frame)}" for frame in tick_frames(TICKS)) + "\n")
    with pytest.warns(RecordingWarning, match="has no time stamps; SYNCs are counted"):
        recording = read_recording(path, carm)
    np.testing.assert_allclose(recording.time, np.arange(TICKS) * PERIOD_S)
    assert np.isnan(recording["sync_lateness"]).all()
    with pytest.raises(RecordingError, match="has no time stamps: let `candump -t a` print them"):
        read_recording(path)


def test_differences_are_said_to_be_summed(carm: Machine, tmp_path: Path) -> None:
    path = tmp_path / "dump.log"
    path.write_text("\n".join(differences(tick_frames(TICKS))))
    with pytest.warns(RecordingWarning, match=r"its time stamps are differences \(candump -t d\), which were summed"):
        read_recording(path, carm)


def test_candumps_other_rows_are_counted(carm: Machine, tmp_path: Path) -> None:
    path = tmp_path / "dump.log"
    lines = from_zero(tick_frames(TICKS))
    lines[9:9] = [
        " (000.011000)  can0  702   [1]  remote request",
        " (000.011100)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME",
        "\tcontroller-problem{rx-error-warning}",
        " (000.011200)  can0  1F0  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B",
        " (000.011300)  can0  00000182   [2]  00 00",
        " (000.011400)  can1  182   [2]  00 00",
        " (000.011500)  can0  581   [8]  43 00 10 00 00 00 00 00",
    ]
    path.write_text("\n".join(lines))
    recording, not_taken = read(path, carm)
    is_the_run(recording, carm)
    assert {
        "1 error frame", "1 remote frame", "1 CAN FD frame", "1 frame with 29-bit identifiers", "1 frame of can1",
        "1 frame that the machine's PDO maps do not name (581)",
    } <= set(not_taken)  # fmt: skip
    bare, _ = read(path, None)
    assert bare.rows == 3 * TICKS + 5
    np.testing.assert_array_equal(bare["can_length"][bare["can_fd"] == 1], [12])


@pytest.mark.parametrize(("form", "kept"), [(absolute, 9), (absolute, 40), (filed, 9), (filed, 27)])
def test_a_log_whose_writer_was_killed_is_read_up_to_there(
    form: Callable[[list[Frame]], list[str]], kept: int, carm: Machine, tmp_path: Path
) -> None:
    path = tmp_path / "dump.log"
    lines = form(tick_frames(TICKS))
    path.write_text("\n".join([*lines, lines[-1][:kept]]))
    with pytest.warns(RecordingWarning, match=rf"line {len(lines) + 1}, the last, is cut off \(.*\) and was left out"):
        is_the_run(read_recording(path, carm), carm)
    path.write_text("\n".join([*lines, lines[-1][:kept], lines[-1]]))
    with pytest.raises(RecordingError, match=f"line {len(lines) + 1}: "):
        read_recording(path, carm)


def test_frames_that_candump_dropped_are_counted(carm: Machine, tmp_path: Path) -> None:
    path = tmp_path / "dump.log"
    lines = absolute(tick_frames(TICKS))
    for place, many in ((9, 3), (20, 1)):
        lines.insert(place, f"DROPCOUNT: dropped {many} CAN frame{'s' if many > 1 else ''} on 'can0' socket (total drops {many})")
    path.write_text("\n".join(lines) + "\n")
    with pytest.warns(RecordingWarning, match="4 frames that candump itself dropped, by its own count"):
        is_the_run(read_recording(path, carm), carm)


def test_a_log_of_busmasters_own_is_sent_to_its_converter(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    path.write_text("***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n")
    with pytest.raises(RecordingError, match=r"a log of BUSMASTER; let it convert the log to \.asc"):
        read_recording(path)


# ---- ASC -------------------------------------------------------------------------------------------------------------------------


def asc(frames: list[Frame], start_s: float = 0.0) -> list[str]:
    return [f" {start_s + time_s:.6f} 1  {can_id:X}             Rx   d {len(data)} {spaced(data)}" for time_s, can_id, data in frames]


def classic_in_fd_lines(frames: list[Frame]) -> list[str]:
    return [
        f"   {time_s:.6f} CANFD   1 Rx        {can_id:X}                                   0 0 {len(data):x} {len(data):2} {spaced(data)}"
        "   102000  103   200000 0 46500250 460a0250 20011736 20010205"
        for time_s, can_id, data in frames
    ]


def test_python_cans_asc_is_read(carm: Machine, tmp_path: Path) -> None:
    with can.ASCWriter(tmp_path / "bus.asc") as writer:
        for time_s, can_id, data in tick_frames(TICKS):
            writer(can.Message(timestamp=START_S + time_s, arbitration_id=can_id, data=data, is_extended_id=False, channel=0))
    is_the_run(read(tmp_path / "bus.asc", carm)[0], carm)


@pytest.mark.parametrize(
    "text",
    [
        ASC_HEAD + "// version 7.1.0\n" + "\n".join(asc(tick_frames(TICKS), 30010.0)),
        ASC_HEAD.replace("hex", "HEX") + "Begin Triggerblock Thu Mar 6 09:12:40 am 2025\n   0.000000 Start of measurement\n"
        + "\n".join(asc(tick_frames(TICKS))) + "\nEnd TriggerBlock\n",
        "\n".join(asc(tick_frames(TICKS))),
        "date Don Mär 6 09:12:40 2025\nbase hex  timestamps absolute\n" + "\n".join(asc(tick_frames(TICKS))),
        ASC_HEAD + "\n".join(classic_in_fd_lines(tick_frames(TICKS))),
    ],
    ids=["time of day", "trigger block", "no header", "short header", "classic frames in lines of CAN FD"],
)  # fmt: skip
def test_variants_of_asc_give_the_same_recording(carm: Machine, tmp_path: Path, text: str) -> None:
    path = tmp_path / "bus.asc"
    path.write_text(text, encoding="latin-1")
    recording, not_taken = read(path, carm)
    is_the_run(recording, carm)
    assert not [what for what in not_taken if "line" in what]


def test_asc_with_decimal_numbers_and_relative_time_stamps(carm: Machine, tmp_path: Path) -> None:
    frames = tick_frames(TICKS)
    before = itertools.chain([frames[0]], frames)
    lines = [
        f" {time_s - last[0]:.6f} 1  {can_id}   Rx   d {len(data)} {' '.join(map(str, data))}"
        for last, (time_s, can_id, data) in zip(before, frames, strict=False)
    ]
    lines.insert(4, " 0.000000 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%")
    path = tmp_path / "bus.asc"
    path.write_text("base dec  timestamps relative\nno internal events logged\n" + "\n".join(lines))
    recording, not_taken = read(path, carm)
    is_the_run(recording, carm)
    assert any(what.startswith("1 line that is no frame (line 7: ") for what in not_taken)


def test_asc_rows_that_are_no_frames_of_the_bus_are_counted(carm: Machine, tmp_path: Path) -> None:
    lines = asc(tick_frames(TICKS))
    lines[5:5] = [
        " 0.004900 1  202             TxRq d 4 0F 00 FF 7F",
        " 0.005000 1  ErrorFrame",
        " 0.005100 1  702             Rx   r",
        " 0.005200 CANFD   1 Rx        1F0                                   1 0 9 12 00 01 02 03 04 05 06 07 08 09 0A 0B"
        "   102000  103     3000 0 46500250 460a0250 20011736 20010205",
        " 0.005300 CAN 1 Status:chip status error active",
    ]  # fmt: skip
    path = tmp_path / "bus.asc"
    path.write_text(ASC_HEAD + "\n".join(lines))
    recording, not_taken = read(path, carm)
    is_the_run(recording, carm)
    assert {"1 transmit request", "1 error frame", "1 remote frame", "1 CAN FD frame"} <= set(not_taken)
    assert any("1 line that is no frame (line 13: '0.005300 CAN 1 Status" in what for what in not_taken)


# ---- TRC -------------------------------------------------------------------------------------------------------------------------


def trc(version: str, frames: list[Frame]) -> list[str]:
    """Rows as PEAK's description of the format has them, with a remote frame, and status rows where the version has some."""
    rows = []
    for number, (time_s, can_id, data) in enumerate(frames, 1):
        ms = f"{time_s * 1e3:10.3f}"
        match version:
            case "1.0":
                rows.append(f"{number:6}) {ms}  {can_id:04X} {len(data)}  {spaced(data)}")
            case "1.1":
                rows.append(f"{number:6}) {ms}  Rx         {can_id:04X}  {len(data)}  {spaced(data)}")
            case "1.2":
                rows.append(f"{number:6}) {ms} 1  Rx         {can_id:04X}  {len(data)}  {spaced(data)}")
            case "1.3":
                rows.append(f"{number:6}) {ms} 1  Rx        {can_id:04X} -  {len(data)}    {spaced(data)}")
            case "2.0":
                rows.append(f"{number:7} {ms} DT     {can_id:04X} Rx {len(data)}  {spaced(data)}")
            case _:
                rows.append(f"{number:7} {ms} DT 1      {can_id:04X} Rx -  {len(data)}    {spaced(data)}")
    return rows


HEADS = {
    "1.0": [],
    "1.1": [";$FILEVERSION=1.1", ";$STARTTIME=45722.3838"],
    "1.2": [";$FILEVERSION=1.2", ";$STARTTIME=45722.3838"],
    "1.3": [";$FILEVERSION=1.3", ";$STARTTIME=45722.3838"],
    "2.0": [";$FILEVERSION=2.0", ";$STARTTIME=45722,3838", ";$COLUMNS=N,O,T,I,d,l,D"],
    "2.1": [";$FILEVERSION=2.1", ";$STARTTIME=45722.3838", ";$COLUMNS=N,O,T,B,I,d,R,L,D"],
}
OTHERS = {
    "1.0": (["    90)      11.0  0702 1  RTR", "    91)      11.1  FFFFFFFF 4  00 00 00 08"], {"1 remote frame", "1 status row"}),
    "1.1": (["    90)      11.0  Rx         0702  1  RTR", "    91)      11.1  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY"],
            {"1 remote frame", "1 warning"}),
    "1.2": (["    90)      11.0 1  Rx         0702  1  RTR", "    91)      11.1 1  Error      0001  4  02 01 08 00"],
            {"1 remote frame", "1 error row"}),
    "1.3": (["    90)      11.0 1  Rx        0702 -  1    RTR", "    91)      11.1 1  Warng FFFFFFFF -  4    00 00 00 08  BUSHEAVY"],
            {"1 remote frame", "1 warning"}),
    "2.0": (["     90      11.000 RR     0702 Rx 1", "     91      11.100 ST     Rx    00 00 00 08", "     92      11.2 FB 01F0 Rx 12 "
             + spaced(bytes(12))], {"1 remote frame", "1 status row", "1 CAN FD frame"}),
    "2.1": (["     90      11.000 RR 1      0702 Rx -  1", "     91      11.100 EC 1         - Rx -  2    00 01",
             "     92      11.150 ER 1         - Rx -  5    04 00 02 00 00", "     93      11.180 EV 1  User-defined event"],
            {"1 remote frame", "1 row of error counters", "1 error frame", "1 event"}),
}  # fmt: skip


@pytest.mark.parametrize("version", HEADS)
def test_every_version_of_trc_gives_the_same_recording_and_counts_other_rows(carm: Machine, tmp_path: Path, version: str) -> None:
    rows = trc(version, tick_frames(TICKS))
    others, said = OTHERS[version]
    rows[9:9] = others
    path = tmp_path / "bus.trc"
    path.write_text("\r\n".join([*HEADS[version], ";   Start time: 06.03.2025 09:12:40.000.0", ";---", *rows, ""]))
    recording, not_taken = read(path, carm)
    is_the_run(recording, carm)
    assert said <= set(not_taken)


def test_python_cans_trc_is_read(carm: Machine, tmp_path: Path) -> None:
    with can.TRCWriter(tmp_path / "bus.trc") as writer:
        for time_s, can_id, data in tick_frames(TICKS):
            writer(can.Message(timestamp=START_S + time_s, arbitration_id=can_id, data=data, is_extended_id=False, channel=1))
    is_the_run(read(tmp_path / "bus.trc", carm)[0], carm)


@pytest.mark.parametrize(
    ("suffix", "text", "message"),
    [
        (".trc", ";$FILEVERSION=3.0\n", r"version 3\.0 of TRC; 1\.0, 1\.1"),
        (".trc", "\n".join([*HEADS["2.1"], *trc("2.1", tick_frames(1)), "  9  1.0 XX 1 0181 Rx - 0"]), "line 7: .* is no row of a TRC log"),
        (".trc", "\n".join([*HEADS["1.1"], "  1)  1.0  Rx  0181  8  00 11"]), r"line 3: .* is no row of a TRC log of version 1\.1"),
        (".trc", "\n".join([*HEADS["1.1"], "  1)  1.0  Rx  01G1  1  00"]), r"line 3: .* is no frame of a \.trc log"),
        (".asc", ASC_HEAD + " 0.1 1  EngineData  Rx d 1 00\n", r"line 4: '0\.1 1  EngineData  Rx d 1 00' is no frame of a \.asc log"),
        (".asc", ASC_HEAD + " 0.1 1  181  Rx d 1 GG\n", "line 4"),
        (".asc", ASC_HEAD, "holds no frames"),
        (".trc", "", "holds no frames"),
    ],
)  # fmt: skip
def test_a_text_log_that_is_none_is_one_line(carm: Machine, tmp_path: Path, suffix: str, text: str, message: str) -> None:
    path = tmp_path / f"bus{suffix}"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message) as refusal:
        read_recording(path, carm)
    assert "\n" not in str(refusal.value)


# ---- BLF -------------------------------------------------------------------------------------------------------------------------


def test_a_blf_with_fd_and_error_frames_beside_is_read_and_they_are_counted(carm: Machine, tmp_path: Path) -> None:
    with can.BLFWriter(tmp_path / "bus.blf") as writer:
        for time_s, can_id, data in tick_frames(TICKS):
            at = {"timestamp": START_S + time_s, "is_extended_id": False, "channel": 0}
            writer(can.Message(arbitration_id=can_id, data=data, **at))
            if can_id == 0x202:
                writer(can.Message(arbitration_id=0x182, data=bytes(64), is_fd=True, bitrate_switch=True, **at))
                writer(can.Message(is_error_frame=True, **at))
    recording, not_taken = read(tmp_path / "bus.blf", carm)
    is_the_run(recording, carm)
    assert {f"{TICKS} CAN FD frames", f"{TICKS} error frames"} <= set(not_taken)


# ---- anything --------------------------------------------------------------------------------------------------------------------

LINES = {
    ".log": [*absolute(tick_frames(2)), *from_zero(tick_frames(2)), *dated(tick_frames(1)), "(0.1) can0 181#00", "\t", "can0 1 [0]"],
    ".asc": [*ASC_HEAD.splitlines(), *asc(tick_frames(2)), *classic_in_fd_lines(tick_frames(1)), " 1.0 1 ErrorFrame"],
    ".trc": [*itertools.chain(*HEADS.values()), *(row for version in HEADS for row in trc(version, tick_frames(1))), ";$COLUMNS=N"],
}  # fmt: skip


@pytest.mark.parametrize("suffix", LINES)
@FILES
@given(data=st.data())
def test_any_text_is_a_recording_or_refused_in_one_line(carm: Machine, tmp_path: Path, suffix: str, data: st.DataObject) -> None:
    lines = data.draw(st.lists(st.sampled_from(LINES[suffix]) | st.text(max_size=60), max_size=12))
    text = "\n".join(lines)
    if text:
        place = data.draw(st.integers(0, len(text) - 1))
        text = text[:place] + data.draw(st.text(max_size=2)) + text[place + 1 :]
    path = tmp_path / f"any{suffix}"
    path.write_text(text, encoding="utf-8", errors="replace")
    for machine in (carm, None):
        recording, refusal = answer_or_refusal(RecordingError, read, path, machine)
        assert (refusal is None and recording[0].rows > 0) or re.fullmatch(r".+", refusal)
