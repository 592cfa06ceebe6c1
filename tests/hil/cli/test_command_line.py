"""The command line's manners: help with an example everywhere, JSON and nothing else where JSON is asked for, exit statuses."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Never

import can
import numpy as np
import pytest
import typer.main
from bench_machines import edited
from command_line import Isocenter
from places import EDS_FILES
from typer.core import TyperCommand, TyperGroup

from hil.cli import register
from hil.cli.app import app
from hil.cli.run import ExperimentGroup
from hil.machine import list_shipped, load_machine
from hil.recording import read_recording
from hil.terminal.output import plain
from virtual_bus.canopen.bare import BareMachine

register.commands(app)


def _commands(command: ExperimentGroup | TyperCommand | TyperGroup, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every command and group below the app, as the words that call it."""
    yield path
    for name, child in getattr(command, "commands", {}).items():
        yield from _commands(child, (*path, name))


COMMANDS = list(_commands(typer.main.get_command(app)))


def test_every_command_of_the_contract_is_there() -> None:
    names = {" ".join(words) for words in COMMANDS}
    wanted = (
        "demo, effects, emulate, scan-bus, home, simulate, compare, identify, shape, convert, machine list, machine show, machine check"
    )
    wanted += ", machine export, machine convert, run multisine, run scan, run jog, run static, run file"
    assert set(wanted.split(", ")) <= names


@pytest.mark.slow
@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: " ".join(words) or "isocenter")
def test_help_names_an_example_that_is_a_call_of_this_command(isocenter: Isocenter, words: tuple[str, ...]) -> None:
    shown = isocenter(*words, "--help")
    assert shown.status == 0
    assert shown.err == ""
    if not words:
        assert "isocenter bench" in shown.out
        return
    assert "Example" in shown.out
    examples = [line.split("Example:")[1].split() for line in shown.out.splitlines() if "Example:" in line]
    called = [example[1 : 1 + len(words)] for example in examples if example[:1] == ["isocenter"]]
    assert list(words) in called or (words == ("run", "file") and called), examples


def test_the_list_of_commands_is_that_of_the_whole_command_line(isocenter: Isocenter) -> None:
    """Only a command that is called is made with its parameters; the others are listed all the same."""
    whole = typer.main.get_command(app)
    shown = isocenter("--help").out.split("Commands:\n")[1]
    assert [line.split()[0] for line in shown.splitlines()] == list(whole.commands)
    for name, command in whole.commands.items():
        assert f"  {name:12s} {command.get_short_help_str(60)[:40]}" in shown


def test_a_group_without_a_command_shows_its_help(isocenter: Isocenter) -> None:
    for words in ((), ("run",), ("machine",)):
        shown = isocenter(*words)
        assert "Commands" in shown.out + shown.err


