"""Effects files (TOML): physics added to a machine, by name and parameters with units.

[[effect]]
name = "coulomb_friction"
at = "roll"
Fc_Nm = 12.0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.errors import MachineFileError
from hil.machine.load import load_machine, parse_toml, read_text
from hil.machine.machine import Machine
from virtual_bus.effects.binding import as_entries, bind_effects, check_apart
from virtual_bus.errors import EffectError
from virtual_bus.settings import EffectSetting

KEYS = ("format", "effect")


def read_effects_file(path: str | Path, machine: Machine) -> tuple[EffectSetting, ...]:
    """Effects of a file, bound to the places of a machine.

    Raises
    ------
    MachineFileError
        One line: the file, which effect, what is wrong and what would be right.
    """
    file = Path(path)
    return effects_from_text(read_text(file, "give the path of an effects file"), machine, str(file))


def load_with_effects(name: str, effects: Path | None) -> Machine:
    """Load a machine, with the physics of an effects file added where one is given; raises as `load_machine` and `read_effects_file` do."""
    machine = load_machine(name)
    return machine if effects is None else machine.with_effects(read_effects_file(effects, machine))


def effects_from_text(text: str, machine: Machine, label: str) -> tuple[EffectSetting, ...]:
    """Effects from the text of an effects file; `label` is what messages call it."""
    raw = parse_toml(text, label)
    for key in raw:
        if key not in KEYS:
            raise MachineFileError(f"{label}: {key!r}: unknown key; an effects file holds [[effect]] tables")
    if raw.get("format", 1) != 1:
        raise MachineFileError(f"{label}: format = {raw['format']!r}: this version reads format 1")
    entries = raw.get("effect", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise MachineFileError(f"{label}: effect: must be tables; write [[effect]] above each")
    return bound_effects([_plain(entry) for entry in entries], machine, label)


def bound_effects(entries: Sequence[Mapping[str, object]], machine: Machine, label: str) -> tuple[EffectSetting, ...]:
    """Effects from tables as an effects file has them, each with `name`, `at` and parameters; MachineFileError says what is wrong."""
    try:
        bound = bind_effects(entries, machine.plant, label)
        check_apart(bound, machine.own_effects, label)
    except EffectError as error:
        raise MachineFileError(" ".join(str(error).split())) from None
    return bound


def effects_text(effects: Sequence[EffectSetting], machine: Machine) -> str:
    """Text of an effects file: the inverse of `effects_from_text`."""
    lines = ["format = 1"]
    for entry in as_entries(effects, machine.plant):
        lines += ["", "[[effect]]"]
        lines += [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}" for key, value in entry.items()]
    return "\n".join(lines) + "\n"


def write_effects_file(effects: Sequence[EffectSetting], machine: Machine, path: str | Path) -> None:
    """Write an effects file."""
    try:
        Path(path).write_text(effects_text(effects, machine), encoding="utf-8")
    except OSError as error:
        raise MachineFileError(f"{path}: cannot be written: {error.strerror}") from None


def _plain(entry: dict[str, Any]) -> dict[str, Any]:
    """Whole numbers as floats where they fit one; what does not is left for the check to refuse as no number."""
    return {key: [_as_float(each) for each in value] if isinstance(value, list) else _as_float(value) for key, value in entry.items()}


def _as_float(value: object) -> object:
    if not isinstance(value, int) or isinstance(value, bool):
        return value
    try:
        return float(value)
    except OverflowError:
        return "a number beyond every bound"
