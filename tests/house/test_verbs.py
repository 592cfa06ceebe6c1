"""A verb is one file with a typed request and a typed answer. What shows it imports no methods for it, inside functions neither."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from places import ROOT
from test_floors import imports_of

MOVED = {
    "calibrate": ("hil/cli/calibrate.py",),
    "check": ("hil/cli/machine.py",),
    "compare": ("hil/cli/answers.py",),
    "expose": ("hil/cli/calibrate.py",),
    "identify": ("hil/cli/identify.py", "hil/reports/identified.py"),
    "observe": ("hil/cli/observe.py", "hil/reports/observed.py"),
    "plot": ("hil/cli/plot.py",),
    "reconstruct": ("hil/cli/reconstruct.py",),
    "shape": ("hil/cli/shape.py", "hil/reports/shaped.py"),
    "simulate": ("hil/cli/answers.py",),
}
"""Verbs that are one file of `hil/verbs`, and the files that show them beside those that show all: the front door and the bench page."""

SHOW_ALL = ("hil/__init__.py", *(path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "hil" / "console").glob("*.py"))))

METHODS = {
    "calibrate": ("hil.calibration.phantom", "hil.calibration.use"),
    "check": ("hil.machine.check", "hil.machine.open_points"),
    "compare": ("hil.simulation",),
    "expose": ("hil.emulated.anatomy", "hil.emulated.images", "hil.emulated.scenes"),
    "identify": ("hil.identification",),
    "observe": ("controllers.observers", "controllers.damping", "hil.calibration.data_driven", "hil.observing"),
    "plot": ("hil.pages", "hil.recording", "hil.reports.plot", "hil.simulation"),
    "reconstruct": ("hil.calibration", "hil.emulated.scenes", "hil.figures", "hil.imaging", "hil.reconstruction"),
    "shape": ("controllers.shapers", "hil.shaping"),
    "simulate": ("hil.simulation",),
}

WORDS = ("hil.identification.report", "hil.shaping.in_time")
"""What makes lines and rows for a person of values that it is given."""


OFFERED = ("hil.identification.resonances",)
"""What `import hil` offers of a method as it is."""


def is_value(module: str) -> bool:
    """Whether an import is of a type, of a file's reader or writer, or of words: what the answer consists of, and no decision."""
    name = module.rpartition(".")[2]
    return name[:1].isupper() or name.startswith(("read_", "write_")) or module.startswith((*WORDS, *OFFERED))


def deciding_imports(root: Path, file: str, methods: tuple[str, ...], may_show_values: bool) -> list[str]:
    """Every import of a method in a file that shows, as `file:line imports module`."""
    found = []
    for line, module in imports_of(root / file, root):
        is_method = any(f"{module}.".startswith((f"{name}.", f"{name}_")) for name in methods)
        if is_method and not (may_show_values and is_value(module)):
            found.append(f"{file}:{line} imports {module}")
    return found


@pytest.mark.parametrize("verb", MOVED)
def test_what_shows_a_verb_imports_no_methods_for_it(verb: str) -> None:
    wrong = [each for file in MOVED[verb] for each in deciding_imports(ROOT, file, METHODS[verb], not file.startswith("hil/cli/"))]
    wrong += [each for file in SHOW_ALL for each in deciding_imports(ROOT, file, METHODS[verb], True)]
    assert wrong == []


@pytest.mark.parametrize("verb", MOVED)
def test_a_verb_has_a_request_an_answer_and_a_function_that_gives_it(verb: str) -> None:
    """Frozen dataclasses, without a dictionary of anything."""
    tree = ast.parse((ROOT / "hil" / "verbs" / f"{verb}.py").read_text(encoding="utf-8"))
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    assert {f"{verb.capitalize()}Request", f"{verb.capitalize()}Answer"} <= set(classes)
    assert {ast.unparse(each) for node in classes.values() for each in node.decorator_list} == {"dataclass(frozen=True)"}
    assert "answer" in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert "dict[str, Any]" not in ast.unparse(tree)


@pytest.mark.parametrize("verb", MOVED)
def test_a_verb_imports_its_methods_when_it_is_asked(verb: str) -> None:
    """So that a face imports it at its top, and naming it costs nothing."""
    tree = ast.parse((ROOT / "hil" / "verbs" / f"{verb}.py").read_text(encoding="utf-8"))
    named = {node.module for node in tree.body if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("hil")}
    assert named <= {"hil.errors", "hil.verbs.errors", "hil.verbs.verb"}
    for file in MOVED[verb][:1]:
        names = [name for name in ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8"))) if isinstance(name, ast.ImportFrom)]
        assert any(each.module == "hil.verbs" and verb in {alias.name for alias in each.names} for each in names)


@pytest.mark.parametrize("text", ["from hil.observing import observe", "def late():\n    from hil.observing.alarms import alarms"])
def test_a_face_that_decides_is_found(tmp_path: Path, text: str) -> None:
    (tmp_path / "hil").mkdir()
    (tmp_path / "hil" / "face.py").write_text(text + "\n")
    assert len(deciding_imports(tmp_path, "hil/face.py", METHODS["observe"], True)) == 1
    (tmp_path / "hil" / "face.py").write_text("from hil.observing import Estimate\n")
    assert deciding_imports(tmp_path, "hil/face.py", METHODS["observe"], True) == []
    assert len(deciding_imports(tmp_path, "hil/face.py", METHODS["observe"], False)) == 1
