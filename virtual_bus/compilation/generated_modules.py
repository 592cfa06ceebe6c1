"""Generated modules on disk: written once, compiled once, loaded by later processes.

Numba caches a compiled function beside its file, so a generated function needs a file. The file's name is a hash of everything the machine
code depends on; a file that exists is never written again.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
import threading
from pathlib import Path
from types import ModuleType

import numba

from virtual_bus.errors import PlantError

CACHE_VARIABLE = "ISOCENTER_CACHE"

_one_at_a_time = threading.RLock()  # another thread would find a module half made; reentrant, since modules import each other


def cache_folder() -> Path:
    """Return the folder of generated modules: $ISOCENTER_CACHE, or the platform's folder for caches."""
    if chosen := os.environ.get(CACHE_VARIABLE):
        return Path(chosen)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "isocenter" / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "isocenter"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isocenter"


def load_generated(name: str, text: str, depends_on: str = "") -> ModuleType:
    """Return the module made of `text`, from disk if it is there.

    Parameters
    ----------
    name : str
        Start of the module's name; a hash of `text`, `depends_on` and numba's version follows.
    text : str
        Python source.
    depends_on : str
        Source of whatever else is compiled into the module.

    Raises
    ------
    PlantError
        The cache folder cannot be written.
    """
    with _one_at_a_time:
        return _loaded(name, text, depends_on)


def _loaded(name: str, text: str, depends_on: str) -> ModuleType:
    digest = hashlib.sha256("\0".join((text, depends_on, numba.__version__)).encode()).hexdigest()[:20]
    module_name = f"isocenter_{name}_{digest}"
    if module_name in sys.modules:
        return sys.modules[module_name]
    folder = cache_folder()
    path = folder / f"{module_name}.py"
    if not path.exists():
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _write_at_once(path, text)
        except OSError as error:
            raise PlantError(f"{folder}: cannot write compiled plants there ({error.strerror}); set {CACHE_VARIABLE} to a folder") from None
    specification = importlib.util.spec_from_file_location(module_name, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[module_name] = module
    try:
        specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[module_name]
        raise
    return module


def _write_at_once(path: Path, text: str) -> None:
    """Write so that another process sees the whole file or none."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        stream.write(text)
    if path.exists():
        os.unlink(temporary)
    else:
        os.replace(temporary, path)
