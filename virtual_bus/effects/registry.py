"""Which effects there are: every module of this package that holds an EFFECT. Adding one is adding a file."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from types import ModuleType

import virtual_bus.effects
from virtual_bus.effects.effect import MAX_PARAMETERS, Effect, EffectKind


@cache
def _modules() -> dict[str, ModuleType]:
    found = {}
    for entry in sorted(pkgutil.iter_modules(virtual_bus.effects.__path__), key=lambda entry: entry.name):
        module = importlib.import_module(f"{virtual_bus.effects.__name__}.{entry.name}")
        effect = getattr(module, "EFFECT", None)
        if isinstance(effect, Effect):
            if effect.name != entry.name or len(effect.parameters) > MAX_PARAMETERS or not hasattr(module, effect.kind.function):
                raise ImportError(
                    f"{module.__name__}: EFFECT must be named {entry.name!r}, have at most {MAX_PARAMETERS} parameters and define "
                    f"{effect.kind.function}()"
                )
            found[effect.name] = module
    return found


@cache
def effects() -> dict[str, Effect]:
    """Every known effect by name, in alphabetical order."""
    return {name: module.EFFECT for name, module in _modules().items()}


def effect_number(name: str) -> int:
    """The number by which a compiled table refers to an effect."""
    return list(effects()).index(name)


def effect_sources() -> str:
    """The text of all effect files: what a compiled plant depends on."""
    return "\n".join(inspect.getsource(module) for module in _modules().values())


def dispatcher_text(kind: EffectKind, function: str) -> str:
    """Source of a compiled function `function(number, state, row)` that calls the effect of that number with its row's parameters."""
    chosen = [(number, effect) for number, effect in enumerate(effects().values()) if effect.kind is kind]
    lines = []
    for _, effect in chosen:
        module = _modules()[effect.name].__name__
        lines += [f"import {module}", f"_{effect.name} = compiled({module}.{kind.function})"]
    lines += ["", "", "@compiled", f"def {function}(number, state, row):"]
    for number, effect in chosen:
        arguments = ", ".join(f"row[{1 + k}]" for k in range(len(effect.parameters)))
        lines += [f"    if number == {number}:", f"        return _{effect.name}(state, {arguments})"]
    lines += ["    return 0.0", ""]
    return "\n".join(lines)


def catalogue() -> list[dict]:
    """Names, parameters with units and bounds, sign conventions and allowed places of every effect, as plain data."""
    return [
        {
            "name": effect.name,
            "kind": effect.kind.name,
            "at": list(effect.kind.allowed_at),
            "parameters": [
                {
                    "name": parameter.name,
                    "key": parameter.key(),
                    "unit": parameter.unit,
                    "key_prismatic": parameter.key(prismatic=True),
                    "unit_prismatic": parameter.unit_at(prismatic=True),
                    "low": parameter.low,
                    "high": parameter.high,
                    "description": parameter.description,
                }
                for parameter in effect.parameters
            ],
            "convention": effect.convention,
            "neighbours": list(effect.neighbours),
            "source": effect.source,
        }
        for effect in effects().values()
    ]
