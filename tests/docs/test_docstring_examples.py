"""The examples in the docstrings of the public faces run, and print what they say."""

from __future__ import annotations

import doctest
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

import pytest
from places import ROOT

import hil

SHOWN = {
    "hil": "Band Move Multisine Recording compare identify list_shipped open_machine read_recording recording_from_frame resonances shape",
    "controllers.hadamard_experiments": "mixing_matrix",
    "controllers.models.denavit_hartenberg": "DenavitHartenberg",
    "controllers.multisine": "multisine",
    "controllers.shapers.closed_form_htdf": "second_order",
    "controllers.shapers.harmonic_time_delay": "harmonic",
    "controllers.shapers.point_to_point": "zv",
    "controllers.trajectory": "move",
    "drivers.bus_url": "parse_bus_url",
}
"""What is used most, and has an example."""


def public_modules() -> list[str]:
    """Modules of `controllers` and `drivers` that the pages of the Python interface name."""
    pages = [(ROOT / "docs" / "api" / f"{floor}.md").read_text(encoding="utf-8") for floor in ("controllers", "drivers")]
    return re.findall(r"automodule:: (\S+)", "".join(pages))


def public_faces() -> Iterator[type | FunctionType]:
    """Yield what `import hil` gives, and what those modules define."""
    yield from (getattr(hil, name) for name in hil.__all__)
    for name in public_modules():
        for key, value in vars(importlib.import_module(name)).items():
            if isinstance(value, type | FunctionType) and value.__module__ == name and not key.startswith("_"):
                yield value


def examples() -> dict[str, doctest.DocTest]:
    """Return the docstrings that have examples, those of methods too, by where they stand: once, whatever gives them."""
    finder = doctest.DocTestFinder()
    faces = {f"{face.__module__}.{face.__qualname__}": face for face in public_faces()}
    found = {each.name: each for name, face in faces.items() for each in finder.find(face, name, module=False, globs={})}
    return {name: each for name, each in found.items() if each.examples}


def failures(example: doctest.DocTest) -> str:
    """Run an example as a session of its own, and return what it printed else than it says."""
    told: list[str] = []
    doctest.DocTestRunner(verbose=False).run(example, out=told.append)
    return "".join(told)


EXAMPLES = examples()


def test_what_is_used_most_has_an_example() -> None:
    shown = [getattr(importlib.import_module(module), name) for module, names in SHOWN.items() for name in names.split()]
    assert [each for each in shown if f"{each.__module__}.{each.__qualname__}" not in EXAMPLES] == []


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_prints_what_it_says(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder."""
    monkeypatch.chdir(tmp_path)
    if found := failures(EXAMPLES[name]):
        pytest.fail(found, pytrace=False)


def test_an_example_that_is_wrong_is_seen() -> None:
    wrong = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3\n", {}, "wrong", None, None)
    assert "Expected:\n    3\nGot:\n    2" in failures(wrong)
