"""Compilation of the plant's code: one place for numba's options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., object])


class Compiler(Protocol):
    """A decorator that compiles a function; what it returns is called like the function itself."""

    def __call__(self, function: Function, /) -> Function:
        """Return the compiled function."""


# Contraction to fused multiply-add and reassociation of sums; NaN and infinities keep their meaning, so that a fault stays visible.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp"}

# References to arrays are not counted: the caller holds them, and counts are atomic operations, which took 13 to 58 % of a free run. So
# nothing may be allocated, nor an array assigned to part of another (numba would copy it): such code is refused at compilation. Nor may an
# array be returned: numba compiles that, and hands back the whole array that the returned part was taken from.
UNCOUNTED: dict[str, Any] = {"_nrt": False}

# The entries for calls from Python and C take a fifth of the compilation. Nothing calls from C; functions that only compiled code calls do
# without both.
OUTER: dict[str, Any] = {"no_cfunc_wrapper": True}
INNER: dict[str, Any] = {"no_cpython_wrapper": True, **OUTER}

# For functions compiled into a generated module. Inlining is forced: a function handed over as an argument leaves a trace that numba cannot
# cache unless the call disappears, and the compiler then sees one body with known sizes.
compiled: Compiler = numba.njit(fastmath=FAST_MATH, error_model="numpy", forceinline=True, **UNCOUNTED, **INNER)

# For a large function with one caller: a part of that before it is compiled, so that it is optimised once and not once by itself besides.
compiled_in_place: Compiler = numba.njit(fastmath=FAST_MATH, error_model="numpy", inline="always", **UNCOUNTED, **INNER)

# For the functions of a generated module: machine code of their own, kept on disk. The second is for those that Python does not call.
compiled_and_cached: Compiler = numba.njit(fastmath=FAST_MATH, error_model="numpy", cache=True, **UNCOUNTED, **OUTER)
compiled_inside: Compiler = numba.njit(fastmath=FAST_MATH, error_model="numpy", cache=True, **UNCOUNTED, **INNER)

# For whole simulations: other threads go on meanwhile. Not for what a real-time loop calls every sample: on its return it would have to
# wait for the interpreter's lock, which takes 5 ms where another thread has work.
compiled_for_threads: Compiler = numba.njit(fastmath=FAST_MATH, error_model="numpy", cache=True, nogil=True, **UNCOUNTED, **OUTER)
