"""How the models' and observers' functions are compiled, and kept on disk though numba's cache looks at one file only."""

from __future__ import annotations

import hashlib
import inspect
from types import ModuleType

from numba import njit

# Left unsaid, fast math would be inherited from the first compiled caller: estimates must be the same bits live and in replay.
# Kept on disk: only for functions that call nothing from another file.
exactly_compiled = njit(cache=True, fastmath=False, error_model="numpy")
# Compiled into whatever calls them, which is kept on disk with a digest of all their sources.
exactly_called = njit(fastmath=False, error_model="numpy")
exactly_inlined = njit(fastmath=False, error_model="numpy", forceinline=True)


def sources_digest(*modules: ModuleType) -> int:
    """A number that changes with the text of any of these modules.

    A compiled function that closes over it (numba hashes closure variables into the cache's key) is compiled afresh when they change.
    """
    texts = "\0".join(inspect.getsource(module) for module in modules)
    return int(hashlib.sha256(texts.encode()).hexdigest()[:15], 16)
