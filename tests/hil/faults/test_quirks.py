"""A drive that bends the standard is brought up, homed, run and stopped as the table of quirks says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from bench_machines import carm_text_in, edited
from command_line import Isocenter, runner
from places import ROOT
from quirk_trials import QuirkOutcome, Way, tried, verdict, verdict_of, ways_of

from hil.machine import machine_from_text
from virtual_bus.quirks.registry import quirks

TABLE = json.loads((ROOT / "benchmarks" / "results" / "quirks_carm.json").read_text(encoding="utf-8"))["rows"]
SCAN = ("run", "scan", "-m", "carm", "--axis", "roll", "--from", "10", "--to", "-10", "--speed", "23", "--dwell", "0.1")
EVERY = [(name, way) for name, quirk in quirks().items() for way in ways_of(quirk)]
BY_DAY: tuple[tuple[str, Way], ...] = (
    ("newer_revision", "torque"),
    ("no_heartbeat", "torque"),
    ("finer_encoder", "torque"),
    ("velocity_in_rpm", "search"),
    ("sdo_late", "torque"),
    ("still_homed", "search"),
    ("homing_never_reached", "search"),
    ("boot_up_twice", "search"),
)
"""What the drivers had wrong, and refusals, which take a fraction of a second each."""


@pytest.fixture
def isocenter(capsys: pytest.CaptureFixture[str]) -> Isocenter:
    return runner(capsys)


def as_the_table_says(name: str, way: Way, folder: Path) -> None:
    quirk = quirks()[name]
    outcome, row = tried(quirk, way, folder), TABLE[name][way]
    assert outcome.at_rest
    assert verdict_of(quirk, way, outcome) == row["verdict"], outcome.said
    assert outcome.said.startswith(row["said"].removesuffix("…"))


def test_the_table_has_every_quirk_in_every_way() -> None:
    assert {(name, way) for name, row in TABLE.items() for way in row} == set(EVERY)


def test_whatever_a_drive_does_its_axis_ends_at_rest() -> None:
    assert [name for name, row in TABLE.items() for way in row.values() if way["verdict"] == "not at rest"] == []


def test_a_refusal_has_words() -> None:
    assert [name for name, row in TABLE.items() for way in row.values() if "refused" in way["verdict"] and not way["said"]] == []


@pytest.mark.parametrize(("name", "way"), BY_DAY)
def test_a_quirk_comes_to_what_the_table_says(name: str, way: Way, tmp_path: Path) -> None:
    as_the_table_says(name, way, tmp_path)


def test_units_of_which_no_object_speaks_are_carried_where_the_machine_file_says_them(tmp_path: Path) -> None:
    said = r'\g<0>\nvelocity_unit = "0.1 counts/s"\nacceleration_unit = "10 counts/s^2"'
    machine = machine_from_text(edited(r"^\[drives.roll\]$", said, carm_text_in("velocity")))
    outcome = tried(quirks()["velocity_in_tenth_counts"], "velocity", tmp_path, machine=machine)
    assert verdict_of(quirks()["velocity_in_tenth_counts"], "velocity", outcome) == "carried", outcome.said


FAULT = "row 301: roll_drive (node 2): left operation enabled: fault (0218h); EMCY 2310h; the motors were stopped: roll at rest"


@pytest.mark.parametrize(
    ("outcome", "expected"),
    [
        (QuirkOutcome(5, "", True, True, 0.52), "carried"),
        (QuirkOutcome(5, "a note", True, True, 0.52), "carried, with a note"),
        (QuirkOutcome(5, "", True, True, 0.61), "moves 0.61 rad, not 0.50"),
        (QuirkOutcome(5, "", True, True, 0.0), "moves 0.00 rad, not 0.50"),
        (QuirkOutcome(5, "", True, False, 0.5), "not at rest"),
        (QuirkOutcome(3, "refuses", False, True, 0.0), "refused at the start of the run"),
    ],
)
def test_a_quirk_is_carried_where_its_axis_goes_as_far_as_that_of_the_standard(outcome: QuirkOutcome, expected: str) -> None:
    assert verdict(outcome, QuirkOutcome(5, "", True, True, 0.5), 0.05) == expected


def test_where_the_standard_ends_in_an_error_the_quirk_must_end_in_the_same() -> None:
    standard = QuirkOutcome(4, FAULT, False, True, 0.5)
    same = QuirkOutcome(4, FAULT.replace("301", "299").replace("0218h", "0238h"), False, True, 0.5)
    assert verdict(same, standard, 0.05) == "carried"
    other = QuirkOutcome(4, "row 301: roll: tracking error 0.0525 rad exceeds 0.0524 rad; the motors were stopped", False, True, 0.5)
    assert verdict(other, standard, 0.05) == "ends in another error"


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "way"), EVERY)
def test_every_quirk_comes_to_what_the_table_says(name: str, way: Way, tmp_path: Path) -> None:
    as_the_table_says(name, way, tmp_path)


def test_the_list_names_every_quirk_with_a_sentence_and_in_json_its_source(isocenter: Isocenter, tmp_path: Path) -> None:
    outcome = isocenter("faults", "quirks", "--json", tmp_path / "quirks.json")
    assert outcome.status == 0
    assert [line.split()[0] for line in outcome.out.splitlines()] == list(quirks())
    assert [row["source"] for row in json.loads((tmp_path / "quirks.json").read_text())["quirks"]] == [
        quirk.source for quirk in quirks().values()
    ]


def test_a_run_takes_a_quirk_and_says_what_is_wrong(isocenter: Isocenter, tmp_path: Path) -> None:
    outcome = isocenter(*SCAN, "-b", "lockstep:", "--quirk", "roll_drive:newer_revision", "-o", tmp_path / "run.mf4")
    assert outcome.status == 2
    assert "roll_drive (node 2): revision_number is 00010001h" in outcome.line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((*SCAN, "-b", "udp:", "-o", "run.mf4", "--quirk", "roll_drive:sdo_late"), "give them to `isocenter emulate`"),
        ((*SCAN, "-b", "lockstep:", "-o", "run.mf4", "--quirk", "roll:sdo_late"), "no drive 'roll'; there is propeller_drive, roll_drive"),
        (("emulate", "carm", "-b", "virtual:quirks", "--quirk", "roll_drive:none"), "`isocenter faults quirks` names all"),
        (("emulate", "--eds", "device.eds", "-b", "virtual:quirks", "--quirk", "roll_drive:sdo_late"), "--quirk"),
    ],
)
def test_quirks_that_nobody_can_have_are_refused(isocenter: Isocenter, arguments: tuple[str, ...], said: str) -> None:
    outcome = isocenter(*arguments)
    assert outcome.status == 2
    assert said in outcome.line
