"""How plant code is compiled: one place for numba's options."""

from __future__ import annotations

import numba

# Contraction to fused multiply-add and reassociation of sums; NaN and infinities keep their meaning, so that a fault stays visible.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp"}

compiled = numba.njit(fastmath=FAST_MATH, error_model="numpy", forceinline=True)  # for functions that are compiled into a generated module
compiled_and_cached = numba.njit(fastmath=FAST_MATH, error_model="numpy", cache=True)  # for the entry points of a generated module
