"""A new machine file: from answers, with data sheets, with open points, and by questions in a terminal."""

from __future__ import annotations

import io
import json
import sys
import tomllib
from pathlib import Path

import pytest
from command_line import Isocenter, Outcome

from hil.machine import load_machine
from hil.recording import read_recording

ANSWERS = {
    "axes": "turn",
    "turn.mass_kg": "30",
    "turn.inertia_kg_m2": "3.6,3.6,7",
    "turn.constant": "0.095",
    "turn.ratio": "100",
    "turn.limit": "8",
    "turn.damping": "23",
}
ON_A_BUS = {
    "turn.rated": "5",
    "turn.encoder_counts_per_motor_turn": "4096",
    "turn.brake_effort": "100",
    "turn.range_deg": "-90,90",
    "turn.speed_deg_s": "60",
    "turn.link_counts_per_turn": "0x800000",
}
SHEETS = ("--eds", "isocenter_drive.eds", "--eds", "isocenter_encoder.eds")


def new(isocenter: Isocenter, out: Path, answers: dict[str, str], *more: object) -> Outcome:
    given = [part for key, value in answers.items() for part in ("-a", f"{key}={value}")]
    return isocenter("machine", "new", "-o", out, "--no-ask", *given, *more)


def test_answers_make_a_machine_that_passes_its_check(isocenter: Isocenter, tmp_path: Path) -> None:
    out = tmp_path / "table.toml"
    made = new(isocenter, out, ANSWERS)
    assert made.status == 0, made.err
    machine = load_machine(out)
    (body,) = machine.plant.tree.bodies
    assert (machine.name, machine.axes, body.mass_kg, body.joint and body.joint.damping) == ("table", ("turn",), 30.0, 23.0)
    assert machine.plant.drives[0].constant * machine.plant.drives[0].ratio == pytest.approx(9.5)
    checked = isocenter("machine", "check", out)
    assert checked.status == 0, checked.out
    assert "ok   turn: phase margin" in checked.out


def test_what_is_assumed_is_marked_in_the_file_and_told(isocenter: Isocenter, tmp_path: Path) -> None:
    out = tmp_path / "table.toml"
    told = new(isocenter, out, ANSWERS).out
    lines = out.read_text().splitlines()
    marked = [(number, line) for number, line in enumerate(lines, 1) if "# assumed: " in line and not line.startswith("#")]
    assert len(marked) > 5
    checked = isocenter("machine", "check", out).out
    for number, line in marked:
        assert f"line {number}: " in told, line
        assert f"note line {number}: " in checked, line
    assert 'drives.turn.effort_unit = "A" is assumed: current' in told
    assert not any("mass_kg" in line or "ratio" in line for _, line in marked)  # they were given
    assert "controllers are assumed: " in told


@pytest.mark.slow
def test_with_data_sheets_it_homes_and_moves_on_the_emulator(isocenter: Isocenter, tmp_path: Path) -> None:
    out, scan = tmp_path / "table.toml", tmp_path / "scan.csv"
    made = new(isocenter, out, ANSWERS | ON_A_BUS, *SHEETS)
    assert made.status == 0, made.err
    assert "OPEN" not in made.out
    bus = load_machine(out).bus
    assert bus is not None
    drive, encoder = bus.nodes
    assert (drive.identity.product_code, encoder.identity.product_code) == (0x49534F01, 0x49534F02)
    assert isocenter("machine", "check", out).status == 0
    moved = isocenter("run", "scan", "-m", out, "-b", "lockstep:", "--axis", "turn", "--from", "-20", "--to", "20", "-o", scan)
    assert moved.status == 0, moved.err
    position = read_recording(scan)["position_turn"]
    assert position.max() - position.min() == pytest.approx(40.0 * 0.0174533, rel=0.05)


