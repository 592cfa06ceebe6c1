"""What docstrings say, read from source without importing it."""

from __future__ import annotations

import ast
import inspect
from functools import cache
from itertools import pairwise
from pathlib import Path


@cache
def tree_of(path: Path) -> ast.Module:
    """Parse a source file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def attribute_docstrings(kind: type) -> dict[str, str]:
    """Return the docstring below every annotated attribute of a class, in one line each."""
    tree = tree_of(Path(inspect.getfile(kind)))
    body = next(node.body for node in ast.walk(tree) if isinstance(node, ast.ClassDef) and node.name == kind.__name__)
    found = {}
    for field, following in pairwise(body):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and (text := _text(following)):
            found[field.target.id] = " ".join(text.split())
    return found


def paragraphs(documented: object) -> list[str]:
    """Return the paragraphs of a docstring up to its first section, one line each; indented ones as they are."""
    text = inspect.cleandoc(documented.__doc__ or "")
    found = []
    for part in text.split("\n\n"):
        if "\n---" in part:
            break
        found.append(part if part.startswith("    ") else " ".join(part.split()))
    return found


def _text(node: ast.stmt) -> str:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
        return node.value.value
    return ""
