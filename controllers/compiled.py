"""How functions of this house are compiled, and kept on disk though numba's cache looks at one file only.

A function that calls one of another file is compiled together with it, but numba would find it unchanged when only that other file has
changed. So the key of every function kept on disk holds a digest of its module and of all modules of the house that this one imports,
directly or not: a stale machine code cannot be found.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CellType, FunctionType, ModuleType
from typing import Any

from numba import njit

HOUSE = ("controllers", "drivers", "hil", "virtual_bus")

# Compiled into whatever calls them. Left unsaid, fast math would be inherited from the first compiled caller: estimates must be the same
# bits live and in replay.
exactly_called = njit(fastmath=False, error_model="numpy")
exactly_inlined = njit(fastmath=False, error_model="numpy", forceinline=True)


def kept_on_disk(signature: Any = None, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator: `numba.njit` with these options, the machine code kept between processes.

    With a signature it is compiled for that one when its module is imported, and never while somebody waits for an answer.
    """

    def compile_and_keep(function: Any) -> Any:
        # numba hashes what a function closes over into the key; this cell is there for nothing else
        code = function.__code__
        cells = (*(function.__closure__ or ()), CellType(sources_digest(sys.modules[function.__module__])))
        named = code.replace(co_freevars=(*code.co_freevars, "sources_digest"))
        keyed = FunctionType(named, function.__globals__, function.__name__, function.__defaults__, cells)
        functools.update_wrapper(keyed, function)
        return njit(signature, cache=True, **options)(keyed)

    return compile_and_keep


exactly_compiled = kept_on_disk(fastmath=False, error_model="numpy")


def sources_digest(*modules: ModuleType) -> int:
    """A number that changes with the text of any of these modules and of whatever of this house they import, directly or not."""
    files = {file for module in modules for file in _with_imports(module.__name__)}
    return int(hashlib.sha256("\0".join(_text(file) for file in sorted(files)).encode()).hexdigest()[:15], 16)


@functools.cache
def _with_imports(name: str) -> frozenset[Path]:
    """Source files of a module and of the modules of the house it imports, directly or not."""
    found: dict[str, Path] = {}
    waiting = [name]
    while waiting:
        name = waiting.pop()
        file = _source_file(name)
        if name not in found and file is not None:
            found[name] = file
            waiting += _imported(file, name)
    return frozenset(found.values())


def _imported(file: Path, name: str) -> Iterator[str]:
    """Names of the house that a file imports; names of functions among them are found to be no modules later."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(_tree(file)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join([*package.split(".")[: len(package.split(".")) - node.level + 1], *filter(None, [node.module])])
            base = base if node.level else str(node.module)
            names = [base, *(f"{base}.{alias.name}" for alias in node.names)]
        else:
            continue
        yield from (found for found in names if found.split(".")[0] in HOUSE)


@functools.cache
def _source_file(name: str) -> Path | None:
    try:
        found = importlib.util.find_spec(name)
    except ModuleNotFoundError:  # a function of a module
        return None
    return Path(found.origin) if found is not None and found.origin is not None and found.origin.endswith(".py") else None


@functools.cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(_text(file), str(file))


@functools.cache
def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")
