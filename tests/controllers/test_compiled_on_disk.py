"""Machine code kept on disk: found again when nothing has changed, never when a file that went into it has."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

CONTROLLERS = ROOT / "controllers"
CALLEE = "from controllers.compiled import exactly_called\n\n@exactly_called\ndef factor(x):\n    return {} * x\n"
BETWEEN = "from controllers.callee import factor\n"
CALLER = """from controllers.compiled import exactly_compiled
from controllers.between import factor

@exactly_compiled
def scaled(x):
    return factor(x) + 1.0
"""
RUN = (
    "from controllers.caller import scaled; value = scaled(10.0); hits = scaled.stats.cache_hits; "
    "print(value, sum(hits.values()), scaled.__name__, scaled.py_func.__module__)"
)


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """A copy of the compiler's file with a function of one file that calls another file's through a third."""
    package = tmp_path / "controllers"
    package.mkdir()
    for name in ("__init__.py", "compiled.py"):
        shutil.copy(CONTROLLERS / name, package)
    for name, text in {"callee": CALLEE.format("2.0"), "between": BETWEEN, "caller": CALLER}.items():
        (package / f"{name}.py").write_text(text)
    return package


PAIR = "from typing import NamedTuple\n\nclass Pair(NamedTuple):\n    a: float\n    b: float\n"
FIRST = "from controllers.compiled import exactly_compiled\n\n@exactly_compiled\ndef first(p):\n    return p[0]\n"
OF_A_PAIR = (
    "from controllers.caller import first; from controllers.{0} import Pair; print(first(Pair(1.0, 2.0)), first.stats.cache_hits.total())"
)


def run(house: Path, words: str = RUN) -> str:
    environment = os.environ | {
        "PYTHONPATH": str(house.parent),
        "NUMBA_CACHE_DIR": str(house.parent / "kept"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    done = subprocess.run([sys.executable, "-c", words], cwd=house.parent, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
def test_an_edit_of_a_file_that_is_compiled_in_is_seen(house: Path) -> None:
    assert run(house) == "21.0 0 scaled controllers.caller"
    assert run(house) == "21.0 1 scaled controllers.caller", "the second process finds what the first has compiled"
    (house / "callee.py").write_text(CALLEE.format("3.0"))
    assert run(house) == "31.0 0 scaled controllers.caller"


@pytest.mark.slow
def test_an_index_that_names_a_type_which_is_gone_is_made_anew(house: Path) -> None:
    """As an update leaves it that moves a named tuple to another file, where the function's own file stays as it was."""
    (house / "caller.py").write_text(FIRST)
    (house / "old.py").write_text(PAIR)
    assert run(house, OF_A_PAIR.format("old")) == "1.0 0"
    (house / "old.py").rename(house / "new.py")
    assert run(house, OF_A_PAIR.format("new")) == "1.0 0"
    assert run(house, OF_A_PAIR.format("new")) == "1.0 1"
