"""The reference of the machine file, from the tables of `hil.machine.schema`."""

from __future__ import annotations

import types
from collections.abc import Iterator
from typing import Annotated, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, MaxLen, MinLen
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from docs.generate.docstrings import attribute_docstrings, paragraphs
from docs.generate.markdown import code, number, sentence, table
from docs.generate.markdown import page as whole
from drivers.canopen.objects import MAPPABLE
from hil.machine.load import list_shipped
from hil.machine.schema import MachineTable
from hil.machine.table import Table
from hil.machine.units import UNITS, Quantity

INTRODUCTION = """
Every table and key of a machine file (TOML) is listed here, with units, ranges and defaults. Start from a shipped
machine as [Describe your own machine](../how-to/your-own-machine.md) shows. `isocenter machine show M` prints what
was understood; `isocenter machine check M` prints what follows from it. Frames and signs are in
[Notation](../explanation/notation.md).

Editors complete and check machine files by their [JSON schema](../../hil/machine/shipped/isocenter-machine.schema.json), which
`isocenter machine schema -o isocenter-machine.schema.json` writes. A file's first line, `#:schema
isocenter-machine.schema.json`, names the schema beside it for taplo and Even Better TOML; it is no part of the machine's
hash. What two keys say together only `isocenter machine check` sees.
"""

UNITS_TEXT = """
A key ends in its unit: `stiffness_UNIT` stands for `stiffness_Nm_rad` or any other unit in its row. A revolute joint
takes the angular units, a prismatic joint the linear ones. The first unit of a kind is the one that values are kept
in.
"""

ERRORS_TEXT = """
Anything wrong is reported in one line and nothing runs. The line has the form `FILE: key.path = value: what is wrong;
what would be right`. Unknown keys are errors. A name is a letter followed by letters, digits and `_`, at most 60
characters long.
"""


def page() -> str:
    """Write the page."""
    parts = [INTRODUCTION, "## Shipped machines", table(("machine", "what it is"), sorted(_shipped())), "## Units", UNITS_TEXT, _units()]
    parts += ["## Errors", ERRORS_TEXT]
    for kind in tables():
        summary, *more = paragraphs(kind)
        title, _, rest = summary.partition(": ")
        level = "###" if title.partition("`")[2].startswith(("[body.", "[bus.", "[[bus.", "[judging.", "[budgets.")) else "##"
        heading = "## Top level" if kind is MachineTable else f"{level} {title.removeprefix('Table ').removeprefix('Tables ')}"
        parts += [heading, sentence(rest), *more, table(("key", "unit", "value", "default", "meaning"), _rows(kind))]
    parts += ["## Objects of a PDO", "A PDO names an object by its index, or by one of these names.", _objects()]
    return whole("Machine file", *parts)


def tables(kind: type[Table] = MachineTable) -> list[type[Table]]:
    """List a table and all those inside it, each once, in the order of the file."""
    found = [kind]
    for info in kind.model_fields.values():
        for inner in _tables_in(info.annotation):
            found += [each for each in tables(inner) if each not in found]
    return found


def quantity(info: FieldInfo) -> Quantity | None:
    """Return the quantity that a key's unit belongs to, where it has one."""
    return next((mark for mark in info.metadata if isinstance(mark, Quantity)), None)


def _shipped() -> Iterator[tuple[str, str]]:
    for name, description in list_shipped().items():
        yield code(name), sentence(description)


def _units() -> str:
    return table(
        ("kind", "units at the end of a key"),
        ((name.replace("_", " "), ", ".join(code(unit) for unit in units)) for name, units in UNITS.items()),
    )


def _objects() -> str:
    rows = ((code(name), f"{index:04X}h, {subindex}", str(bits)) for name, (index, subindex, bits) in MAPPABLE.items())
    return table(("name", "index, subindex", "bits"), rows)


def _rows(kind: type[Table]) -> Iterator[tuple[str, ...]]:
    meanings = attribute_docstrings(kind)
    for name, info in kind.model_fields.items():
        yield *key_and_units(name, info), value_words(info), _default(info), meanings[name]


def key_and_units(name: str, info: FieldInfo) -> tuple[str, str]:
    """Write a key, and the units that it may end in."""
    unit = quantity(info)
    if unit is None:
        return code(name), ""
    return code(f"{name}_UNIT"), "; ".join(", ".join(code(each) for each in UNITS[dimension]) for dimension in unit.dimensions)


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    if info.default is PydanticUndefined or info.default in (None, ()):
        return "none"
    if isinstance(info.default, bool):
        return code(str(info.default).lower())
    if isinstance(info.default, tuple):
        values = [f'"{each}"' if isinstance(each, str) else number(each) for each in info.default]
        return code(f"[{', '.join(values)}]")
    return code(f'"{info.default}"' if isinstance(info.default, str) else number(info.default))


def value_words(info: FieldInfo) -> str:
    """Write in words what values a key takes."""
    return _kind(info.annotation, list(info.metadata))


def _kind(annotation: object, marks: list[object]) -> str:
    """Write in words what values an annotation takes."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inner[0], [*_flat(inner[1:]), *marks])
    if origin is Union or isinstance(annotation, types.UnionType):
        kinds = [each for each in inner if each is not type(None)]
        return "table" if len(kinds) > 1 else _kind(kinds[0], marks)
    if origin is Literal:
        return " or ".join(code(f'"{each}"' if isinstance(each, str) else str(each)) for each in inner)
    if origin is dict:
        of = _kind(inner[1], [])
        return "tables by name" if of == "table" else f"table of name = {of}"
    if origin is tuple:
        if inner[-1] is Ellipsis:
            of = _kind(inner[0], [])
            return "tables" if of == "table" else f"list ({of}){_bounds(marks)}"
        ones = list(dict.fromkeys(_kind(each, []) for each in inner))
        return f"{len(inner)} × {ones[0]}" if len(ones) == 1 else "[" + ", ".join(ones) + "]"
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return "table"
    words = {float: "number", int: "whole number", bool: "true or false"}
    if annotation in words:
        return words[annotation] + _bounds(marks)
    return "name" if any(getattr(mark, "pattern", None) for mark in marks) else "text"


def _flat(marks: tuple[object, ...]) -> Iterator[object]:
    for mark in marks:
        if isinstance(mark, FieldInfo):
            yield from mark.metadata
        else:
            yield mark


def _bounds(marks: list[object]) -> str:
    said = []
    for mark in marks:
        match mark:
            case Gt(gt=low):
                said.append(f"above {number(low)}")  # type: ignore[arg-type]
            case Ge(ge=low):
                said.append(f"{number(low)} or more")  # type: ignore[arg-type]
            case Le(le=high):
                said.append(f"at most {number(high)}")  # type: ignore[arg-type]
            case MinLen(min_length=least):
                said.append(f"at least {least}")
            case MaxLen(max_length=most):
                said.append(f"at most {most}")
    return f", {', '.join(said)}" if said else ""


def _tables_in(annotation: object) -> Iterator[type[Table]]:
    if isinstance(annotation, type) and issubclass(annotation, Table):
        yield annotation
    for inner in get_args(annotation):
        yield from _tables_in(inner)
