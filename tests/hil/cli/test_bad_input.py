"""Bad input at the command line: exit status 2 (1 where it ran and the answer is bad), one line that helps, nothing recorded is lost."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest
from bench_machines import CARM, LosingBus, edited
from command_line import Isocenter

import hil.bench.wiring
from hil.cli import main
from hil.recording import read_recording

STATIC = ("run", "static", "--seconds", "0.5", "--bus", "lockstep:")
CAN_ONLY = re.sub(r"(?ms)^\[(bus\.(io|imu)|budgets|judging)\b.*?(?=^\[|\Z)", "", CARM.text)


@pytest.fixture
def machine_file(tmp_path: Path) -> Callable[..., Path]:
    def write(text: str) -> Path:
        path = tmp_path / "machine.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "run.mf4"


MACHINES = {
    "no TOML": (edited(r"^name = \"carm\"", 'name = "carm'), ["machine.toml", "no valid TOML"]),
    "unknown key": (edited(r"^speed_deg_s = 60.0", "sped_deg_s = 60.0", count=1), ["limits.propeller", "sped_deg_s", "speed"]),
    "unknown unit": (edited(r"^mass_kg = 60.0", "mass_stone = 9.4"), ["mass_stone", "kg"]),
    "a unit of something else": (edited(r"^speed_deg_s = 60.0", "speed_kg = 60.0", count=1), ["limits.propeller", "speed_kg"]),
    "a value out of bounds": (edited(r"^rated_current_A = 5.0", "rated_current_A = -3.0", count=1), ["rated_current_A", "-3", "positive"]),
    "a controller with too much gain": (
        edited(r"\[\[1141.398991, -1138.601009", "[[22827.97982, -22772.02018", CARM.text.replace("[\n    [1141", "[[1141")),
        ["not stable", "pole radius", "gain"],
    ),
}


@pytest.mark.parametrize(("text", "says"), MACHINES.values(), ids=MACHINES.keys())
def test_a_machine_file_that_is_wrong(
    isocenter: Isocenter, machine_file: Callable[..., Path], out: Path, text: str, says: list[str]
) -> None:
    refused = isocenter(*STATIC, "--machine", machine_file(text), "-o", out)
    assert refused.status == 2, refused.line
    assert all(word in refused.line for word in says), refused.line
    assert not out.exists()


@pytest.mark.parametrize("experiment", [("multisine", "--periods", "1"), ("jog",), ("static",)], ids=["multisine", "jog", "static"])
def test_no_experiment_closes_a_loop_that_is_not_stable(
    isocenter: Isocenter, machine_file: Callable[..., Path], out: Path, experiment: tuple[str, ...]
) -> None:
    unstable = machine_file(MACHINES["a controller with too much gain"][0])
    refused = isocenter("run", *experiment, "--machine", unstable, "--bus", "lockstep:", "-o", out)
    assert refused.status == 2
    assert "not stable" in refused.line
    assert not out.exists()


EXPERIMENTS = {
    "saturating excitation": (("multisine", "--amplitude", "6"), ["would reach", "A", "at most 1.", "would do"]),
    "jog off the grid": (("multisine", "--jog-frequency", "0.07"), ["0.07 Hz", "grid", "nearest"]),
    "period of no whole samples": (("jog", "--period", "0.3"), ["0.3", "samples"]),
    "jog outside the range": (("jog", "--amplitude", "100", "--pose", "roll=0"), ["roll", "range"]),
    "start pose outside the range": (("static", "--pose", "roll=120"), ["roll", "outside"]),
    "axis that is none": (("static", "--pose", "elbow=3"), ["--pose elbow=3", "elbow", "propeller, roll"]),
    "pose that is no number": (("static", "--pose", "roll=up"), ["--pose roll=up", "AXIS=NUMBER"]),
    "excited axis that is none": (("multisine", "--axes", "elbow"), ["elbow", "propeller, roll"]),
    "swept axis that is none": (("scan", "--axis", "elbow", "--from", "0", "--to", "1"), ["--axis elbow", "propeller, roll"]),
    "band that is none": (("multisine", "--band", "high"), ["--band high", "LOW:HIGH"]),
    "lines that are none": (("multisine", "--lines", "3,x"), ["--lines 3,x", "whole numbers"]),
    "line of the jog excited": (("multisine", "--lines", "1,3"), ["line 1", "jog"]),
    "phases of no kind": (("multisine", "--phases", "nice"), ["--phases nice", "random or optimised"]),
    "no time at all": (("static", "--seconds", "0"), ["seconds = 0", "positive"]),
    "too fast a sweep": (("scan", "--axis", "roll", "--from", "-80", "--to", "80", "--speed", "90"), ["speed"]),
    "unknown option": (("static", "--sceonds", "3"), ["--sceonds"]),
    "missing experiment file": (("nothere.toml",), ["nothere.toml", "No such file"]),
    "unknown experiment": (("dance",), ["dance"]),
}


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "says"), EXPERIMENTS.values(), ids=EXPERIMENTS.keys())
def test_an_experiment_that_must_not_be_run(isocenter: Isocenter, out: Path, arguments: tuple[str, ...], says: list[str]) -> None:
    refused = isocenter("run", *arguments, "--machine", "carm", "--bus", "lockstep:", "-o", out)
    assert refused.status == 2, refused.line
    assert all(word in refused.line for word in says), refused.line
    assert not out.exists()


EFFECTS = {
    "unknown effect": ('[[effect]]\nname = "coulomb_fricton"\nat = "roll"\nFc_Nm = 12.0\n', ["coulomb_fricton", "coulomb_friction"]),
    "unknown place": ('[[effect]]\nname = "coulomb_friction"\nat = "elbow"\nFc_Nm = 12.0\n', ["elbow", "roll"]),
    "wrong unit": ('[[effect]]\nname = "coulomb_friction"\nat = "roll"\nFc_kg = 12.0\n', ["Fc"]),
    "missing file": (None, ["effects.toml", "No such file"]),
}


@pytest.mark.parametrize(("text", "says"), EFFECTS.values(), ids=EFFECTS.keys())
def test_effects_that_are_none(isocenter: Isocenter, tmp_path: Path, out: Path, text: str | None, says: list[str]) -> None:
    path = tmp_path / "effects.toml"
    if text is not None:
        path.write_text(text)
    refused = isocenter(*STATIC, "--machine", "carm", "--effects", path, "-o", out)
    assert refused.status == 2, refused.line
    assert all(word in refused.line for word in says), refused.line


BUSES = {
    "missing interface": ("socketcan:vcan7", ["socketcan:vcan7"]),
    "no such kind": ("sockcan:vcan0", ["sockcan", "socketcan"]),
    "no colon": ("lockstep", ["'lockstep'", "lockstep:"]),
    "no group": ("udp:300.1.2.3", ["300.1.2.3"]),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [("home", "-m", "carm"), ("scan-bus",), ("run", "static", "-m", "carm", "-o", "x.mf4"), ("emulate", "carm")]
)
@pytest.mark.parametrize(("url", "says"), BUSES.values(), ids=BUSES.keys())
def test_a_bus_that_is_not_there(
    isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: tuple[str, ...], url: str, says: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    refused = isocenter(*command, "--bus", url)
    assert refused.status == 2, refused.line
    assert all(word in refused.line for word in says), refused.line
    assert list(tmp_path.iterdir()) == []


def test_a_bus_with_nobody_on_it(isocenter: Isocenter, machine_file: Callable[..., Path], out: Path) -> None:
    lonely = machine_file(edited(r"^boot_timeout_s = 2.0", "boot_timeout_s = 0.05", CAN_ONLY))
    refused = isocenter("run", "static", "--machine", lonely, "--bus", "virtual:nobody", "--no-real-time", "-o", out)
    assert refused.status == 2
    assert "propeller_drive (node 1)" in refused.line
    assert not out.exists()


def test_a_machine_whose_imu_and_io_nobody_has_named(isocenter: Isocenter, out: Path) -> None:
    refused = isocenter("run", "static", "--machine", "carm", "--bus", "virtual:nobody", "--no-real-time", "-o", out)
    assert refused.status == 2
    assert "IMU" in refused.line
    assert "isocenter emulate" in refused.line


@pytest.mark.slow
def test_a_node_with_another_identity(isocenter: Isocenter, machine_file: Callable[..., Path], out: Path) -> None:
    wrong = machine_file(edited(r"^product_code = 0x49534F02", "product_code = 0x49534F77"))
    refused = isocenter(*STATIC, "--machine", wrong, "-o", out)
    assert refused.status == 2
    assert not out.exists()
    assert all(word in refused.line for word in ("propeller_encoder", "node 11", "49534F77", "49534F02")), refused.line


@pytest.fixture
def emulated_bus(monkeypatch: pytest.MonkeyPatch) -> Callable[..., object]:
    """Change what hangs on the emulated machine's bus, behind the machine file's back."""

    def change(how: Callable[..., object]) -> None:
        honest = hil.emulated.machine.emulated_bus
        monkeypatch.setattr("hil.emulated.machine.emulated_bus", lambda machine, physics: how(honest(machine, physics)))

    return change


def test_a_node_that_is_absent(isocenter: Isocenter, emulated_bus: Callable[..., object], out: Path) -> None:
    emulated_bus(lambda bus: replace(bus, encoders=bus.encoders[:1]))
    refused = isocenter(*STATIC, "--machine", "carm", "-o", out)
    assert refused.status == 2
    assert "roll_encoder" in refused.line
    assert "node 12" in refused.line
    assert not out.exists()


def test_two_nodes_with_one_id(isocenter: Isocenter, emulated_bus: Callable[..., object], out: Path) -> None:
    emulated_bus(lambda bus: replace(bus, encoders=(*bus.encoders, replace(bus.encoders[1], name="forgotten_encoder"))))
    refused = isocenter(*STATIC, "--machine", "carm", "-o", out)
    assert refused.status == 2
    assert "node 12" in refused.line
    assert "two" in refused.line
    assert not out.exists()


@pytest.mark.slow
def test_a_position_that_stays_away_is_a_bad_answer_and_the_rows_before_it_are_kept(
    isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch, out: Path
) -> None:
    part = out.with_name("run.mf4.part")

    class Failing(LosingBus):
        def waiting_frames(self) -> deque[tuple[int, bytes]]:
            self.lost_ids = (0x182,) if part.exists() and part.stat().st_size > 200_000 else ()
            return super().waiting_frames()

    monkeypatch.setattr("hil.bench.wiring.LockstepBus", Failing)
    stopped = isocenter("run", "static", "--seconds", "6", "--bus", "lockstep:", "--machine", "carm", "-o", out)
    assert stopped.status == 1
    assert "roll: no position for 4 ticks" in stopped.line
    kept = int(re.search(r"(\d+) rows are kept", stopped.line)[1])
    recording = read_recording(out)
    assert recording.rows == kept > 256
    assert np.flatnonzero(recording.channel("position_roll").missing).tolist() == list(range(kept - 4, kept))
    assert not part.exists()


@pytest.mark.slow
def test_a_bus_that_breaks_in_the_run_is_one_line_that_tells_what_the_stop_ran_into_and_the_rows_are_kept(
    isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch, out: Path
) -> None:
    part = out.with_name("run.mf4.part")

    class Breaking(LosingBus):
        def send_frame(self, can_id: int, data: bytes) -> None:
            if part.exists() and part.stat().st_size > 200_000:
                raise can.CanOperationError("the interface went down")
            super().send_frame(can_id, data)

    monkeypatch.setattr("hil.bench.wiring.LockstepBus", Breaking)
    stopped = isocenter("run", "static", "--seconds", "6", "--bus", "lockstep:", "--machine", "carm", "-o", out)
    assert stopped.status == 1
    assert stopped.line.count("the interface went down") == 2
    assert "nobody knows whether it stands: the stop broke off" in stopped.line
    assert "stopping the motors ran into stopping: " in stopped.line
    recording = read_recording(out)
    assert recording.rows > 256
    assert not part.exists()
    assert any("stopping: " in trouble for trouble in recording.metadata["ended"]["stopping"])  # a drive that may hold is left to hold


@pytest.mark.slow
def test_a_run_that_stops_and_cannot_be_written_says_both(isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch, out: Path) -> None:
    part = out.with_name("run.mf4.part")

    class Failing(LosingBus):
        def waiting_frames(self) -> deque[tuple[int, bytes]]:
            if part.exists():
                out.mkdir(exist_ok=True)  # in the recording's place
            self.lost_ids = (0x182,) if part.exists() and part.stat().st_size > 200_000 else ()
            return super().waiting_frames()

    monkeypatch.setattr("hil.bench.wiring.LockstepBus", Failing)
    stopped = isocenter("run", "static", "--seconds", "6", "--bus", "lockstep:", "--machine", "carm", "-o", out)
    assert stopped.status == 1
    assert "roll: no position for 4 ticks" in stopped.line
    assert "rows are kept in run.mf4.part" in stopped.line
    assert read_recording(part).rows > 256


OUTS = {
    "missing folder": ("nowhere/run.mf4", ["nowhere", "there is no folder"]),
    "no format": ("run.xls", [".xls", ".mf4"]),
    "reading only": ("run.mat", [".mat", ".mf4"]),
    "a folder": (".", ["is a folder"]),
}


@pytest.fixture
def enabled(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Identifiers of all frames that enable a drive's operation (CiA 402: controlword xFh), without which no motor moves."""
    ids = []

    class Noting(LosingBus):
        def send_frame(self, can_id: int, data: bytes) -> None:
            if can_id in (0x201, 0x202) and data[0] & 0x0F == 0x0F:
                ids.append(can_id)
            super().send_frame(can_id, data)

    monkeypatch.setattr("hil.bench.wiring.LockstepBus", Noting)
    return ids


