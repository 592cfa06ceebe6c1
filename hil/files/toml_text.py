"""Writer of metadata as TOML text; what it writes reads back equal with `tomllib`."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, cast, overload

import numpy as np

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_LONG_TEXT = 80  # a longer text with line breaks (a machine file) is written over several lines to be readable


@overload
def plain(value: Mapping[str, object], where: str = "metadata") -> dict[str, Any]: ...
@overload
def plain(value: object, where: str = "metadata") -> object: ...
def plain(value: object, where: str = "metadata") -> object:
    """Copy `value` with NumPy scalars, arrays and tuples as plain Python values; keys whose value is None are left out.

    Raises
    ------
    TypeError
        TOML cannot hold a value; the message says which.
    """
    if isinstance(value, Mapping):
        return {_key_text(key, where): plain(item, f"{where}.{key}") for key, item in value.items() if item is not None}
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), where)
    if isinstance(value, list | tuple):
        return [plain(item, f"{where}[{position}]") for position, item in enumerate(value)]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str) and not _is_unicode(value):
        raise TypeError(f"{where}: the text {value!r} is no Unicode text")
    if isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{where}: a {type(value).__name__} cannot be kept in TOML; numbers, texts, lists and tables can")


def toml_text(table: Mapping[str, object]) -> str:
    """Return the TOML text of a table of plain values (see `plain`)."""
    return "\n".join(_table_lines(plain(table), ())) + "\n"


def _key_text(key: object, where: str) -> str:
    if not isinstance(key, str):
        raise TypeError(f"{where}: the key {key!r} is no text")
    plain(key, where)
    return key


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _table_lines(table: Mapping[str, object], path: tuple[str, ...]) -> list[str]:
    lines = [f"{_key(key)} = {_value(item)}" for key, item in table.items() if not isinstance(item, Mapping)]
    for key, item in table.items():
        if isinstance(item, Mapping):
            lines += ["", f"[{'.'.join(_key(part) for part in (*path, key))}]", *_table_lines(item, (*path, key))]
    return lines


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _text(key)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else str(value)
    if isinstance(value, str):
        return _long_text(value) if "\n" in value and len(value) > _LONG_TEXT else _text(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items()) + "}"
    return "[" + ", ".join(_value(item) for item in cast(Sequence[object], value)) + "]"


def _text(text: str) -> str:
    return '"' + "".join(_escaped(character) for character in text) + '"'


def _long_text(text: str) -> str:
    return '"""\n' + "".join(character if character == "\n" else _escaped(character) for character in text) + '"""'


def _escaped(character: str) -> str:
    if character in '"\\':
        return "\\" + character
    code = ord(character)
    if (code < 0x20 and character != "\t") or code == 0x7F:
        return f"\\u{code:04X}"
    return character
