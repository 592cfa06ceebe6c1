"""References to the thesis, collected from docstrings and comments: chapter, section or equation to `file:symbol`."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from docs.generate.thesis_sections import SECTIONS

PACKAGES = ("controllers", "drivers", "hil", "virtual_bus")

_SECTION = r"\d\.\d+(?:\.\d+)?(?![\d.]*\d)"
_SECTIONS = re.compile(rf"(?:\bSecs?\.|\bSections?|\b[Tt]hesis)\s+({_SECTION}(?:(?:,? and |, | to ){_SECTION})*)")
_CHAPTER = re.compile(r"\b(?:Chapter|Chap\.)\s+([2-8])\b")
_APPENDIX = re.compile(r"\bAppendix (B)\b")
_EQUATION = re.compile(r"\(([2-7B])\.(\d+)\)(?:(?:\s+to\s+|\s*-\s*)\(\1\.(\d+)\))?")
_LAST = {chapter: max(section.last for section in SECTIONS if section.number[0] == chapter) for chapter in "234567B"}
_ELSEWHERE = re.compile(r"Kak and Slaney|CiA|Featherstone|Hanselman|Spong")
"""Lines that cite another source: their numbers are not the thesis's."""


class Reference(NamedTuple):
    """One place of the code that names a part of the thesis."""

    part: str  # "3", "3.4.1", "(3.18)" or "B"
    place: str  # `file`, or `file:symbol`


class _Scope(NamedTuple):
    first: int
    last: int
    name: str


def references(root: Path, packages: Iterable[str] = PACKAGES) -> list[Reference]:
    """Collect the references of all Python files of some packages, sorted, each once."""
    found = set()
    for package in packages:
        for path in sorted((root / package).rglob("*.py")):
            name = path.relative_to(root).as_posix()
            found |= set(references_of(path.read_text(encoding="utf-8"), name))
    return sorted(found)


def references_of(source: str, file: str) -> Iterator[Reference]:
    """Yield the references of one file; its symbols are functions, classes, methods, and names that a docstring stands below."""
    if not any(True for _ in parts_in(source)):  # most files name nothing: do not parse them
        return
    tree = ast.parse(source)
    scopes = list(_scopes(tree))
    for line, text in _texts(source, tree):
        inside = [scope for scope in scopes if scope.first <= line <= scope.last]
        place = f"{file}:{min(inside, key=lambda scope: scope.last - scope.first).name}" if inside else file
        for part in parts_in(text):
            yield Reference(part, place)


def parts_in(text: str) -> Iterator[str]:
    """Yield the parts of the thesis that a text names: sections, chapters, equations with ranges written out."""
    text = "\n".join(line for line in text.split("\n") if not _ELSEWHERE.search(line))
    for match in _SECTIONS.finditer(text):
        yield from re.findall(_SECTION, match[1])
    yield from _CHAPTER.findall(text)
    yield from _APPENDIX.findall(text)
    for chapter, first, last in _EQUATION.findall(text):
        for number in range(int(first), int(last or first) + 1):
            if 1 <= number <= _LAST[chapter]:
                yield f"({chapter}.{number})"


def symbols(source: str) -> set[str]:
    """List the symbols that a place may name: functions, classes, methods (`Class.method`) and assigned names."""
    return {scope.name for scope in _scopes(ast.parse(source))}


def _scopes(tree: ast.AST, prefix: str = "") -> Iterator[_Scope]:
    body = getattr(tree, "body", [])
    for node, following in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            yield _Scope(first, node.end_lineno or 0, prefix + node.name)
            if isinstance(node, ast.ClassDef):
                yield from _scopes(node, f"{prefix}{node.name}.")
        elif name := _assigned(node):
            has_docstring = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
            last = following.end_lineno if has_docstring and following is not None else node.end_lineno
            yield _Scope(node.lineno, last or 0, prefix + name)


def _assigned(node: ast.stmt) -> str:
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
        return node.targets[0].id
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        return node.target.id
    return ""


def _texts(source: str, tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield comments, and strings that stand alone as a statement, with the line they begin in."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