@pytest.mark.slow
def test_a_run_enables_the_drives(isocenter: Isocenter, enabled: list[int], out: Path) -> None:
    assert isocenter(*STATIC, "--machine", "carm", "-o", out).status == 0
    assert set(enabled) == {0x201, 0x202}


@pytest.mark.parametrize(("name", "says"), OUTS.values(), ids=OUTS.keys())
def test_a_recording_that_could_not_be_written_is_refused_before_anything_moves(
    isocenter: Isocenter, enabled: list[int], tmp_path: Path, name: str, says: list[str]
) -> None:
    refused = isocenter(*STATIC, "--machine", "carm", "-o", tmp_path / name)
    assert refused.status == 2, refused.line
    assert all(word in refused.line for word in says), refused.line
    assert enabled == []


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch, out: Path) -> Path:
    """A folder gets in the recording's place while it is recorded."""
    part = out.with_name("run.mf4.part")

    class Taking(LosingBus):
        def waiting_frames(self) -> deque[tuple[int, bytes]]:
            if part.exists():
                out.mkdir(exist_ok=True)
            return super().waiting_frames()

    monkeypatch.setattr("hil.bench.wiring.LockstepBus", Taking)
    return out


@pytest.mark.slow
def test_a_recording_that_cannot_be_written_at_the_end_keeps_its_rows_and_is_not_overwritten(
    isocenter: Isocenter, tmp_path: Path, taken: Path
) -> None:
    refused = isocenter(*STATIC, "--machine", "carm", "-o", taken)
    assert refused.status == 2
    assert "128 rows are kept in run.mf4.part" in refused.line
    assert read_recording(tmp_path / "run.mf4.part").rows == 128
    taken.rmdir()
    refused = isocenter(*STATIC, "--machine", "carm", "-o", taken)
    assert refused.status == 2
    assert "128 rows of a recording that was cut short" in refused.line
    assert read_recording(tmp_path / "run.mf4.part").rows == 128


