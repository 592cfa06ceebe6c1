"""Marks in the comments of a machine file: `# key = ?` is an open point, `# assumed: …` behind a key an assumption."""

from __future__ import annotations

import re
from dataclasses import dataclass

_TABLE = re.compile(r"\s*\[{1,2}([^\[\]]+)\]{1,2}")
_OPEN = re.compile(r"\s*#\s*([A-Za-z0-9_]+)\s*=\s*\?\s*(?:#\s*(.*))?$")
_ASSUMED = re.compile(r"\s*([A-Za-z0-9_]+)\s*=\s*(.*?)\s*#\s*assumed: (.*)$")
_NAME = re.compile(r"""\s*name\s*=\s*["']([^"']+)["']""")


@dataclass(frozen=True)
class Mark:
    """One mark: the key's path, its line from 1, and what the comment says. `value` is the text of an assumed value."""

    line: int
    key: str
    says: str
    value: str = ""


def marks(text: str) -> tuple[list[Mark], list[Mark]]:
    """Return the open points and the assumptions of a machine file's text."""
    table, name = "", ""
    missing, assumed = [], []
    for number, line in enumerate(text.splitlines(), 1):
        if found := _TABLE.match(line):
            table = found[1].strip()
            name = name if table.startswith("body.") else ""
        elif found := _NAME.match(line):
            name = found[1] if table == "body" else name
        if found := _OPEN.match(line):
            missing.append(Mark(number, _path(table, name, found[1]), (found[2] or "").strip()))
        elif found := _ASSUMED.match(line):
            assumed.append(Mark(number, _path(table, name, found[1]), found[3].strip(), found[2]))
    return missing, assumed


def _path(table: str, name: str, key: str) -> str:
    """Return the path as the messages of the loader have it: bodies by their names."""
    parts = table.split(".") if table else []
    if parts[:1] == ["body"] and name:
        parts.insert(1, name)
    return ".".join([*parts, key])
