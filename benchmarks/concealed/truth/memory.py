"""MuJoCo called from compiled code: its forward dynamics by address, its arrays as NumPy views."""

from __future__ import annotations

import ctypes
from pathlib import Path

import mujoco
from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def forward_address() -> int:
    """Where libmujoco's `mj_forwardSkip` is in this process."""
    library = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco.so*"))))
    address = ctypes.cast(library.mj_forwardSkip, ctypes.c_void_p).value
    assert address is not None
    return address


@intrinsic
def forward(_, address, model, data, skip_sensors):  # type: ignore[no-untyped-def]
    """mj_forwardSkip(model, data, mjSTAGE_NONE, skip_sensors): accelerations from positions, speeds, controls and applied efforts."""
    signature = types.void(types.int64, types.int64, types.int64, types.int32)

    def generate(context, builder, _, arguments):  # type: ignore[no-untyped-def]
        pointer, whole = ir.IntType(8).as_pointer(), ir.IntType(32)
        function = builder.inttoptr(arguments[0], ir.FunctionType(ir.VoidType(), [pointer, pointer, whole, whole]).as_pointer())
        model_at, data_at = (builder.inttoptr(argument, pointer) for argument in arguments[1:3])
        builder.call(function, [model_at, data_at, ir.Constant(whole, 0), arguments[3]])
        return context.get_dummy_value()

    return signature, generate
