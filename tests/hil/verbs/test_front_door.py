"""`import hil` loads nothing, offers what it says, and tells every error in one line of its own kinds."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

import hil
from controllers.errors import DesignError
from drivers.errors import BusUnavailableError, DeviceFaultError
from hil.verbs.errors import as_bench_errors

HEAVY = ("numpy", "scipy", "numba", "control", "pandas", "matplotlib", "can", "canopen", "asammdf", "pydantic", "typer", "rich")


def for_type_checkers() -> dict[str, str]:
    """Return name and module of every import that `hil/__init__.py` shows to type checkers alone."""
    tree = ast.parse(Path(hil.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    return {alias.asname or alias.name: str(node.module) for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}


def test_importing_it_loads_no_package() -> None:
    words = f"import sys, hil; print(*[name for name in {HEAVY!r} if name in sys.modules], *[m for m in sys.modules if m[:4] == 'hil.'])"
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_type_checkers_and_programs_see_the_same_names() -> None:
    seen = for_type_checkers()
    assert set(seen) == set(hil.__all__) == set(dir(hil))
    for name, module in seen.items():
        assert getattr(hil, name) is getattr(importlib.import_module(module), name)


def test_the_page_of_the_front_door_has_what_no_other_page_has() -> None:
    page = (ROOT / "docs" / "api" / "front-door.md").read_text(encoding="utf-8")
    own = {name for name, module in for_type_checkers().items() if module.startswith(("hil.verbs", "hil.shaping.choice", "hil.fleet"))}
    assert own == set(re.findall(r"\w+", page.split(":members:")[1]))


def test_a_name_that_is_not_there_is_said() -> None:
    with pytest.raises(AttributeError, match="'hil' has no attribute 'diagnoze'"):
        _ = hil.diagnoze  # type: ignore[attr-defined]


def test_everything_offered_is_described() -> None:
    """A line at least; of functions their parameters, unless there are none."""
    for name in hil.__all__:
        offered = getattr(hil, name)
        said = inspect.getdoc(offered)
        assert said, name
        if inspect.isfunction(offered) and offered.__module__.startswith("hil.verbs"):
            assert len(inspect.signature(offered).parameters) < 3 or "Parameters\n---" in said, name


@pytest.mark.parametrize(
    ("raised", "told"),
    [
        (BusUnavailableError("no such bus"), hil.UnusableInputError),
        (DeviceFaultError("overcurrent"), hil.LoopAbortedError),
        (DesignError("nothing rings"), hil.UnusableInputError),
        (hil.RecordingError("a hole"), hil.RecordingError),
    ],
)
def test_every_error_is_one_of_the_bench(raised: Exception, told: type[hil.BenchError]) -> None:
    raised.add_note("and more")
    with pytest.raises(told, match=str(raised)) as caught, as_bench_errors():
        raise raised
    assert caught.value.__notes__ == ["and more"]
    assert isinstance(caught.value, hil.BenchError)