def test_python_m_hil_is_isocenter() -> None:
    done = subprocess.run([sys.executable, "-m", "hil", "machine", "nonsense"], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("isocenter: machine: No such command 'nonsense'")
    assert done.stderr.count("\n") == 1


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording of the C-arm."""
    from hil.cli import main

    path = tmp_path_factory.mktemp("recorded") / "run.mf4"
    with pytest.raises(SystemExit) as left:
        main(["run", "static", "-m", "carm", "-b", "lockstep:", "--seconds", "0.5", "-o", str(path)])
    assert left.value.code == 0
    return path


ANSWERS = {
    "machine list": ("machine", "list"),
    "machine show": ("machine", "show", "carm"),
    "machine check": ("machine", "check", "carm"),
    "machine export": ("machine", "export", "emps", "--mjcf", "emps.xml"),
    "machine convert": ("machine", "convert", "turntable", "--rate", "400", "-o", "turntable.toml"),
    "effects": ("effects",),
    "home": ("home", "-m", "carm", "-b", "lockstep:"),
    "move": ("move", "-m", "carm", "-b", "lockstep:", "--to", "roll=2"),
    "run": ("run", "static", "-m", "carm", "-b", "lockstep:", "--seconds", "0.2", "-o", "still.mf4"),
    "simulate": ("simulate", "carm", "RECORDED", "-o", "simulated.csv"),
    "compare": ("compare", "RECORDED", "RECORDED"),
    "convert": ("convert", "RECORDED", "converted.csv"),
}


@pytest.mark.slow
@pytest.mark.parametrize("arguments", ANSWERS.values(), ids=ANSWERS.keys())
def test_json_to_standard_output_is_all_that_goes_there(
    isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, recorded: Path, arguments: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [str(recorded) if word == "RECORDED" else word for word in arguments]
    answered = isocenter(*words, "--json", "-")
    assert answered.status == 0, answered.err
    assert json.loads(answered.out)
    assert answered.err  # what a person would read


def test_json_to_a_file_leaves_standard_output_to_the_person(isocenter: Isocenter, tmp_path: Path) -> None:
    answered = isocenter("machine", "list", "--json", tmp_path / "machines.json")
    assert "carm" in answered.out
    assert answered.err == ""
    assert [entry["name"] for entry in json.loads((tmp_path / "machines.json").read_text())] == list(list_shipped())


def test_json_has_no_nan_and_knows_arrays_paths_and_dataclasses() -> None:
    from drivers.canopen.scan import FoundNode
    from drivers.settings import Identity

    node = FoundNode(5, 0x20192, "a drive", Identity(1, 2, None, None), "operational", "")
    document = plain({"a": np.array([1.0, np.nan]), "b": (np.float32(0.5), float("inf")), "c": Path("x"), "node": vars(node)})
    assert document["a"] == [1.0, None]
    assert document["b"] == [0.5, None]
    assert document["c"] == "x"
    assert document["node"]["identity"] == {"vendor_id": 1, "product_code": 2, "revision_number": None, "serial_number": None}
    json.dumps(document, allow_nan=False)


@pytest.mark.slow
def test_a_check_that_fails_is_status_1_with_the_whole_answer(isocenter: Isocenter, tmp_path: Path) -> None:
    """Four times the propeller's gain is stable at rest, but far from 40 degrees and 6 dB everywhere."""
    eager = tmp_path / "eager.toml"
    eager.write_text(edited(r"\[1141.398991, -1138.601009", "[4565.595964, -4554.404036"))
    checked = isocenter("machine", "check", eager, "--json", "-")
    document = json.loads(checked.out)
    assert checked.status == 1
    assert document["ok"] is False
    assert any(not finding["ok"] for finding in document["findings"])
    assert "FAIL" in checked.err


class Devices:
    """Bare devices on a python-can `virtual` channel, served by a thread."""

    def __init__(self, channel: str, *devices: tuple[str, int]) -> None:
        self._stop = threading.Event()
        buses = [can.Bus(channel, interface="virtual") for _ in devices]
        machines = [BareMachine(EDS_FILES / eds, node_id) for eds, node_id in devices]
        for bus, machine in zip(buses, machines, strict=True):
            machine.connect(lambda can_id, data, bus=bus: bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False)))
            machine.power_on()

        def serve() -> None:
            while not self._stop.is_set():
                for bus, machine in zip(buses, machines, strict=True):
                    message = bus.recv(0.002)
                    machine.idle(0.002)
                    if message is not None:
                        machine.receive(message.arbitration_id, bytes(message.data))
            for bus in buses:
                bus.shutdown()

        self._thread = threading.Thread(target=serve)

    def __enter__(self) -> Devices:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()


def test_scan_bus_lists_who_is_there_for_people_and_programs(isocenter: Isocenter) -> None:
    with Devices("there", ("isocenter_drive.eds", 5), ("isocenter_encoder.eds", 9)):
        scanned = isocenter("scan-bus", "--bus", "virtual:there", "--json", "-")
    assert scanned.status == 0
    nodes = json.loads(scanned.out)["nodes"]
    assert [(node["node_id"], node["identity"]["product_code"]) for node in nodes] == [(5, 0x49534F01), (9, 0x49534F02)]
    assert "node 5" in scanned.err
    assert "node 9" in scanned.err


def test_scan_bus_finds_two_devices_with_one_id(isocenter: Isocenter) -> None:
    with Devices("twins", ("isocenter_drive.eds", 5), ("isocenter_encoder.eds", 5)):
        scanned = isocenter("scan-bus", "--bus", "virtual:twins")
    assert scanned.status == 2
    assert "node id 5: two devices" in scanned.line


