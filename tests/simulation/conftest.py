"""The effects' examples of tests/effects, for the simulation's tests."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from virtual_bus.settings import EffectSetting


@pytest.fixture(scope="session")
def examples() -> dict[str, EffectSetting]:
    """One effect of every name on the C-arm."""
    file = Path(__file__).parents[1] / "effects" / "effect_examples.py"
    specification = importlib.util.spec_from_file_location("effect_examples_of_simulation", file)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.EXAMPLES
