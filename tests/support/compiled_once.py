"""What one worker compiles, another does not compile at the same time: it waits, and loads the machine code from disk."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


def compile_once() -> None:
    """Let the workers of this run compile a function that is kept on disk one after the other: the second one finds it there.

    On a cold cache two workers begin with the same kernels, each of which takes up to a minute.
    """
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID")
    if run is None or os.name != "posix":
        return
    from numba.core.caching import NullCache
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    folder = Path(tempfile.gettempdir()) / f"isocenter-compiling-{run}"
    folder.mkdir(exist_ok=True)
    compile_now = Dispatcher.compile

    def compile_alone(dispatcher: Dispatcher, signature: object) -> object:
        if isinstance(dispatcher._cache, NullCache):
            return compile_now(dispatcher, signature)
        name = f"{dispatcher.py_func.__module__}:{dispatcher.py_func.__qualname__}"
        # numba's own lock first: another thread that has it would wait for the file that this one has
        with global_compiler_lock, _held(folder / hashlib.sha256(name.encode()).hexdigest()):
            return compile_now(dispatcher, signature)

    Dispatcher.compile = compile_alone


@contextlib.contextmanager
def _held(path: Path) -> Iterator[None]:
    """Hold a file that one process holds at a time; a function's callers are held before it, so that no two wait for each other."""
    import fcntl

    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            fcntl.flock(file, fcntl.LOCK_UN)  # closing alone would leave it to a process that was forked meanwhile
