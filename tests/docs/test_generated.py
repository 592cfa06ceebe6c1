"""The generated pages are fresh, and what they say holds against the loaders, the command line and the writers themselves."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from command_line import Isocenter
from observed_models import small_model, small_noise
from places import ROOT

from controllers.shapers.sampled import AxisShaper
from docs.generate import results
from docs.generate.__main__ import main
from docs.generate.command_line import commands
from docs.generate.format_tables import (
    ARRAY_FILES,
    CHANNELS,
    DATA,
    DESIGN,
    EST,
    FRF,
    LOOKUP,
    MARKER,
    MODEL,
    SHAPER,
    SIGHTINGS,
    SPOOL,
    ArrayFile,
)
from docs.generate.json_tables import COMMANDS, DIAGNOSIS
from docs.generate.pages import GENERATED, differences, pages
from drivers.imaging.spool import Frame, write_frame
from hil.calibration.data_driven import data_file, live_file
from hil.calibration.kinematic import geometric_model
from hil.calibration.marker import scan as marker_scan
from hil.calibration.use.lookup_table import LookUp, write_look_up
from hil.diagnosis import result
from hil.errors import MachineFileError
from hil.files.toml_text import toml_text
from hil.identification.frf_file import write_frf
from hil.identification.result import Distortion, FrequencyResponse
from hil.machine import load_machine, machine_from_text
from hil.machine.effects_file import effects_from_text
from hil.observing import Estimate, ObserverDesign, write_design, write_estimate
from hil.recording.channels import KINDS, kind_of
from hil.shaping.shaper_file import ShaperFile, write_shaper
from virtual_bus.effects import catalogue

RANDOM = np.random.default_rng(20)


def text_of(name: str) -> str:
    """Read a page as it is on disk."""
    return (GENERATED / name).read_text(encoding="utf-8")


def rows_under(text: str, heading: str) -> list[list[str]]:
    """Return the cells of the first table with a header below a heading."""
    part = re.split(r"^#{2,3} ", text, flags=re.MULTILINE)
    section = next(each for each in part if each.splitlines()[0] == heading)
    lines = [line for line in section.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines[2:]]


def codes(cell: str) -> list[str]:
    """Return the names that stand as code in a cell."""
    return re.findall(r"`([^`]+)`", cell)


@pytest.fixture(scope="module")
def made() -> dict[str, str]:
    """The pages as the code makes them."""
    return pages()


class TestPages:
    """What is on disk is what the code says."""

    def test_they_are_fresh(self, made: dict[str, str]) -> None:
        """`python -m docs.generate` makes them so."""
        assert differences(made) == []

    def test_making_them_twice_gives_the_same(self, made: dict[str, str]) -> None:
        """No date, no order of a set, no path of this computer."""
        assert made == pages()
        assert [name for name, text in made.items() if str(ROOT) in text] == []

    def test_what_differs_is_named(self, tmp_path: Path) -> None:
        """Stale, missing and orphaned pages."""
        folder = tmp_path / "generated"
        folder.mkdir()
        (folder / "a.md").write_text("old")
        (folder / "c.md").write_text("left over")
        assert differences({"a.md": "new", "b.md": "new"}, folder) == [
            "missing: generated/b.md",
            "orphaned: generated/c.md",
            "stale: generated/a.md",
        ]

    def test_check_writes_nothing(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        """It lists what differs and ends with 1."""
        before = {path.name: path.read_bytes() for path in GENERATED.glob("*.md")}
        monkeypatch.setattr("docs.generate.__main__.pages", lambda: {"effects.md": "other"})
        assert main(["--check"]) == 1
        assert "stale: generated/effects.md" in capsys.readouterr().out.splitlines()
        assert {path.name: path.read_bytes() for path in GENERATED.glob("*.md")} == before


def test_every_module_of_the_api_is_there() -> None:
    """A module that is renamed is renamed on its page."""
    named = {module for path in (ROOT / "docs" / "api").glob("*.md") for module in re.findall(r"automodule:: (\S+)", path.read_text())}
    assert len(named) > 40
    assert [module for module in sorted(named) if importlib.util.find_spec(module) is None] == []


class TestMachineFile:
    """Every documented key with every documented unit is known to the loader."""

    @staticmethod
    def places() -> dict[str, Callable[[dict[str, Any]], dict[str, Any]]]:
        """Heading of a table to where the shipped C-arm has one."""

        def sensor(kind: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
            return lambda file: next(table for table in file["sensors"].values() if table["type"] == kind)

        def drive(file: dict[str, Any]) -> dict[str, Any]:
            return next(node for node in file["bus"]["nodes"].values() if node["role"] == "drive")

        return {
            "Top level": lambda file: file,
            "`[timing]`": lambda file: file["timing"],
            "`[[body]]`": lambda file: file["body"][0],
            "`[body.joint]`": lambda file: next(body["joint"] for body in file["body"] if "joint" in body),
            "`[drives.AXIS]`": lambda file: file["drives"]["roll"],
            '`[sensors.position_AXIS]` and `[sensors.link_position_AXIS]`, `type = "encoder"`': sensor("encoder"),
            '`[sensors.current_AXIS]`, `type = "current"`': sensor("current"),
            '`[sensors.imu]`, `type = "imu"`': sensor("imu"),
            '`[sensors.temperature_AXIS]`, `type = "temperature"`': sensor("temperature"),
            "`[controller.AXIS]`": lambda file: file["controller"]["roll"],
            "`[limits.AXIS]`": lambda file: file["limits"]["roll"],
            "`[geometry]`": lambda file: file["geometry"],
            "`[bus]`": lambda file: file["bus"],
            "`[bus.nodes.NAME]`": drive,
            "`[[bus.nodes.NAME.tpdo]]` and `[[bus.nodes.NAME.rpdo]]`": lambda file: drive(file)["tpdo"][0],
            "`[bus.homing.AXIS]`": lambda file: file["bus"]["homing"]["roll"],
            "`[bus.imu]`": lambda file: file["bus"]["imu"],
            "`[bus.io]`": lambda file: file["bus"]["io"],
        }

    def complaint(self, heading: str, key: str) -> str:
        """What the loader says to the C-arm with this key and a value that no key can have."""
        file = tomllib.loads(load_machine("carm").text)
        table = self.places()[heading](file)
        stem = key.split("_UNIT")[0]
        for other in [each for each in table if each == stem or each.startswith(stem + "_")]:
            del table[other]
        table[key] = [[[0.5]]]
        with pytest.raises(MachineFileError) as error:
            machine_from_text(toml_text(file))
        return str(error.value)

    def test_every_key_is_known(self) -> None:
        """A wrong value is complained of, at that key; the key itself is not."""
        text = text_of("machine-file.md")
        asked = 0
        for heading in self.places():
            for key_cell, unit_cell, *_ in rows_under(text, heading):
                stem = codes(key_cell)[0]
                keys = [stem.replace("UNIT", unit) for unit in codes(unit_cell)] or [stem]
                for key in {keys[0], str(RANDOM.choice(keys))}:
                    said = self.complaint(heading, key)
                    assert "unknown key" not in said, said
                    assert "unknown unit" not in said, said
                    asked += 1
        assert asked > 190  # none of them twice

    @pytest.mark.parametrize(
        ("heading", "key"), [("`[timing]`", "sample_rate_kg"), ("`[drives.AXIS]`", "limitation"), ("Top level", "buses")]
    )
    def test_a_key_that_is_not_documented_is_refused(self, heading: str, key: str) -> None:
        """So the test above can fail."""
        assert re.search("unknown (key|unit)", self.complaint(heading, key))

    def test_every_key_of_the_shipped_machines_is_documented(self) -> None:
        """By its stem, in any table."""
        documented = {codes(line)[0].removesuffix("_UNIT") for line in text_of("machine-file.md").splitlines() if line.startswith("| `")}
        maps = {
            "brake_coils",
            "brake_feedback_inputs",
            "temperature_registers",
            "nodes",
            "homing",
            "drives",
            "sensors",
            "controller",
            "limits",
            "encoders",
            "temperature",
            "drive",
            "budgets",
        }
        of_effects = {codes(line)[0] for line in text_of("effects.md").splitlines() if line.startswith("| `")}

        def undocumented(table: dict[str, Any], by_name: bool = False) -> set[str]:
            lost = set()
            for key, value in table.items():
                if not by_name and not any(key == stem or key.startswith(stem + "_") for stem in documented):
                    lost.add(key)
                for inner in value if isinstance(value, list) else [value]:
                    if key == "effect":  # the page of effects has their keys
                        lost |= {each.removesuffix("_between") for each in inner} - of_effects - {"name", "at", "scatter_percent"}
                    elif isinstance(inner, dict):
                        lost |= undocumented(inner, key in maps and not by_name)
            return lost

        for path in sorted((ROOT / "hil" / "machine" / "shipped").glob("*.toml")):
            assert undocumented(tomllib.loads(path.read_text(encoding="utf-8"))) == set()


class TestEffects:
    """Every effect is there, and its parameters are those that an effects file takes."""

    @pytest.mark.parametrize("entry", catalogue(), ids=lambda entry: str(entry["name"]))
    def test_a_file_by_the_page_is_read(self, entry: dict[str, Any]) -> None:
        """With the keys of the page, at a value within its range."""
        rows = rows_under_table(text_of("effects.md"), entry["name"], 1)
        machine = load_machine("carm")
        places = {"axis": "roll", "body": "payload", "encoder": "link_position_roll", "imu": "imu", "channel": "link_position_roll"}
        at = places[entry["at"][0]] if entry["at"][0] != "body" else machine.plant.tree.bodies[-1].name
        lines = ["[[effect]]", f'name = "{entry["name"]}"', f'at = "{at}"']
        for key, _, _, spread, *_ in rows:
            low, high = (float(end) for end in spread.split(" to "))
            lines.append(f"{codes(key)[0]} = {low + 0.25 * (high - low)!r}")
        assert [each.name for each in effects_from_text("\n".join(lines), machine, "page")] == [entry["name"]]

    def test_there_is_no_other(self) -> None:
        """A heading for every entry of the catalogue."""
        headings = re.findall(r"^### (\w+)$", text_of("effects.md"), re.MULTILINE)
        assert headings == [entry["name"] for entry in catalogue()]


class TestCommandLine:
    """The page has what --help has."""

    @pytest.mark.parametrize("name", list(commands()))
    def test_every_option_is_there(self, name: str, isocenter: Isocenter) -> None:
        """And no other."""
        shown = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", options_of(isocenter(*name.split(), "--help").out))) - {"--help"}
        rows = rows_under_table(text_of("command-line.md"), f"isocenter {name}", -1)
        assert {option for row in rows for option in codes(row[0]) if option.startswith("--")} == shown


class TestJson:
    """Keys of answers are those of commands that are run, and those that stand in the code."""

    @pytest.mark.parametrize(
        ("name", "arguments"),
        [
            ("machine list", []),
            ("machine show", ["carm"]),
            ("machine export", ["carm", "--mjcf", "{folder}/carm.xml"]),
            ("machine convert", ["turntable", "--rate", "400", "-o", "{folder}/turntable.toml"]),
            ("effects", []),
        ],
    )
    def test_an_answer_has_the_documented_keys(self, name: str, arguments: list[str], tmp_path: Path, isocenter: Isocenter) -> None:
        """Neither more nor fewer."""
        given = [each.replace("{folder}", str(tmp_path)) for each in arguments]
        outcome = isocenter(*name.split(), *given, "--json", tmp_path / "answer.json")
        assert outcome.status == 0, outcome.err
        answer = json.loads((tmp_path / "answer.json").read_text(encoding="utf-8"))
        found = set(answer[0]) if isinstance(answer, list) else set(answer)
        assert found == documented_keys(name)

    def test_every_command_has_its_keys(self) -> None:
        """The table has no command that is gone."""
        assert sorted(COMMANDS) == sorted(commands())

    def test_no_key_of_the_code_is_left_out(self) -> None:
        """Of answers that are written as they stand in a command."""
        known = {key for name in COMMANDS for key in documented_keys(name)}
        for path in sorted((ROOT / "hil" / "cli").glob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "write" and node.args:
                    assert literal_keys(node.args[0]) <= known, f"{path.name}: {literal_keys(node.args[0]) - known}"

    def test_a_diagnosis_has_the_documented_keys(self) -> None:
        """At every depth."""
        effect = result.EffectAt("coulomb_friction", "roll")
        stages = result.Stages(1.0, 1.0, 1.0, 1.0, 1.0)
        spans = {"roll": ((0.0, 1.0),)}
        finding = result.Finding(effect, 0.9, {"NAME": result.ParameterEstimate(1.0, "Nm", (0.0, 2.0))}, (effect,), ((effect,),))
        whole = result.Diagnosis(
            verdict="explained",
            reason="",
            findings=(finding, result.Finding(effect, 0.9, {"value": result.ParameterEstimate(1.0, "kg", (0.0, 2.0), 3.0)}, kind="number")),
            hypotheses=(result.Hypothesis((effect,), 0.9),),
            retuned={"OWNER.QUANTITY": result.RetunedValue(1.0, 1.0, "kg", (0.0, 2.0))},
            frozen={"OWNER.QUANTITY": "not shown"},
            noise="repeats",
            location=result.Location({"c": 1.0}, spans, ((0.0, 1.0),), spans, spans, spans, {"roll": "both"}, {"time_s": {"all": 1.0}}),
            fit=result.Fit({"CHANNEL": stages}, stages, stages, 1.0, 1.0),
            unexplained_share=0.0,
            seconds=1.0,
            separations=(result.PredictedSeparation((effect,), 1.0, 1.0),),
            audit={"axes": {"AXIS": 1.0}, "sensors": [1.0], "recordings": [1.0]},
        )
        documented = {entry.name for entry in DIAGNOSIS}
        found = set(paths_of(whole.document(), documented))
        assert found == documented


class TestFileFormats:
    """What the writers write is what the tables say."""

    def test_every_kind_of_channel_is_there(self) -> None:
        """And its example names are of that kind."""
        assert set(CHANNELS) == {kind.pattern for kind in KINDS}
        for kind in KINDS:
            names = [name for name in CHANNELS[kind.pattern][0].split(", ") if name != "…"]
            assert all(kind_of(name.replace("_A", "_roll")) == kind for name in names)

    def test_frequency_responses(self, tmp_path: Path) -> None:
        """With every optional array."""
        lines, square = np.arange(1, 4), np.ones((3, 1, 1), dtype=complex)
        even_odd = Distortion(lines, lines * 0.1, square[:, 0].real, square[:, 0].real, 2)
        covariances = (square,) * 5
        names = ("y",), ("u",), ("rad",), ("A",)
        dof = np.ones(3), np.ones(3)
        response = FrequencyResponse(
            lines, lines * 0.1, square, square, *covariances, *dof, *names, 256.0, 2560, "fast_bla", even_odd=even_odd
        )
        write_frf(response, tmp_path / "frf.npz")
        assert written(tmp_path / "frf.npz") == names_of(FRF)

    def test_shapers(self, tmp_path: Path) -> None:
        """Of one axis."""
        shaper = AxisShaper("roll", np.array([0, 3]), np.array([[0.5, 0.5]]), np.zeros(1), "", np.zeros((0, 6)), 1.0, "zv")
        write_shaper(ShaperFile((shaper,), 256.0), tmp_path / "shaper.npz")
        assert written(tmp_path / "shaper.npz") == {name.replace("_A", "_roll") for name in names_of(SHAPER)}

    def test_estimates(self, tmp_path: Path) -> None:
        """Of nothing."""
        none = np.zeros((0, 1))
        write_estimate(Estimate(np.zeros(0), ("a",), ("",), none, ("b",), none, ("c",), none, "ukf", ""), tmp_path / "est.npz")
        assert written(tmp_path / "est.npz") == names_of(EST)

    def test_observer_designs(self, tmp_path: Path) -> None:
        """All but the optional arrays; those of the noise by their first word."""
        write_design(ObserverDesign(small_model(), small_noise(), np.zeros(3), "small", ""), tmp_path / "design.npz")
        found = {"noise_*" if name.startswith("noise_") else name for name in written(tmp_path / "design.npz")}
        optional = {each.name for each in DESIGN.arrays if "Optional" in each.meaning}
        assert found | optional == names_of(DESIGN)

    def test_look_up_tables(self, tmp_path: Path) -> None:
        """Of no exposure."""
        write_look_up(LookUp(("roll",), np.zeros((0, 1)), np.zeros((0, 9)), np.zeros((0, 9, 9))), tmp_path / "table.npz")
        assert written(tmp_path / "table.npz") == names_of(LOOKUP)

    def test_frames_of_a_panel(self, tmp_path: Path) -> None:
        """One."""
        write_frame(tmp_path, Frame(1, 0.0, 0.008, 0.0, np.zeros((2, 2), dtype=np.uint16)))
        assert written(next(tmp_path.glob("frame_*.npz"))) == names_of(SPOOL)

    @pytest.mark.parametrize(
        ("module", "function", "file"),
        [
            (geometric_model, "write_model", MODEL),
            (marker_scan, "write_marker_scan", MARKER),
            (data_file, "write_data_file", DATA),
            (live_file, "write_sightings", SIGHTINGS),
        ],
    )
    def test_files_whose_writers_take_a_whole_scan(self, module: ModuleType, function: str, file: ArrayFile) -> None:
        """By the keys that stand in the writer."""
        tree = ast.parse(inspect.getsource(getattr(module, function)))
        keys = {key for node in ast.walk(tree) if isinstance(node, ast.Dict) for key in literal_keys(node)}
        assert keys == names_of(file)

    def test_the_page_has_every_file(self) -> None:
        """A heading each."""
        assert [file.title for file in ARRAY_FILES if f"## {file.title}\n" not in text_of("file-formats.md")] == []

    def test_the_example_reads_a_shaper(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """As the bench shapes: half a step, then all of it."""
        shaper = AxisShaper("roll", np.array([0, 3]), np.array([[0.5, 0.5]]), np.zeros(1), "", np.zeros((0, 6)), 1.0, "zv")
        write_shaper(ShaperFile((shaper,), 256.0), tmp_path / "roll.shaper.npz")
        monkeypatch.chdir(tmp_path)
        names: dict[str, Any] = {"r": np.concatenate([np.zeros(2), np.ones(6)])}
        exec(SHAPER.example, names)
        np.testing.assert_allclose(names["shaped"], [0, 0, 0.5, 0.5, 0.5, 1, 1, 1])


class TestResults:
    """Figures are those of the files."""

    def test_a_file_that_is_not_there_is_left_out(self, tmp_path: Path) -> None:
        """With its section."""
        assert re.findall(r"^## ", results.page(tmp_path), re.MULTILINE) == []

    def test_a_figure_that_is_not_there_is_an_error(self, tmp_path: Path) -> None:
        """The declaration is stale."""
        (tmp_path / "imaging_reconstruction.json").write_text("{}")
        with pytest.raises(results.StaleDeclarationError, match="cone_beam / wall_s"):
            results.page(tmp_path)

    def test_a_figure_is_shown_with_its_command(self, tmp_path: Path) -> None:
        """And with what was asked."""
        (tmp_path / "imaging_reconstruction.json").write_text('{"cone_beam": {"wall_s": 2.34567}}')
        page = results.page(tmp_path)
        assert "| cone-beam volume, wall clock | 2.35 s | at most 3 s |" in page
        assert "python benchmarks/imaging_reconstruction.py" in page

    def test_every_command_is_a_script_that_is_there(self) -> None:
        """Under benchmarks."""
        commands_shown = set(re.findall(r"^python (\S+)", text_of("results.md"), re.MULTILINE))
        assert commands_shown
        assert [name for name in sorted(commands_shown) if not (ROOT / name).exists()] == []


def rows_under_table(text: str, heading: str, number: int) -> list[list[str]]:
    """Return the cells of the table with this number below a heading."""
    section = next(each for each in re.split(r"^#{2,3} ", text, flags=re.MULTILINE) if each.splitlines()[0] == heading)
    tables = [each for each in section.split("\n\n") if each.lstrip().startswith("| ")]
    lines = [line for line in tables[number].splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines[2:]]


def options_of(shown: str) -> str:
    """Return the first column of the options that --help shows."""
    lines = shown.partition("Options:")[2].splitlines()
    return "\n".join(line[2:].split("  ")[0] for line in lines if line.startswith("  -"))


def documented_keys(name: str) -> set[str]:
    """Return the keys at the top of a command's answer."""
    names = [key for entry in COMMANDS[name] for key in entry.name.split(", ")]
    return {key.removeprefix("[].").split(".")[0] for key in names if key}


