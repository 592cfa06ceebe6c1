"""A part of a request is an option that is written once: a command reads it as its metavar says and the request has it in SI."""

from __future__ import annotations

import ast
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer
from places import ROOT
from typer.testing import CliRunner

from hil.cli.asking import by_options
from hil.cli.shared import asks, names_of
from hil.errors import RequestError
from hil.verbs.verb import argument, option


@dataclass(frozen=True)
class Request:
    machine: str
    scans: Sequence[Path] = argument("Scans.", "SCAN...")
    out: Path | None = option("Where to write.", "FILE", "-o", "--out", is_needed=True)
    edge_m: float = option("Edge.", "MM", "--edge", default=0.5e-3)
    band_Hz: tuple[float, float] | None = option("Band.", "LOW:HIGH", "--band")
    names: Sequence[str] = option("Names.", "NAME,...", "--names", default=())
    repeats: Sequence[Path] = option("Repeats.", "REC", "--repeat", default=(), is_several=True)
    harmonics: Sequence[int] = option("Harmonics.", "N,N,...", "--harmonics", default=(1, 3))
    adapted: Sequence[int] = option("Modes, from 1.", "N,N,...", "--adapt", default=(), form="modes")
    period_s: float | None = option("Period; 0: none.", "S", "--period", kind=float, none=0.0)


def asked(*typed: str) -> tuple[int, str, list[Request]]:
    found: list[Request] = []
    app = typer.Typer()

    @app.command()
    @asks
    def command(request: Callable[..., Request], machine: str = "carm") -> None:
        found.append(request(machine=machine))

    done = CliRunner().invoke(app, typed, env={"COLUMNS": "200"})
    return done.exit_code, done.output, found


def test_what_is_typed_is_read_by_its_metavar() -> None:
    status, _, found = asked("a", "b", "-o", "c", "--edge", "2", "--band", "1:8", "--names", "x, y", "--repeat", "d", "--repeat", "e")
    assert status == 0
    assert found == [Request("carm", [Path("a"), Path("b")], Path("c"), 2e-3, (1.0, 8.0), ("x", "y"), [Path("d"), Path("e")])]


def test_what_is_not_typed_is_the_request_s_own_and_shown_in_the_option_s_unit() -> None:
    assert asked("a", "-o", "c")[2] == [Request("carm", [Path("a")], Path("c"))]
    assert asked("a", "-o", "c", "--period", "0", "--harmonics", "1,3")[2] == [Request("carm", [Path("a")], Path("c"))]
    assert all(f"[default: {shown}]" in asked("--help")[1] for shown in ("0.5", "1,3", "0.0"))


def test_text_of_one_metavar_may_have_forms_of_its_own() -> None:
    (read,) = asked("a", "-o", "c", "--harmonics", "2", "--adapt", "2", "--period", "3")[2]
    assert (read.harmonics, read.adapted, read.period_s) == ((2,), (1,), 3.0)


def test_what_a_command_needs_is_asked_for() -> None:
    status, said, found = asked("a")
    assert (status, found) == (2, [])
    assert "--out" in said


def test_an_error_names_a_part_by_its_option() -> None:
    with pytest.raises(typer.BadParameter, match=r"^--edge 0: too small for --repeat$"), by_options(names_of(Request)):
        raise RequestError("{edge_m} 0: too small for {repeats}")


def test_braces_of_a_file_s_name_are_told_as_they_are() -> None:
    refusal = RequestError("{scans} {}: lacks what {repeats} {} has", Path("{edge_m}/a{}.mf4"), "{x}")
    for told in (refusal, pickle.loads(pickle.dumps(refusal))):
        assert str(told) == "scans {edge_m}/a{}.mf4: lacks what repeats {x} has"
        assert told.calling("--{}".format) == "--scans {edge_m}/a{}.mf4: lacks what --repeats {x} has"


def test_a_text_of_a_refusal_is_written_without_values_in_it() -> None:
    """A value in the text itself would be searched for parts."""
    wrong = []
    for path in sorted((ROOT / "hil").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "RequestError" and isinstance(node.args[0], ast.JoinedStr):
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert wrong == []
