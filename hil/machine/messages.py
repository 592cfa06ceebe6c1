"""Complaints about a file, in one line: `FILE: key.path = value: what is wrong; what would be right`."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

_LONGEST_VALUE = 60


class ComplaintError(Exception):
    """Something wrong at one place of the file, found after the tables were read. `where` is the path of keys."""

    def __init__(self, where: tuple[str | int, ...], what: str) -> None:
        super().__init__(what)
        self.where = where
        self.what = what


def one_line(file: str, raw: dict[str, Any], complaint: ComplaintError) -> str:
    """Write the complaint with its place and the value that the file has there."""
    path, value, found = _walk(raw, complaint.where)
    shown = f" = {_shown(value)}" if found and not isinstance(value, dict) else ""
    place = f"{path}{shown}: " if path else ""
    return " ".join(f"{file}: {place}{complaint.what}".split())


def from_validation(error: ValidationError) -> ComplaintError:
    """First of pydantic's errors, in the words of this project."""
    details = error.errors(include_url=False, include_input=False)
    first = details[0]
    context = first.get("ctx", {})
    where = tuple(part for part in first["loc"] if part != "[key]")
    if "key" in context:
        where = (*where, str(context["key"]))
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    return ComplaintError(where, _words(first["type"], context, first["msg"]) + more)


def _words(kind: str, context: dict[str, Any], message: str) -> str:
    match kind:
        case "greater_than" if context["gt"] == 0:
            return "must be positive"
        case "greater_than":
            return f"must be greater than {context['gt']:g}"
        case "greater_than_equal" if context["ge"] == 0:
            return "must not be negative"
        case "greater_than_equal":
            return f"must be at least {context['ge']}"
        case "less_than_equal":
            return f"must be at most {context['le']}"
        case "float_type" | "float_parsing":
            return "must be a number"
        case "finite_number":
            return "must be a finite number"
        case "int_type" | "int_from_float" | "int_parsing" | "int_parsing_size":
            return "must be a whole number"
        case "bool_type":
            return "must be true or false"
        case "string_type":
            return 'must be text in quotes, "like this"'
        case "string_too_short":
            return "must not be empty"
        case "string_too_long":
            return f"must be at most {context['max_length']} characters long"
        case "string_pattern_mismatch":
            return "must be a name: a letter, then letters, digits and _"
        case "literal_error":
            return f"must be {context['expected']}"
        case "union_tag_not_found":
            return 'needs a type: "encoder", "current", "imu" or "temperature"'
        case "union_tag_invalid":
            return f"unknown type; write one of {context['expected_tags']}"
        case "tuple_type" | "list_type":
            return "must be a list"
        case "dict_type" | "model_type":
            return "must be a table"
        case "too_short":
            return f"must have at least {context['min_length']} entries, has {context['actual_length']}"
        case "too_long":
            return f"must have at most {context['max_length']} entries, has {context['actual_length']}"
        case "missing":  # an entry of a list of fixed length
            return "is missing; the list is too short"
    return message


def _walk(raw: object, where: tuple[str | int, ...]) -> tuple[str, object, bool]:
    """Path as a person reads it, the value there, and whether it exists. Keys match with or without their unit."""
    path = ""
    value, found = raw, True
    for part in where:
        if found and isinstance(value, list) and isinstance(part, int) and 0 <= part < len(value):
            value = value[part]
            label = value.get("name") if isinstance(value, dict) else None
            path += f".{_plain(label)}" if isinstance(label, str) else f"[{part}]"
            continue
        if found and isinstance(value, dict) and part not in value:
            if value.get("type") == part:  # the tag of a union of tables is no key
                continue
            written = [key for key in value if isinstance(part, str) and key.startswith(part + "_")]
            part = written[0] if len(written) == 1 else part
        found = found and isinstance(value, dict) and part in value
        value = value[part] if found and isinstance(value, dict) else None
        path += f"[{part}]" if isinstance(part, int) else f".{_plain(part)}"
    return path.lstrip("."), value, found


def _plain(text: str) -> str:
    shown = text.encode("unicode_escape").decode()
    return shown if len(shown) <= _LONGEST_VALUE else shown[:_LONGEST_VALUE] + "…"


def _shown(value: object) -> str:
    try:
        text = _toml(value)
    except ValueError:  # an integer too long to print
        text = "a very long number"
    return text if len(text) <= _LONGEST_VALUE else text[:_LONGEST_VALUE] + "…"


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + _plain(value) + '"'
    if isinstance(value, list):
        return "[" + ", ".join("{…}" if isinstance(entry, dict) else _toml(entry) for entry in value) + "]"
    return str(value)
