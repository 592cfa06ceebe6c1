"""Python and the optional libraries."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable

from hil.doctor.finding import Finding
from hil.extras import EXTRAS

OLDEST = (3, 11)


def is_installed(name: str) -> bool:
    """Return whether a package can be imported, without importing it."""
    return importlib.util.find_spec(name) is not None


def python(version: tuple[int, int, int] = sys.version_info[:3], tracing: bool = sys.gettrace() is not None) -> Finding:
    """Say which Python runs this, and whether a debugger or a coverage tool slows it down."""
    found = ".".join(map(str, version))
    if version[:2] < OLDEST:
        return Finding("bad", "Python", found, f"{'.'.join(map(str, OLDEST))} or newer")
    if tracing:
        return Finding("look", "Python", f"{found}, under a debugger or tracer", "run without it: every line of the loop is slowed down")
    return Finding("ok", "Python", found)


def libraries(installed: Callable[[str], bool] = is_installed) -> Finding:
    """Say which optional packages are missing; the loop needs none of them."""
    missing = sorted({extra for name, (extra, _) in EXTRAS.items() if not installed(name)})
    if missing:
        return Finding("look", "optional libraries", f"{', '.join(missing)} incomplete", f"pip install 'isocenter[{','.join(missing)}]'")
    return Finding("ok", "optional libraries", "all there")
