"""The JSON schema of machine files accepts what the loader accepts, and refuses wrong keys, types and ranges where they stand."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from bench_machines import carm_text_in, edited
from command_line import Isocenter
from places import ROOT

from hil.errors import MachineFileError
from hil.machine import list_shipped, load_machine, machine_from_text
from hil.machine.editors import SCHEMA

FILES = sorted(
    path for folder in ("hil", "benchmarks", "tests") for path in (ROOT / folder).rglob("*.toml") if "[[body]]" in path.read_text()
)


@pytest.fixture(scope="module")
def validator() -> jsonschema.Draft7Validator:
    schema = json.loads(SCHEMA.read_text())
    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


def places(validator: jsonschema.Draft7Validator, text: str) -> Iterator[tuple[str, str]]:
    for error in validator.iter_errors(tomllib.loads(text)):
        yield ".".join(map(str, error.absolute_path)), error.message


def test_it_accepts_every_machine_file_of_the_project(validator: jsonschema.Draft7Validator) -> None:
    assert len(FILES) > 15
    assert [(path.name, list(places(validator, path.read_text()))) for path in FILES if list(places(validator, path.read_text()))] == []


@pytest.mark.parametrize("mode", ["velocity", "position"])
def test_it_accepts_drives_in_other_modes(validator: jsonschema.Draft7Validator, mode: str) -> None:
    assert list(places(validator, carm_text_in(mode))) == []


@pytest.mark.parametrize(
    ("pattern", "written", "place", "says"),
    [
        (r"^rated_current_A = 5.0", "rated_curent_A = 5.0", "drives.propeller", "'rated_curent_A' was unexpected"),
        (r"^mass_kg = 120.0", "mass_kgs = 120.0", "body.0", "'mass_kgs' was unexpected"),
        (r"^mass_kg = 120.0", "", "body.0", "'mass_kg' is a required property"),
        (r"^mass_kg = 120.0", 'mass_kg = "120"', "body.0.mass_kg", "is not of type 'number'"),
        (r"^substeps = 4", "substeps = 4.5", "timing.substeps", "is not of type 'integer'"),
        (r"^substeps = 4", "substeps = 0", "timing.substeps", "less than the minimum"),
        (r"^mass_kg = 120.0", "mass_g = -1.0", "body.0.mass_g", "less than the minimum"),
        (r"^sample_rate_Hz = 256.0", "sample_rate_kHz = 20.1", "timing.sample_rate_kHz", "greater than the maximum of 20"),
        (r"^gravity_m_s2 = .*", "gravity_m_s2 = [0.0, -9.81]", "gravity_m_s2", "too short"),
        (r'^effort_unit = "A"', 'effort_unit = "mA"', "drives.propeller.effort_unit", "is not one of"),
        (r"^bitrate_bit_s = 1000000", "bitrate_bit_s = 1000001", "bus.bitrate_bit_s", "is not one of"),
    ],
)  # fmt: skip
def test_it_refuses_what_the_loader_refuses_at_its_place(
    validator: jsonschema.Draft7Validator, pattern: str, written: str, place: str, says: str
) -> None:
    text = edited(pattern, written)
    with pytest.raises(MachineFileError):
        machine_from_text(text)
    found = list(places(validator, text))
    assert any(where == place and says in message for where, message in found), found


def test_every_key_says_what_it_means(validator: jsonschema.Draft7Validator) -> None:
    schema: dict[str, Any] = validator.schema
    tables = [schema, *schema["definitions"].values()]
    assert len(tables) > 20
    assert [key for table in tables for key, value in table["properties"].items() if len(value["description"]) < 3] == []


def test_shipped_files_name_it_in_their_first_line() -> None:
    for name in list_shipped():
        path = load_machine(name).path
        assert path is not None
        first = path.read_text().splitlines()[0]
        assert (path.parent / first.removeprefix("#:schema ")) == SCHEMA


def test_the_command_prints_or_writes_it(isocenter: Isocenter, tmp_path: Path) -> None:
    out = tmp_path / "of_machines.json"
    done = isocenter("machine", "schema", "-o", out)
    assert done.status == 0
    assert "#:schema of_machines.json" in done.out
    assert json.loads(out.read_text()) == json.loads(isocenter("machine", "schema").out) == json.loads(SCHEMA.read_text())
    assert isocenter("machine", "schema", "-o", tmp_path / "x.toml").status == 2
