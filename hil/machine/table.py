"""One table of the machine file: keys checked by name, units taken from their ends, values in SI afterwards."""

from __future__ import annotations

import difflib
import re
from functools import cache
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ModelWrapValidatorHandler, PrivateAttr, model_validator
from pydantic_core import PydanticCustomError

from hil.machine.units import Quantity

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True)]
Name = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=60)]
MACHINE_NAME = r"^[A-Za-z][A-Za-z0-9_-]*$"
MachineName = Annotated[str, Field(strict=True, pattern=MACHINE_NAME, max_length=60)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Vector = tuple[Number, Number, Number]


def is_name(text: str) -> bool:
    """Tell whether a text is what a machine may be called, and no path."""
    return re.fullmatch(MACHINE_NAME, text) is not None


class Table(BaseModel):
    """Base of every table of the machine file. A field marked with `Quantity` is written as `<field>_<unit>`."""

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)
    _keys: dict[str, str] = PrivateAttr(default_factory=dict)

    @model_validator(mode="wrap")
    @classmethod
    def _read_keys(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        if not isinstance(data, dict):
            raise PydanticCustomError("table", "must be a table; write [name] or { key = value }")
        values: dict[str, Any] = {}
        keys: dict[str, str] = {}
        for key, value in data.items():
            field, factor = field_of(cls, str(key))
            if field in keys:
                raise PydanticCustomError("twice", "says the same as {other}; keep one of them", {"key": key, "other": keys[field]})
            keys[field] = key
            values[field] = value if factor is None else _scaled(value, factor)
        for field, info in cls.model_fields.items():
            if info.is_required() and field not in values:
                raise PydanticCustomError("missing_key", "is missing", {"key": written_key(cls, field), "absent": True})
        table = handler(values)
        table._keys = keys
        return table

    def key(self, field: str) -> str:
        """Return the key as the file has it, or as it could be written."""
        return self._keys.get(field, written_key(type(self), field))

    def has(self, field: str) -> bool:
        """Tell whether the file says this field."""
        return field in self._keys

    def dimension(self, field: str) -> str | None:
        """Return the dimension of the file's unit; None when the key was left out."""
        if field not in self._keys:
            return None
        quantity = _quantities(type(self))[field]
        return quantity.dimension_of(self._keys[field][len(field) + 1 :])

    def unit(self, field: str) -> str:
        """Return the unit that the file wrote the quantity in; "" when the key was left out."""
        return self._keys[field][len(field) + 1 :] if field in self._keys else ""


@cache
def _quantities(table: type[Table]) -> dict[str, Quantity]:
    found = {}
    for name, info in table.model_fields.items():
        for mark in info.metadata:
            if isinstance(mark, Quantity):
                found[name] = mark
    return found


def written_key(table: type[Table], field: str) -> str:
    """Write a field as in the file, with the first unit that it may have."""
    quantity = _quantities(table).get(field)
    return field if quantity is None else f"{field}_{next(iter(quantity.units))}"


def field_of(table: type[Table], key: str) -> tuple[str, float | None]:
    """Return the field that a key means, and the factor of its unit to SI (None: no unit)."""
    quantities = _quantities(table)
    if key in table.model_fields and key not in quantities:
        return key, None
    stems = sorted((stem for stem in quantities if key.startswith(stem + "_")), key=len, reverse=True)
    for stem in stems:
        factor = quantities[stem].units.get(key[len(stem) + 1 :])
        if factor is not None:
            return stem, factor
    if key in quantities:
        raise PydanticCustomError("unit", "needs its unit: write {choices}", {"key": key, "choices": _choices(key, quantities[key])})
    if stems:
        message = "unknown unit {unit}; write {choices}"
        raise PydanticCustomError(
            "unit", message, {"key": key, "unit": key[len(stems[0]) + 1 :], "choices": _choices(stems[0], quantities[stems[0]])}
        )
    possible = [written_key(table, field) for field in table.model_fields]
    close = difflib.get_close_matches(key, possible, n=1, cutoff=0.5)
    right = f"did you mean {close[0]}?" if close else "keys of this table: " + ", ".join(possible)
    raise PydanticCustomError("unknown_key", "unknown key; {right}", {"key": key, "right": right})


def _choices(stem: str, quantity: Quantity) -> str:
    return " or ".join(f"{stem}_{unit}" for unit in quantity.units)


def _scaled(value: object, factor: float) -> object:
    """Multiply a number or nested list of numbers; return anything else as it is, for the type check to refuse."""
    if isinstance(value, list):
        return [_scaled(entry, factor) for entry in value]
    if isinstance(value, bool) or not isinstance(value, int | float) or factor == 1.0:
        return value
    try:
        return value * factor
    except OverflowError:  # an integer beyond the range of a float
        return float("inf")
