"""What editors need to complete and check a machine file: its JSON schema, and the line that names it."""

from __future__ import annotations

import re
from pathlib import Path

SCHEMA = Path(__file__).resolve().parent / "shipped" / "isocenter-machine.schema.json"
"""The schema, made by `python -m docs.generate` from the tables of `hil.machine.schema`."""

SCHEMA_LINE = f"#:schema {SCHEMA.name}"
"""First line of a machine file, as taplo and Even Better TOML read it: the schema is beside the file."""

_SCHEMA_LINE = re.compile(r"\A#:schema[^\n]*\n")


def without_schema_line(text: str) -> str:
    """Return a machine file's text as its hash is taken: where an editor finds the schema is no part of the machine."""
    return _SCHEMA_LINE.sub("", text)


def with_header(text: str, line: str) -> str:
    """Return a machine file's text with a comment on top, below the line for editors."""
    schema = _SCHEMA_LINE.match(text)
    start = schema.end() if schema else 0
    return f"{text[:start]}{line}\n{text[start:]}"
