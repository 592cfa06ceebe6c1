"""The JSON schema of the machine file (draft 7), by which editors complete and check, from the tables of `hil.machine.schema`."""

from __future__ import annotations

import json
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from docs.generate.docstrings import attribute_docstrings, paragraphs
from docs.generate.machine_file import quantity, tables
from hil.machine.schema import MachineTable
from hil.machine.table import Table

DRAFT = "http://json-schema.org/draft-07/schema#"
"""The draft that taplo, and so Even Better TOML, knows whole."""

TITLE = "Machine file of Isocenter"

DIGITS = 12
"""Of a bound in another unit than SI: 1000 s^-1 shall not become 999.9999999999999 of them."""

Schema = dict[str, Any]


def page() -> str:
    """Write the schema."""
    top, *inner = tables(MachineTable)
    schema = {"$schema": DRAFT, "title": TITLE, **_table(top), "definitions": {kind.__name__: _table(kind) for kind in inner}}
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def _table(kind: type[Table]) -> Schema:
    """Return the schema of one table: a property for each key in each of its units."""
    meanings = attribute_docstrings(kind)
    properties: Schema = {}
    required, chosen = [], []
    for name, info in kind.model_fields.items():
        keys = dict(_keys(name, info))
        for key, factor in keys.items():
            properties[key] = _value(info.annotation, list(info.metadata), factor) | _words(meanings[name], info)
        if len(keys) == 1 and info.is_required():
            required += keys
        elif info.is_required():  # so told, an editor names the key; a plain `anyOf` would underline the whole table
            there = {"anyOf": [{"required": [key]} for key in keys]}
            chosen.append({"if": {"not": there}, "then": {"required": [next(iter(keys))]}})
    schema: Schema = {"type": "object", "description": " ".join(paragraphs(kind)), "properties": properties, "additionalProperties": False}
    return schema | ({"required": required} if required else {}) | ({"allOf": chosen} if chosen else {})


def _keys(name: str, info: FieldInfo) -> Iterator[tuple[str, float]]:
    """Yield a field's keys, with the factor of their unit to SI."""
    unit = quantity(info)
    if unit is None:
        yield name, 1.0
    else:
        yield from ((f"{name}_{each}", factor) for each, factor in unit.units.items())


def _words(meaning: str, info: FieldInfo) -> Schema:
    default = info.default
    said = (
        "" if default in (PydanticUndefined, None, (), "") or info.is_required() or quantity(info) else f" Default: {json.dumps(default)}."
    )
    return {"description": meaning + said}


def _value(annotation: object, marks: list[object], factor: float = 1.0) -> Schema:
    """Return the schema of a value; numbers are bounded in their own unit."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _value(inner[0], [*_flat(inner[1:]), *marks], factor)
    if origin is Union or isinstance(annotation, types.UnionType):
        kinds = [_value(each, marks, factor) for each in inner if each is not type(None)]
        return kinds[0] if len(kinds) == 1 else {"oneOf": kinds}
    if origin is Literal:
        return {"enum": list(inner)}
    if origin is dict:
        names = _value(inner[0], [])
        least = max((mark.min_length for mark in marks if isinstance(mark, MinLen)), default=0)
        return {"type": "object", "propertyNames": names, "additionalProperties": _value(inner[1], []), "minProperties": least}
    if origin is tuple:
        return _list(inner, marks, factor)
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return {"$ref": f"#/definitions/{annotation.__name__}"}
    words = {float: "number", int: "integer", bool: "boolean", str: "string"}
    assert isinstance(annotation, type)
    return {"type": words[annotation], **_bounds(marks, factor, isinstance(annotation, type) and issubclass(annotation, str))}


def _list(inner: tuple[Any, ...], marks: list[object], factor: float) -> Schema:
    if inner[-1] is Ellipsis:
        found = {"type": "array", "items": _value(inner[0], [], factor)}
        for mark in marks:
            match mark:
                case MinLen(min_length=least):
                    found["minItems"] = least
                case MaxLen(max_length=most):
                    found["maxItems"] = most
        return found
    ones = [_value(each, [], factor) for each in inner]
    items: object = ones[0] if all(one == ones[0] for one in ones) else ones
    return {"type": "array", "items": items, "minItems": len(ones), "maxItems": len(ones)}


def _flat(marks: tuple[object, ...]) -> Iterator[object]:
    for mark in marks:
        if isinstance(mark, FieldInfo):
            yield from mark.metadata
        else:
            yield mark


def _bounds(marks: list[object], factor: float, text: bool) -> Schema:
    found: Schema = {}
    for mark in marks:
        match mark:
            case Gt(gt=low):
                found["exclusiveMinimum"] = _in_unit(low, factor)
            case Ge(ge=low):
                found["minimum"] = _in_unit(low, factor)
            case Lt(lt=high):
                found["exclusiveMaximum"] = _in_unit(high, factor)
            case Le(le=high):
                found["maximum"] = _in_unit(high, factor)
            case MinLen(min_length=least) if text:
                found["minLength"] = least
            case MaxLen(max_length=most) if text:
                found["maxLength"] = most
        if pattern := getattr(mark, "pattern", None):
            found["pattern"] = pattern
    return found


def _in_unit(bound: Any, factor: float) -> float:  # noqa: ANN401 - whatever can be compared is a bound of annotated_types
    return bound if factor == 1.0 else float(f"{bound / factor:.{DIGITS}g}")
