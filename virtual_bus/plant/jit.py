"""How plant code is compiled: one place for numba's options."""

from __future__ import annotations

from typing import Any

import numba

# Contraction to fused multiply-add and reassociation of sums; NaN and infinities keep their meaning, so that a fault stays visible.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp"}

# Without counts of references to arrays: whoever calls holds them, and counts are atomic operations, which took 13 to 58 % of a free run.
# So nothing may be allocated, nor an array be assigned to part of another (numba would copy it): what asks for memory is not compiled. Nor
# may an array be returned: numba compiles that, and hands back the whole of what the returned part was taken from.
UNCOUNTED: dict[str, Any] = {"_nrt": False}

# Without the entries by which Python and C would call them, a fifth of what compiling takes: only compiled functions call these.
INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

# For functions compiled into a generated module. Inlining is forced: a function handed over as an argument leaves a trace that numba cannot
# cache unless the call disappears, and the compiler then sees one body with known sizes.
compiled = numba.njit(fastmath=FAST_MATH, error_model="numpy", forceinline=True, **UNCOUNTED, **INNER)

# For the functions of a generated module: machine code of their own, kept on disk.
compiled_and_cached = numba.njit(fastmath=FAST_MATH, error_model="numpy", cache=True, **UNCOUNTED)

# For whole simulations: other threads go on meanwhile. Not for what a loop in real time calls every sample: coming back it would have to
# wait for the interpreter's lock, 5 ms where another thread has work.
compiled_for_threads = numba.njit(fastmath=FAST_MATH, error_model="numpy", cache=True, nogil=True, **UNCOUNTED)
