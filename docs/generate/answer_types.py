"""Rows of the reference of JSON answers, from the fields of a verb's answer and what stands below each."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import sys
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Any

import numpy as np

from docs.generate.docstrings import attribute_docstrings, tree_of
from docs.generate.format_tables import Entry

_WORDS = {str: "text", Path: "text", bool: "true or false", int: "number", float: "number", NoneType: "null", Any: "any"}


def entries(kind: type, prefix: str = "") -> tuple[Entry, ...]:
    """Return a row for every key of an answer, those of answers within it below their own."""
    said = attribute_docstrings(kind)
    rows = []
    for name, annotation in _json_fields(kind).items():
        rows.append(Entry(prefix + name, _shape(annotation), said[name]))
        inner, path = _inner(annotation)
        if inner is not None and _json_fields(inner).keys() <= attribute_docstrings(inner).keys():
            rows += entries(inner, f"{prefix}{name}{path}.")
    return tuple(rows)


def _json_fields(kind: type) -> dict[str, Any]:
    hints = typing.get_type_hints(kind, localns=_for_types(kind))
    return {each.name: hints[each.name] for each in dataclasses.fields(kind) if each.metadata.get("json", True)}


def _for_types(kind: type) -> dict[str, Any]:
    """Return what the module of a class imports for type checkers alone."""
    found: dict[str, Any] = {}
    for node in tree_of(Path(inspect.getfile(kind))).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            exec(ast.unparse(ast.Module(node.body, [])), vars(sys.modules[kind.__module__]).copy(), found)
    return found


def _inner(annotation: Any) -> tuple[type | None, str]:  # noqa: ANN401 - a type of any form
    """Return the dataclass of which an answer has one, a list or an object, and how its keys follow."""
    arguments = [each for each in typing.get_args(annotation) if each not in (NoneType, ...)]
    origin = typing.get_origin(annotation)
    path = "" if origin in (None, typing.Union, UnionType) else ".NAME" if _is(origin, Mapping) else "[]"
    for each in arguments or [annotation]:
        if dataclasses.is_dataclass(each) and isinstance(each, type):
            return each, path
    return None, ""


def _shape(annotation: Any) -> str:  # noqa: ANN401 - a type of any form
    """Return in words what JSON has of a type."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, UnionType):
        return " or ".join(dict.fromkeys(_shape(each) for each in arguments))
    if origin is typing.Literal:
        return "text"
    if _is(origin, Mapping) or dataclasses.is_dataclass(annotation):
        return "object"
    if _is(origin, Sequence) or annotation is np.ndarray:
        return "list of text" if set(arguments) - {...} == {str} else "list"
    return _WORDS[annotation]


def _is(origin: Any, kind: type) -> bool:  # noqa: ANN401 - a type of any form
    return isinstance(origin, type) and issubclass(origin, kind)