def literal_keys(node: ast.AST) -> set[str]:
    """Return the keys at the top of a dictionary that stands in the code."""
    if isinstance(node, ast.BinOp):
        return literal_keys(node.left) | literal_keys(node.right)
    keys = node.keys if isinstance(node, ast.Dict) else []
    return {key.value for key in keys if isinstance(key, ast.Constant) and isinstance(key.value, str)}


def written(path: Path) -> set[str]:
    """Return the names of a file's arrays."""
    with np.load(path) as arrays:
        return set(arrays.files)


def names_of(file: ArrayFile) -> set[str]:
    """Return the names of the arrays that are documented."""
    return {name for entry in file.arrays for name in entry.name.split(", ")}


def paths_of(document: dict[str, Any], documented: set[str], prefix: str = "") -> list[str]:
    """Return the paths of a document as the page writes them, down to those that it has."""
    found = []
    for key, value in document.items():
        path = f"{prefix}{key}"
        is_list = isinstance(value, list) and bool(value) and isinstance(value[0], dict)
        deeper = f"{path}[]." if is_list else f"{path}."
        below = any(name.startswith(deeper) for name in documented)
        if path in documented or not below:
            found.append(path)
        for inner in (value if is_list else [value]) if below else []:
            found += paths_of(inner, documented, deeper) if isinstance(inner, dict) else []
    return found
