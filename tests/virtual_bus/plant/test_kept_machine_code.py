"""Generated modules are named by the sources compiled into them: no file with compiled functions may be left out of the name."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import NumbaError
from places import ROOT

from hil.machine import load_machine
from hil.simulation.kernel import closed_loop_kernel
from hil.simulation.lane_kernel import DEPENDENCIES as OF_LANES
from hil.simulation.lane_kernel import lane_kernel
from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.dispatch import dispatch_sources
from virtual_bus.inverse_dynamics import along_sources
from virtual_bus.plant.compiled import DEPENDENCIES, compile_plant

VIRTUAL_BUS = ROOT / "virtual_bus"
NAMED_BY = "\n".join(inspect.getsource(module) for module in (*DEPENDENCIES, *OF_LANES)) + dispatch_sources() + along_sources()


def has_compiled_functions(file: Path) -> bool:
    functions = [node for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(node, ast.FunctionDef)]
    return any(isinstance(mark, ast.Name) and mark.id.startswith("compiled") for function in functions for mark in function.decorator_list)


COMPILED = [
    file
    for folder in ("plant", "sensors", "effects")
    for file in sorted((VIRTUAL_BUS / folder).glob("*.py"))
    if has_compiled_functions(file)
]


def test_there_are_such_files() -> None:
    assert len(COMPILED) >= 10


@pytest.mark.parametrize("file", COMPILED, ids=lambda file: f"{file.parent.name}/{file.name}")
def test_an_edit_of_this_file_gives_generated_modules_another_name(file: Path) -> None:
    assert file.read_text(encoding="utf-8") in NAMED_BY


def test_a_plant_counts_no_references_so_that_nothing_in_it_may_ask_for_memory() -> None:
    @compiled
    def asks_for_memory(to: np.ndarray, what: np.ndarray) -> None:
        to[:] = what  # a copy of `what`, where the two overlap

    with pytest.raises(NumbaError, match="NRT required but not enabled"):
        asks_for_memory(np.zeros(3), np.ones(3))


def test_whole_simulations_let_other_threads_go_on_and_what_a_loop_calls_every_sample_does_not() -> None:
    plant = compile_plant(load_machine("carm").plant)
    functions = [one for one in vars(plant.module).values() if hasattr(one, "targetoptions")]
    assert plant.advance in functions
    assert not any(one.targetoptions.get("nogil") for one in functions)
    for kernel in (closed_loop_kernel(plant, filters_all=True), lane_kernel(plant, 4)):
        assert kernel.run.targetoptions["nogil"]