def test_scan_bus_says_when_nobody_answers(isocenter: Isocenter) -> None:
    scanned = isocenter("scan-bus", "--bus", "virtual:empty")
    assert scanned.status == 1
    assert "virtual:empty: nobody answers" in scanned.line


def test_what_a_reader_of_recordings_warns_of_is_one_line(isocenter: Isocenter, recorded: Path, tmp_path: Path) -> None:
    """A recording whose loop and recorder were killed: only its journal is there."""
    from hil.recording.journal import Journal, part_path

    recording = read_recording(recorded)
    path = tmp_path / "killed.mf4"
    channels = [(name, channel.unit) for name, channel in recording.channels.items()]
    with Journal.create(part_path(path), channels, recording.metadata) as journal:
        journal.append(recording.matrix(recording.channels))
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        compared = isocenter("compare", path, path)
    assert compared.status == 0
    lines = compared.err.splitlines()
    assert lines
    assert all(line == f"isocenter: {path}: was not closed; 128 rows read from killed.mf4.part" for line in lines)


def test_an_interrupt_is_answered_in_one_line(isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> Never:
        raise KeyboardInterrupt

    monkeypatch.setattr("hil.machine.list_shipped", interrupted)
    left = isocenter("machine", "list")
    assert left.status == 1
    assert left.err == "isocenter: interrupted\n"


@pytest.mark.slow
def test_the_chain_from_run_to_convert(isocenter: Isocenter, tmp_path: Path) -> None:
    """run, simulate, compare, identify, convert: files of one step go into the next, and what comes out is the machine that went in."""
    recording = tmp_path / "run.mf4"
    experiment = ("--lines", "3,5,7,11", "--amplitude", "0.4", "--jog", "0", "--period", "2", "--periods", "2", "--realisations", "2")
    ran = isocenter(
        *(
            "run",
            "multisine",
            "-m",
            "carm",
            "-b",
            "lockstep:",
            "--pose",
            "roll=30",
            *experiment,
            "--seed",
            "1",
            "-o",
            recording,
            "--json",
            "-",
        )
    )
    assert ran.status == 0, ran.err
    paths = [entry["recording"] for entry in json.loads(ran.out)["recordings"]]
    assert [Path(path).name for path in paths] == [f"run_r{r}_e{e}.mf4" for r in (1, 2) for e in (1, 2)]

    simulated = tmp_path / "simulated.mf4"
    assert isocenter("simulate", "carm", paths[0], "-o", simulated).status == 0
    compared = isocenter("compare", paths[0], simulated, "--json", "-")
    channels = json.loads(compared.out)["channels"]
    assert channels["position_roll"]["nrmse"] < 0.02
    assert channels["current_roll"]["nrmse"] < 0.1
    assert channels["current_roll"]["lag_rows"] == 0

    identified = isocenter("identify", *paths, "-o", tmp_path / "carm.frf.npz")
    assert identified.status == 0, identified.err
    with np.load(tmp_path / "carm.frf.npz") as frf:
        assert frf["frequencies_Hz"].tolist() == [1.5, 2.5, 3.5, 5.5]

    table = tmp_path / "run.csv"
    assert isocenter("convert", paths[0], table).status == 0
    again = tmp_path / "simulated_again.mf4"
    assert isocenter("simulate", "carm", table, "-o", again).status == 0
    one, other = read_recording(simulated), read_recording(again)
    assert all(np.array_equal(one[name], other[name], equal_nan=True) for name in one.channels)
    assert read_recording(table)["position_roll"].tolist() == read_recording(paths[0])["position_roll"].tolist()


@pytest.mark.slow
def test_effects_at_the_command_line_are_physics_of_the_emulated_machine_and_of_the_simulation(
    isocenter: Isocenter, tmp_path: Path
) -> None:
    effects = tmp_path / "effects.toml"
    effects.write_text('[[effect]]\nname = "coulomb_friction"\nat = "roll"\nFc_Nm = 12.0\n')
    run = ("run", "jog", "-m", "carm", "-b", "lockstep:", "--period", "5", "--periods", "1", "--amplitude", "1", "--no-noise")
    rough, known = tmp_path / "rough.mf4", tmp_path / "known.mf4"
    assert isocenter(*run, "--effects", effects, "-o", rough).status == 0
    for options, target in (((), known), (("--effects", effects), tmp_path / "with.mf4")):
        assert isocenter("simulate", "carm", rough, *options, "-o", target).status == 0
    without, with_friction = (
        json.loads(isocenter("compare", rough, path, "--json", "-").out)["channels"]["current_roll"]
        for path in (known, tmp_path / "with.mf4")
    )
    assert without["rms"] > 0.15
    assert with_friction["rms"] < 0.05 * without["rms"] + 0.02


@pytest.mark.slow
def test_convert_reads_a_mat_whose_variables_are_named_otherwise(isocenter: Isocenter, tmp_path: Path) -> None:
    import scipy.io

    time_s = np.arange(100) / 256.0
    scipy.io.savemat(tmp_path / "lab.mat", {"t": time_s, "q": np.sin(time_s), "gain": 3.0})
    said = ("--map", "t=time", "--map", "q=position_roll")
    assert isocenter("convert", tmp_path / "lab.mat", tmp_path / "lab.csv", "--machine", "carm", *said).status == 0
    recording = read_recording(tmp_path / "lab.csv")
    assert recording.channel("position_roll").unit == "rad"
    assert np.array_equal(recording["position_roll"], np.sin(time_s))
    unnamed = isocenter("convert", tmp_path / "lab.mat", tmp_path / "lab.csv", "--machine", "carm")
    assert unnamed.status == 2
    assert "say which is which" in unnamed.line
    for wrong, says in (("t", "NAME=CHANNEL"), ("t=", "NAME=CHANNEL"), ("x=time", "no variable x"), ("q=position_elbow", "position_elbow")):
        refused = isocenter("convert", tmp_path / "lab.mat", tmp_path / "lab.csv", "--machine", "carm", "--map", "t=time", "--map", wrong)
        assert refused.status == 2, refused.line
        assert says in refused.line, refused.line
    refused = isocenter("convert", tmp_path / "lab.csv", tmp_path / "lab.mf4", "--map", "t=time")
    assert refused.status == 2
    assert "no variable t; it has time, position_roll" in refused.line


def test_convert_takes_a_file_of_names_and_lists_what_it_could_not_take(isocenter: Isocenter, tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text("Zeit;Winkel;Strom [mA];Notiz\n0;1,5;3;gut\n5;2,5;4;gut\n")
    (tmp_path / "names.toml").write_text(
        '[channels]\nZeit = "time [ms]"\nWinkel = { channel = "position_roll", unit = "deg", scale = -1 }\n'
    )
    named = ("--map", tmp_path / "names.toml", "--map", "Strom=current_roll", "--machine", "carm")
    done = isocenter("convert", tmp_path / "lab.csv", tmp_path / "lab.mcap", *named, "--json", "-")
    assert done.status == 0, done.err
    answer = json.loads(done.out)
    assert answer["channels"] == {"time": "s", "position_roll": "rad", "current_roll": "A"}
    assert answer["names"] == {"Zeit": "time", "Winkel": "position_roll", "Strom": "current_roll"}
    assert answer["not_taken"] == ["Notiz: line 2: 'gut' is no number"]
    assert "not taken: Notiz: " in done.err
    recording = read_recording(tmp_path / "lab.mcap")
    np.testing.assert_allclose(recording["position_roll"], -np.radians([1.5, 2.5]))
    np.testing.assert_allclose(recording["current_roll"], [3e-3, 4e-3])


def test_a_shipped_machine_file_is_printed_to_begin_one_of_your_own(isocenter: Isocenter, tmp_path: Path) -> None:
    done = isocenter("machine", "show", "turntable", "--toml")
    assert done.status == 0
    (tmp_path / "mine.toml").write_text(done.out)
    assert load_machine(tmp_path / "mine.toml").text.rstrip() == load_machine("turntable").text.rstrip()


def test_the_version_is_that_of_the_distribution(isocenter: Isocenter) -> None:
    done = isocenter("--version")
    assert (done.status, done.out) == (0, f"isocenter {version('isocenter')}\n")
