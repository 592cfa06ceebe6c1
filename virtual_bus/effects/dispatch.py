"""The hooks of all effects as compiled functions that choose by number: one module for every plant, compiled once."""

from __future__ import annotations

import inspect
from functools import cache
from types import ModuleType

from virtual_bus.compilation import jit
from virtual_bus.compilation.generated_modules import load_generated
from virtual_bus.effects import motion
from virtual_bus.effects.registry import dispatcher_text, effect_sources

HEADER = '''"""Generated: the hooks of all effects by number; do not edit."""

from virtual_bus.compilation.jit import compiled, compiled_inside
'''
FUNCTIONS = {  # name in the generated module: hook of the effect files, what an effect without it returns
    "friction_of": ("level", "0.0"),
    "effort_of": ("effort", "0.0"),
    "terms_of": ("terms", "0.0, 0.0, 0.0, 0.0"),
    "reaction_of": ("react", "0.0, 0.0, 0.0"),
    "limited_by": ("limited", "state.current"),
    "ripple_of": ("factor", "1.0"),
    "encoder_error_of": ("error", "0.0"),
    "signed_by": ("signed", "state"),
    "lag_of": ("lag_s", "0.0"),
    "lost_by": ("is_lost", "False"),
}


@cache
def compiled_effects() -> ModuleType:
    """Return the module with the functions of FUNCTIONS, each `(number, state, row)`, compiled once and cached."""
    texts = [dispatcher_text(hook, function, nothing) for function, (hook, nothing) in FUNCTIONS.items()]
    return load_generated("effects", "\n\n".join([HEADER, *texts]), dispatch_sources())


@cache
def dispatch_sources() -> str:
    """Return the source of everything the dispatchers are compiled from."""
    return inspect.getsource(jit) + inspect.getsource(motion) + effect_sources()
