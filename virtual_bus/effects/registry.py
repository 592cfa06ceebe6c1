"""The list of known effects: every module of this package that holds an EFFECT. To add an effect is to add a file."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from pathlib import Path
from types import ModuleType

from virtual_bus.effects.effect import MAX_PARAMETERS, Effect
from virtual_bus.effects.readings import Readings, Shown


@cache
def _modules() -> dict[str, ModuleType]:
    found = {}
    for entry in sorted(pkgutil.iter_modules([str(Path(__file__).parent)]), key=lambda entry: entry.name):
        module = importlib.import_module(f"{__package__}.{entry.name}")
        effect = getattr(module, "EFFECT", None)
        if isinstance(effect, Effect):
            complete = all(hasattr(module, hook) for hook in (effect.kind.function, "laws"))
            if effect.name != entry.name or len(effect.parameters) > MAX_PARAMETERS or not complete:
                raise ImportError(
                    f"{module.__name__}: EFFECT must be named {entry.name!r}, have at most {MAX_PARAMETERS} parameters and define "
                    f"{effect.kind.function} and laws"
                )
            found[effect.name] = module
    return found


@cache
def effects() -> dict[str, Effect]:
    """Return every known effect by name, in alphabetical order."""
    return {name: module.EFFECT for name, module in _modules().items()}


def effect_number(name: str) -> int:
    """Return the number by which a compiled table refers to an effect."""
    return list(effects()).index(name)


def effect_sources() -> str:
    """Return the text of all effect files, on which a compiled plant depends."""
    return "\n".join(inspect.getsource(module) for module in _modules().values())


def module_of(name: str) -> ModuleType:
    """Return the module of an effect, which holds its hooks."""
    return _modules()[name]


def dispatcher_text(hook: str, function: str, nothing: str = "0.0") -> str:
    """Return the source of a compiled function `function(number, state, row)` that calls the hook of an effect by its number.

    `row` is the number, then the effect's parameters. `nothing` is what it returns for an effect without that hook.
    """
    chosen = [(number, effect) for number, effect in enumerate(effects().values()) if hasattr(module_of(effect.name), hook)]
    lines = []
    for _, effect in chosen:
        module = module_of(effect.name).__name__
        lines += [f"import {module}", f"_{function}_{effect.name} = compiled({module}.{hook})"]
    lines += ["", "", "@compiled_inside", f"def {function}(number, state, row):"]
    for number, effect in chosen:
        arguments = ", ".join(f"row[{1 + k}]" for k in range(len(effect.parameters)))
        lines += [f"    if number == {number}:", f"        return _{function}_{effect.name}(state, {arguments})"]
    lines += [f"    return {nothing}", ""]
    return "\n".join(lines)


def in_readings(name: str, readings: Readings) -> Shown | None:
    """Return an effect as the readings of a channel show it by themselves; None where they do not, or it is none that they could show."""
    module = module_of(name)
    return module.in_readings(readings) if hasattr(module, "in_readings") else None


def catalogue() -> list[dict[str, object]]:
    """Return names, parameters with units and bounds, sign conventions and allowed places of every effect, as plain data."""
    return [
        {
            "name": effect.name,
            "plain": effect.plain,
            "kind": effect.kind.name,
            "at": list(effect.kind.allowed_at),
            "needs": effect.kind.needs,
            "equation": effect.equation,
            "parameters": [
                {
                    "name": parameter.name,
                    "key": parameter.key(),
                    "unit": parameter.unit_at(prismatic=False),
                    "key_prismatic": parameter.key(prismatic=True),
                    "unit_prismatic": parameter.unit_at(prismatic=True),
                    "low": parameter.low,
                    "high": parameter.high,
                    "description": parameter.description,
                    "is_strength": parameter.is_strength,
                    "neutral": parameter.neutral if parameter.is_strength else None,
                }
                for parameter in effect.parameters
            ],
            "convention": effect.convention,
            "neighbours": list(effect.neighbours),
            "source": effect.source,
            "family": effect.family,
            "parent": effect.parent,
            "everyday": effect.everyday,
            "several": effect.several,
        }
        for effect in effects().values()
    ]