def test_what_nobody_says_is_left_open_and_listed_line_by_line(isocenter: Isocenter, tmp_path: Path) -> None:
    out, document = tmp_path / "table.toml", tmp_path / "check.json"
    told = new(isocenter, out, {"axes": "turn", "turn.mass_kg": "30"}, *SHEETS).out
    lines = out.read_text().splitlines()
    missing = [number for number, line in enumerate(lines, 1) if line.startswith("# ") and " = ? " in line]
    assert len(missing) > 8
    tomllib.loads(out.read_text())  # it is TOML nevertheless
    checked = isocenter("machine", "check", out, "--json", document)
    assert checked.status == 1
    failed = [line for line in checked.out.splitlines() if line.startswith("FAIL")]
    assert [int(line.split()[2].rstrip(":")) for line in failed] == missing
    assert [finding["ok"] for finding in json.loads(document.read_text())["findings"]].count(False) == len(missing)
    assert told.count("OPEN line") == len(missing)
    refused = isocenter("machine", "show", out)
    assert refused.status == 2
    assert f"line {missing[0]}: body.turn_body.inertia_kg_m2 is to be filled in" in refused.line


def test_a_file_whose_open_points_are_filled_in_loads(isocenter: Isocenter, tmp_path: Path) -> None:
    out = tmp_path / "table.toml"
    new(isocenter, out, {key: value for key, value in ANSWERS.items() if key not in ("turn.limit", "turn.constant")})
    text = out.read_text()
    assert text.count(" = ? ") == 2
    out.write_text(text.replace("# limit_A = ?", "limit_A = 8.0  #").replace("# constant = ?", "constant = 0.095  #"))
    assert load_machine(out).plant.drives[0].limit == 8.0


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_in_a_terminal_it_asks_and_an_unreadable_answer_is_asked_again(
    isocenter: Isocenter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "slide.toml"
    replies = ["car", "", "", "prismatic", "x", "", "", "heavy", "-2", "95", *[""] * 20]  # nothing of gravity, rate, damping and position
    monkeypatch.setattr(sys, "stdin", Terminal("\n".join(replies) + "\n"))
    made = isocenter("machine", "new", "-o", out, "-a", "car.constant=35", "-a", "car.limit=10", "-a", "car.effort_unit=V")
    assert made.status == 0, made.err
    assert "car: mass that it moves, without the axes that it carries [kg]" in made.out
    assert "must be a number" in made.out
    assert "must be above 0" in made.out
    (body,) = load_machine(out).plant.tree.bodies
    assert body.joint is not None
    assert (body.mass_kg, body.joint.kind, list(body.joint.axis)) == (95.0, "prismatic", [1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("-a", "axes="), "--answer axes=: must be KEY=VALUE"),
        (("-a", "turn.mass_kg=heavy"), "--answer turn.mass_kg=heavy: must be a number"),
        (("-a", "turn.mass_kg=-3"), "--answer turn.mass_kg=-3: must be above 0"),
        (("-a", "turn.weight=3"), "--answer turn.weight: nothing asks for it; the questions are axes, "),
        (("-a", "turn.mass_kg"), "--answer turn.mass_kg: must be KEY=VALUE"),
        (("-a", "turn.type=helical"), "must be revolute or prismatic"),
        (("--name", "7up"), "--name 7up: must be a name"),
        (("--eds", "no.eds"), "no.eds: cannot be read"),
        (("--eds", "isocenter_encoder.eds"), "--eds: 0 data sheets of drives; one drive's for all axes"),
        (("--from", "no.xml"), "no.xml: cannot be read"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line_and_nothing_is_written(
    isocenter: Isocenter, tmp_path: Path, arguments: tuple[str, ...], says: str
) -> None:
    refused = isocenter("machine", "new", "-o", tmp_path / "x.toml", "--no-ask", "-a", "axes=turn", *arguments)
    assert refused.status == 2
    assert says in refused.line
    assert list(tmp_path.iterdir()) == []


def test_axes_are_not_made_up(isocenter: Isocenter, tmp_path: Path) -> None:
    refused = isocenter("machine", "new", "-o", tmp_path / "x.toml", "--no-ask")
    assert refused.status == 2
    assert "no axes: name them, `-a axes=turn,lift`" in refused.line


def test_a_file_is_not_written_over(isocenter: Isocenter, tmp_path: Path) -> None:
    out = tmp_path / "mine.toml"
    out.write_text("mine")
    refused = new(isocenter, out, ANSWERS)
    assert refused.status == 2
    assert "is not written over" in refused.line
    assert out.read_text() == "mine"
