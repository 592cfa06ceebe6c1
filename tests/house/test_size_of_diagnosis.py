"""The diagnosis stays small: its lines, and the numbers that were chosen in it, are counted."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from places import ROOT

LINES = 10_000 + 2_600 + 375
"""The second part is the judge by free runs, from `unknowns` to `selection`, beside the one along the motion until that goes. The third is
what that one lacked: numbers wrong by far, effects in the filter's equations, what held-out recordings say, how often verdicts are
right."""
NUMBERS = 245
"""Chosen numbers there are; lower it when some go."""
PLAIN = (0, 1, 2, 0.5)
"""Numbers that are no choice, of either sign."""


def chosen(tree: ast.Module) -> Iterator[float]:
    """Named constants, defaults of arguments and numbers in comparisons."""
    for node in ast.walk(tree):
        parts: list[ast.AST] = []
        if isinstance(node, ast.Module | ast.ClassDef):
            parts = [each.value for each in node.body if isinstance(each, ast.Assign | ast.AnnAssign) and each.value is not None]
        elif isinstance(node, ast.FunctionDef | ast.Lambda):
            parts = [each for each in (*node.args.defaults, *node.args.kw_defaults) if each is not None]
        elif isinstance(node, ast.Compare):
            sides = [each.operand if isinstance(each, ast.UnaryOp) else each for each in (node.left, *node.comparators)]
            parts = [each for each in sides if isinstance(each, ast.Constant)]
        for part in parts:
            for one in ast.walk(part):
                if isinstance(one, ast.Constant) and type(one.value) in (int, float) and one.value not in PLAIN:
                    yield float(one.value)


def test_the_diagnosis_has_no_more_lines_and_chosen_numbers_than_it_is_allowed() -> None:
    files = [path for path in (ROOT / "hil" / "diagnosis").rglob("*.py") if path.parent.name != "report"]
    texts = [path.read_text(encoding="utf-8") for path in files]
    assert sum(len(text.splitlines()) for text in texts) <= LINES
    assert sum(len(list(chosen(ast.parse(text)))) for text in texts) <= NUMBERS


def test_a_chosen_number_is_counted_and_a_plain_one_is_not() -> None:
    text = "A = 3.5\nB = (4, 2)\ndef f(x=7, y=1):\n    z = 9\n    return x > 11 or x < -12 or y == 0\n"
    assert sorted(chosen(ast.parse(text))) == [3.5, 4.0, 7.0, 11.0, 12.0]
