"""What is imported under TYPE_CHECKING is not there when the program runs: nothing but annotations may use it. mypy does not see this."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from places import ROOT


def is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


def imported(nodes: list[ast.stmt]) -> set[str]:
    """Names that import statements among these nodes bind."""
    found = (node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom))
    return {(alias.asname or alias.name).split(".")[0] for node in found for alias in node.names}


class Uses(ast.NodeVisitor):
    """Lines on which a name of `missing` is looked up at run time."""

    def __init__(self, missing: set[str]) -> None:
        self.missing, self.lines = missing, set[str]()

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        own = {argument.arg for argument in (*node.args.args, *node.args.kwonlyargs)}
        own |= imported([inner for inner in ast.walk(node) if isinstance(inner, ast.stmt)])
        within = Uses(self.missing - own)
        for inner in (*node.body, *node.decorator_list):
            within.visit(inner)
        self.lines |= within.lines

    def visit_If(self, node: ast.If) -> None:
        if not is_for_types(node):
            self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Name(self, node: ast.Name) -> None:
        if isinstance(node.ctx, ast.Load) and node.id in self.missing:
            self.lines.add(f"{node.lineno}: {node.id}")


def used_at_run_time(text: str) -> set[str]:
    tree = ast.parse(text)
    for_types = imported([inner for node in tree.body if isinstance(node, ast.If) and is_for_types(node) for inner in node.body])
    uses = Uses(for_types - imported(tree.body))
    uses.visit(tree)
    return uses.lines


def test_what_is_imported_for_types_is_used_in_annotations_alone() -> None:
    packages = ("hil", "drivers", "controllers", "virtual_bus")
    files: list[Path] = [path for package in packages for path in sorted((ROOT / package).rglob("*.py"))]
    found = {path.relative_to(ROOT).as_posix(): lines for path in files if (lines := used_at_run_time(path.read_text(encoding="utf-8")))}
    assert found == {}


@pytest.mark.parametrize(
    ("body", "found"),
    [
        ("def f(x: np.ndarray) -> float:\n    return np.sum(x)\n", {"4: np"}),
        ("def f(x: np.ndarray) -> float:\n    import numpy as np\n    return np.sum(x)\n", set()),
        ("def f(x: np.ndarray) -> float:\n    y: np.ndarray = x\n    return y[0]\n", set()),
    ],
)
def test_a_use_at_run_time_is_found(body: str, found: set[str]) -> None:
    assert used_at_run_time(f"if TYPE_CHECKING:\n    import numpy as np\n{body}") == found
