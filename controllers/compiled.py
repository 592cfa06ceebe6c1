"""Numba compilation with a disk cache that notices changes in imported modules.

A function is compiled together with the functions it calls, but numba's cache looks only at the file that defines it. So the key of
every cached function holds a digest of its module and of all of this project's modules that it imports, directly or not: machine code
made from older sources is never found.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import pickle
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CellType, FunctionType, ModuleType
from typing import Any, Protocol, TypeVar, cast

from numba import njit
from numba.core.caching import IndexDataCacheFile
from numba.extending import is_jitted

F = TypeVar("F", bound=Callable[..., object])


class Decorator(Protocol):
    """A decorator that keeps the type of what it decorates."""

    def __call__(self, function: F) -> F:
        """Return the decorated function."""


PACKAGES = ("controllers", "drivers", "hil", "virtual_bus")

# The entries for calls from Python and C take a fifth of the compilation. Nothing calls from C; functions that only compiled code calls do
# without both.
INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

# These are compiled into whatever calls them, and cannot be called from Python. Without an explicit setting they would inherit fast math
# from the first compiled caller, and estimates must have the same bits live and in replay.
exactly_called = cast(Decorator, njit(fastmath=False, error_model="numpy", **INNER))
exactly_inlined = cast(Decorator, njit(fastmath=False, error_model="numpy", forceinline=True, **INNER))


class _Index(IndexDataCacheFile):
    """A function's index on disk, empty where it names types that this version of the project does not have."""

    def _load_index(self) -> dict[object, str]:
        try:
            return cast(dict[object, str], super()._load_index())  # type: ignore[no-untyped-call]
        except (ImportError, AttributeError, EOFError, pickle.UnpicklingError):
            return {}


def kept_on_disk(signature: object = None, **options: object) -> Decorator:
    """Decorate a function with `numba.njit` and these options, and keep the machine code on disk between processes.

    With a signature, the function is compiled for it when its module is imported, never later while a caller waits for an answer.
    """

    def compile_and_keep(function: F) -> F:
        plain = cast(FunctionType, function)
        # numba hashes what a function closes over into the key; this cell has no other purpose
        code = plain.__code__
        cells = (*(plain.__closure__ or ()), CellType(sources_digest(sys.modules[plain.__module__])))
        named = code.replace(co_freevars=(*code.co_freevars, "sources_digest"))
        keyed = FunctionType(named, plain.__globals__, plain.__name__, plain.__defaults__, cells)
        functools.update_wrapper(keyed, plain)
        compiled = cast(Callable[..., Decorator], njit)(cache=True, no_cfunc_wrapper=True, **options)(keyed)
        index = getattr(getattr(compiled, "_cache", None), "_cache_file", None)  # none where nothing is compiled, or kept
        if index is not None:
            index.__class__ = _Index
        if signature is not None and is_jitted(compiled):
            compiled.compile(signature)
            compiled.disable_compile()
        return cast(F, compiled)

    return compile_and_keep


exactly_compiled = kept_on_disk(fastmath=False, error_model="numpy")


def sources_digest(*modules: ModuleType) -> int:
    """Return a number that changes with the text of any of these modules, or of any project module they import, directly or not."""
    files = {file for module in modules for file in _with_imports(module.__name__)}
    return int(hashlib.sha256("\0".join(_text(file) for file in sorted(files)).encode()).hexdigest()[:15], 16)


@functools.cache
def _with_imports(name: str) -> frozenset[Path]:
    """Return the source files of a module and of the project modules it imports, directly or not."""
    found: dict[str, Path] = {}
    waiting = [name]
    while waiting:
        name = waiting.pop()
        file = _source_file(name)
        if name not in found and file is not None:
            found[name] = file
            waiting += _imported(file, name)
    return frozenset(found.values())


@functools.cache
def _imported(file: Path, name: str) -> tuple[str, ...]:
    """Return the project names that a file imports; `_source_file` later drops those that are functions, not modules."""
    return tuple(dict.fromkeys(_named(file, name)))


def _named(file: Path, name: str) -> Iterator[str]:
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(_text(file), str(file))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join([*package.split(".")[: len(package.split(".")) - node.level + 1], *filter(None, [node.module])])
            base = base if node.level else str(node.module)
            names = [base, *(f"{base}.{alias.name}" for alias in node.names)]
        else:
            continue
        yield from (found for found in names if found.split(".")[0] in PACKAGES)


@functools.cache
def _source_file(name: str) -> Path | None:
    try:
        found = importlib.util.find_spec(name)
    except ModuleNotFoundError:  # a function of a module
        return None
    return Path(found.origin) if found is not None and found.origin is not None and found.origin.endswith(".py") else None


@functools.cache
def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")
