"""A step of the diagnosis knows only the steps before it, and the values of its answer."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import ROOT
from test_floors import imports_of

STEPS = (
    "audit", "observed", "residuals", "candidates", "retuning", "free_runs", "model_choice", "unknowns", "simulation", "likelihood",
    "selection", "prediction", "location", "next_experiment", "verdict",
)  # fmt: skip
"""Folders of `hil/diagnosis`; `report` and the files beside them but LEAVES stand on all."""

LEAVES = ("__init__", "result")
"""Files of `hil/diagnosis` that know nothing of it."""

HERE = "hil.diagnosis"
OUTSIDE = ("hil.cli", "hil.demo", "hil.verbs")
"""Of the bench, what knows the diagnosis itself."""


def is_of(module: str, names: tuple[str, ...]) -> bool:
    return any(module == name or module.startswith(f"{name}.") for name in names)


def climbing_steps(root: Path) -> list[str]:
    """Every import of the diagnosis, in a step or a leaf of it, that is not of a step before."""
    folder = root / "hil" / "diagnosis"
    allowed = {path: () for path in folder.glob("*.py") if path.stem in LEAVES}
    for number, step in enumerate(STEPS):
        below = tuple(f"{HERE}.{name}" for name in (*STEPS[: number + 1], "result"))
        allowed |= {path: below for path in (folder / step).rglob("*.py")}
    wrong = []
    for path, below in sorted(allowed.items()):
        for line, module in imports_of(path, root):
            parts = module.split(".")
            whole = module in ("hil", "hil.*", HERE, f"{HERE}.*")  # what is taken from it later is not seen
            if whole or is_of(module, OUTSIDE) or (parts[:2] == HERE.split(".") and not is_of(module, below)):
                wrong.append(f"{path.relative_to(root)}:{line} imports {module}")
    return wrong


def test_a_step_of_the_diagnosis_knows_only_the_steps_before_it() -> None:
    folders = {path.parent.name for path in (ROOT / "hil" / "diagnosis").glob("*/*.py")}
    assert folders == {*STEPS, "report"}
    assert climbing_steps(ROOT) == []


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("model_choice/form_error.py", "from hil.diagnosis.prediction.open_runs import Runs"),
        ("model_choice/form_error.py", "from hil.diagnosis.diagnose import diagnose"),
        ("model_choice/form_error.py", "import hil.diagnosis.report.page"),
        ("model_choice/form_error.py", "from ..prediction import open_runs"),
        ("model_choice/form_error.py", "from hil.diagnosis import prediction"),
        ("model_choice/form_error.py", "import hil.diagnosis"),
        ("model_choice/form_error.py", "from hil import diagnosis"),
        ("model_choice/form_error.py", "def late():\n    from hil.diagnosis.verdict.answer import answer"),
        ("audit/alike.py", "from hil.diagnosis.observed.rows import Observed"),
        ("verdict/answer.py", "from hil.cli.diagnose import command"),
        ("result.py", "from hil.diagnosis.model_choice.choose import Choice"),
        ("__init__.py", "from hil.diagnosis.diagnose import diagnose"),
    ],
)
def test_a_climbing_step_is_found(tmp_path: Path, file: str, text: str) -> None:
    path = tmp_path / "hil" / "diagnosis" / file
    path.parent.mkdir(parents=True)
    path.write_text(text + "\n")
    assert len(climbing_steps(tmp_path)) == 1


@pytest.mark.parametrize(
    "text",
    [
        "from hil.diagnosis.result import EffectAt",
        "import hil.diagnosis.result",
        "from hil.diagnosis import retuning",
        "from . import covariance",
    ],
)
def test_a_step_down_is_none(tmp_path: Path, text: str) -> None:
    path = tmp_path / "hil" / "diagnosis" / "model_choice" / "form_error.py"
    path.parent.mkdir(parents=True)
    path.write_text(text + "\n")
    assert climbing_steps(tmp_path) == []
