"""The machine file's page explains every key the schema knows."""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator

from places import ROOT
from pydantic import BaseModel

from drivers.canopen.objects import MAPPABLE
from hil.machine.schema import (
    MachineTable,
)
from hil.machine.table import written_key
from hil.machine.units import CONSTANT_UNITS, UNITS

PAGE = (ROOT / "docs" / "generated" / "machine-file.md").read_text(encoding="utf-8")
EXPLAINED = set(re.findall(r"`([^`\s]+)`", PAGE))


def tables(annotation: object) -> Iterator[object]:
    """Every table a field's type is made of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        for field in annotation.model_fields.values():
            yield from tables(field.annotation)
    for argument in typing.get_args(annotation):
        yield from tables(argument)


def test_every_key_is_explained() -> None:
    missing = []
    for table in set(tables(MachineTable)):
        for field in table.model_fields:
            written = written_key(table, field)
            if written != field:
                stem_explained = any(word.startswith(field + "_") for word in EXPLAINED)
                if not stem_explained:
                    missing.append(f"{table.__name__}.{written}")
            elif field not in EXPLAINED:
                missing.append(f"{table.__name__}.{field}")
    assert sorted(missing) == []


def test_every_unit_and_object_name_is_listed() -> None:
    units = {unit for dimension in UNITS.values() for unit in dimension if not unit.startswith("K_per")}
    assert units <= EXPLAINED
    assert {f'"{unit}"' for unit in CONSTANT_UNITS} <= EXPLAINED
    assert set(MAPPABLE) <= EXPLAINED