@pytest.mark.parametrize("option", ["--truth", "--frame-log", "--json"])
def test_a_side_file_without_a_folder_is_refused_before_anything_moves(
    isocenter: Isocenter, enabled: list[int], tmp_path: Path, out: Path, option: str
) -> None:
    refused = isocenter(*STATIC, "--machine", "carm", "-o", out, option, tmp_path / "nowhere" / "file")
    assert refused.status == 2
    assert "nowhere" in refused.line
    assert enabled == []


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording as CSV, with its metadata beside it."""
    path = tmp_path_factory.mktemp("recorded") / "run.csv"
    with pytest.raises(SystemExit) as left:
        main([*STATIC, "--machine", "carm", "-o", str(path)])
    assert left.value.code == 0
    return path


HOLES = {
    "a row": (lambda lines: lines[:60] + lines[61:], ["127 rows", "rows = 128"]),
    "the time of a row": (lambda lines: [*lines[:60], "," + lines[60].split(",", 1)[1], *lines[61:]], ["time", "missing"]),
    "the reference of a row": (
        lambda lines: [*lines[:60], re.sub(r"^([^,]*),[^,]*", r"\1,", lines[60]), *lines[61:]],
        ["reference_propeller"],
    ),
    "half a row": (lambda lines: [*lines[:60], lines[60][:40], *lines[61:]], ["run.csv"]),
    "its header": (lambda lines: lines[1:], ["run.csv"]),
    "everything": (lambda lines: [], ["run.csv"]),
}


@pytest.mark.slow
@pytest.mark.parametrize(("cut", "says"), HOLES.values(), ids=HOLES.keys())
def test_a_csv_that_lacks_something(
    isocenter: Isocenter, recorded: Path, tmp_path: Path, cut: Callable[..., object], says: list[str]
) -> None:
    copy = tmp_path / "run.csv"
    copy.write_text("\n".join(cut(recorded.read_text().splitlines())) + "\n")
    copy.with_suffix(".toml").write_text(recorded.with_suffix(".toml").read_text())
    refused = isocenter("simulate", "carm", copy, "-o", tmp_path / "simulation.mf4")
    assert refused.status == 2, refused.line
    assert all(word in refused.line for word in says), refused.line
    assert not (tmp_path / "simulation.mf4").exists()


def test_a_csv_without_metadata_that_lacks_a_row(isocenter: Isocenter, recorded: Path, tmp_path: Path) -> None:
    lines = recorded.read_text().splitlines()
    copy = tmp_path / "run.csv"
    copy.write_text("\n".join(lines[:60] + lines[61:]) + "\n")
    refused = isocenter("simulate", "carm", copy, "-o", tmp_path / "simulation.mf4")
    assert refused.status == 2
    note, error = refused.err.splitlines()
    assert "about 1 row of 0.00390625 s missing in 1 place" in note
    assert "rows are not equally spaced" in error
    assert "between rows 58 and 59" in error


def test_a_csv_with_an_unknown_unit(isocenter: Isocenter, recorded: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run.csv"
    copy.write_text(recorded.read_text().replace("position_roll [rad]", "position_roll [furlong]", 1))
    copy.with_suffix(".toml").write_text(recorded.with_suffix(".toml").read_text())
    refused = isocenter("compare", copy, copy)
    assert refused.status == 2
    assert "furlong" in refused.line
    assert "position_roll" in refused.line


FILES = {
    "simulate": ("simulate", "carm", "nothere.mf4", "-o", "s.mf4"),
    "compare": ("compare", "nothere.mf4", "nothere.mf4"),
    "identify": ("identify", "nothere.mf4", "-o", "f.npz"),
    "convert": ("convert", "nothere.mf4", "b.csv"),
    "machine": ("machine", "check", "nothere.toml"),
    "emulate an EDS": ("emulate", "--eds", "nothere.eds", "--bus", "virtual:x"),
    "emulate a machine": ("emulate", "nothere.toml", "--bus", "virtual:x"),
}


@pytest.mark.parametrize("arguments", FILES.values(), ids=FILES.keys())
def test_a_file_that_is_not_there(
    isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    refused = isocenter(*arguments)
    assert refused.status == 2
    assert "nothere" in refused.line
    assert list(tmp_path.iterdir()) == []


def test_truth_and_frame_log_of_a_real_bus_are_refused_in_words(isocenter: Isocenter, out: Path, tmp_path: Path) -> None:
    for option in ("--truth", "--frame-log"):
        refused = isocenter(
            "run", "static", "--machine", "carm", "--bus", "virtual:nobody", "--no-real-time", "-o", out, option, tmp_path / "file"
        )
        assert refused.status == 2
        assert option in refused.line
        assert not (tmp_path / "file").exists()


def test_a_fault_of_the_program_itself_is_one_line_and_says_how_to_see_more(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.machine.list_shipped", lambda: 1 / 0)
    with pytest.raises(SystemExit) as left:
        main(["machine", "list"])
    error = capsys.readouterr().err
    assert left.value.code == 1
    assert error.count("\n") == 1
    assert "ISOCENTER_TRACEBACK=1" in error
    assert "ZeroDivisionError" in error


def test_a_pose_to_go_to_that_is_none(isocenter: Isocenter) -> None:
    move = ("move", "--machine", "carm", "--bus", "lockstep:", "--to")
    refused = isocenter(*move, "rol=10")
    assert (refused.status, refused.line) == (2, "isocenter: --to rol=10: carm has no axis 'rol'; it has propeller, roll")
    refused = isocenter(*move, "roll=200")
    assert refused.status == 2
    assert "roll = 200 deg is outside -95 deg to 95 deg" in refused.line
