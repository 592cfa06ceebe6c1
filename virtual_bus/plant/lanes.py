"""Several machines side by side in compiled code: a number stands for LANES numbers, one of each machine.

Code written for one machine, such as `work.speed[i] += h * work.derivative[i]`, is compiled for all at once when it is given a record of
lanes in place of a NumPy record: the entries of its fields are the processor's vectors, and so is everything computed from them. Lanes
cannot be compared, so code that branches on a machine's numbers cannot take them; numba says so when it compiles such code.

    record = LaneRecord({"speed": (n,), "inverse": (n, n)})
    memory = record.new()                      # (entries, LANES) float64
    record.field(memory, "speed")              # (n, LANES) of it, for Python
    record.view(memory).speed[i]               # in compiled code: one vector
    record.view(memory).speed[i, lane]         # and the number of one machine
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, TypeVar, cast

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.imputils import lower_builtin, lower_cast, lower_getattr_generic
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, Signature, infer_getattr, infer_global, signature
from numba.extending import intrinsic, models, register_model

from virtual_bus.compilation.jit import FAST_MATH

LANES = 8  # doubles in one register of AVX-512, or in two of AVX2
ALIGNMENT = 64  # bytes: a vector that straddles two cache lines takes two reads

DOUBLE, INDEX = ir.DoubleType(), ir.IntType(64)
VECTOR, COUNTS = ir.VectorType(DOUBLE, LANES), ir.VectorType(ir.IntType(32), LANES)
FLAGS = tuple(sorted(FAST_MATH))

QUARTERS_PER_RADIAN = 2.0 / math.pi
MOST_QUARTERS = 2.0e9  # which 32 bits can count
QUARTER = (math.pi / 2.0, 6.123233995736766e-17)
"""pi / 2 in two parts: a whole number of quarters is subtracted by two fused multiply-subtractions, of which the first is exact."""
SINE = (
    1.58962301576546568060e-10, -2.50507477628578072866e-8, 2.75573136213857245213e-6,
    -1.98412698295895385996e-4, 8.33333333332211858878e-3, -1.66666666666666307295e-1,
)  # fmt: skip
COSINE = (
    -1.13585365213876817300e-11, 2.08757008419747316778e-9, -2.75573141792967388112e-7,
    2.48015872888517045348e-5, -1.38888888888730564116e-3, 4.16666666666665929218e-2,
)  # fmt: skip
"""Coefficients of (sin x - x) / x^3 and (cos x - 1 + x^2 / 2) / x^4 in x^2 up to pi / 4, highest powers first (Moshier, Cephes 2.8)."""

# ---- numba's interface, which has no type hints --------------------------------------------------------------------------------------

Registered = TypeVar("Registered", bound=Callable[..., object])


class _Registry(Protocol):
    """A maker of decorators that tell numba of a function or class."""

    def __call__(self, *keys: object) -> Callable[[Registered], Registered]:
        """Return the decorator for these keys."""


class _ArrayStructure(Protocol):
    """An array as compiled code holds it."""

    data: ir.Value  # pointer to its first entry


class _Context(Protocol):
    """The part of numba's target context that is used here."""

    def cast(self, builder: ir.IRBuilder, value: ir.Value, kind: types.Type, to: types.Type, /) -> ir.Value:
        """Convert a value from one type to another."""

    def get_constant(self, kind: types.Type, value: int, /) -> ir.Constant:
        """Return a constant of that type."""

    def get_dummy_value(self) -> ir.Value:
        """Return the value of None."""

    def make_array(self, kind: types.Type, /) -> Callable[..., _ArrayStructure]:
        """Return the structure of arrays of that type."""


Arguments = tuple[types.Type, ...]
Keywords = Mapping[str, types.Type]

_infer_global = cast(_Registry, infer_global)
_lower = cast(_Registry, lower_builtin)
_lower_cast = cast(_Registry, lower_cast)
_lower_getattr = cast(_Registry, lower_getattr_generic)
_signature: Callable[..., Signature] = signature
_intrinsic: Callable[[Callable[..., object]], Callable[[np.ndarray], np.record]] = intrinsic


# ---- the number ----------------------------------------------------------------------------------------------------------------------


class LanesType(types.Type):
    """The type of LANES numbers at a time."""

    def __init__(self) -> None:
        super().__init__(name=f"Lanes({LANES})")

    def can_convert_from(self, typingctx: object, other: types.Type) -> Conversion | None:
        """Return how safely another type converts to lanes: numbers do, others do not."""
        return Conversion.safe if isinstance(other, types.Number) else None

    def unify(self, typingctx: object, other: types.Type) -> types.Type | None:
        """Return lanes for a number beside lanes, None for anything else."""
        return self if isinstance(other, types.Number) else None


lanes = LanesType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: object, kind: types.Type) -> None:
        super().__init__(manager, kind, VECTOR)  # type: ignore[no-untyped-call]


def _splat(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """Return the vector with this number in every lane."""
    first = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, ir.Constant(VECTOR, ir.Undefined), ir.Constant(COUNTS, [0] * LANES))


def _all(value: float) -> ir.Constant:
    return ir.Constant(VECTOR, [value] * LANES)


@_lower_cast(types.Number, LanesType)
def _from_number(context: _Context, builder: ir.IRBuilder, kind: types.Type, to: types.Type, value: ir.Value) -> ir.Value:
    return _splat(builder, context.cast(builder, value, kind, types.float64))


class _Binary(AbstractTemplate):
    def generic(self, args: Arguments, kws: Keywords) -> Signature | None:
        known = all(isinstance(arg, (LanesType, types.Number)) for arg in args)
        return _signature(lanes, lanes, lanes) if known and lanes in args else None


class _Unary(AbstractTemplate):
    def generic(self, args: Arguments, kws: Keywords) -> Signature | None:
        return _signature(lanes, lanes) if args == (lanes,) else None


def _arithmetic(function: Callable[..., object], instruction: str) -> None:
    _infer_global(function)(type(f"_{function.__name__}", (_Binary,), {}))

    @_lower(function, LanesType, LanesType)
    def _(context: _Context, builder: ir.IRBuilder, sig: Signature, args: tuple[ir.Value, ...]) -> ir.Value:
        return getattr(builder, instruction)(*args, flags=FLAGS)


for _function, _instruction in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv")):
    _arithmetic(_function, _instruction)
for _function, _instruction in ((operator.iadd, "fadd"), (operator.isub, "fsub"), (operator.imul, "fmul"), (operator.itruediv, "fdiv")):
    _arithmetic(_function, _instruction)

_infer_global(operator.neg)(type("_neg", (_Unary,), {}))


@_lower(operator.neg, LanesType)
def _negative(context: _Context, builder: ir.IRBuilder, sig: Signature, args: tuple[ir.Value, ...]) -> ir.Value:
    return builder.fneg(args[0], flags=FLAGS)


def _called(builder: ir.IRBuilder, name: str, to: ir.Type, *args: ir.Value) -> ir.Value:
    """Call an intrinsic of LLVM, elementwise."""
    kind = ir.FunctionType(to, [arg.type for arg in args])
    known = builder.module.globals.get(name)
    return builder.call(known if known is not None else ir.Function(builder.module, kind, name), args)


_infer_global(math.floor)(type("_floor", (_Unary,), {}))  # to lanes, not to integers as for a single number


@_lower(math.floor, LanesType)
def _floor(context: _Context, builder: ir.IRBuilder, sig: Signature, args: tuple[ir.Value, ...]) -> ir.Value:
    return _called(builder, f"llvm.floor.v{LANES}f64", VECTOR, *args)


def _extreme(function: Callable[..., object], replaced_where: str) -> None:
    _infer_global(function)(type(f"_{function.__name__}", (_Binary,), {}))

    @_lower(function, LanesType, LanesType)
    def _(context: _Context, builder: ir.IRBuilder, sig: Signature, args: tuple[ir.Value, ...]) -> ir.Value:
        return builder.select(builder.fcmp_ordered(replaced_where, *args), args[1], args[0])


_extreme(min, ">")  # NaN where the first of the two is
_extreme(max, "<")


def _polynomial(builder: ir.IRBuilder, x: ir.Value, coefficients: tuple[float, ...]) -> ir.Value:
    value = _all(coefficients[0])
    for coefficient in coefficients[1:]:
        value = builder.fadd(builder.fmul(value, x, flags=FLAGS), _all(coefficient), flags=FLAGS)
    return value


def _circular(function: Callable[..., object], quarters_ahead: int) -> None:
    """Compile sin or cos for every lane.

    The result is NaN for NaN, for infinities, and from about 3e9 rad on, far beyond any angle a joint turns through.
    """
    _infer_global(function)(type(f"_{function.__name__}", (_Unary,), {}))

    @_lower(function, LanesType)
    def _(context: _Context, builder: ir.IRBuilder, sig: Signature, args: tuple[ir.Value, ...]) -> ir.Value:
        (angle,) = args
        quarters = _called(builder, f"llvm.nearbyint.v{LANES}f64", VECTOR, builder.fmul(angle, _all(QUARTERS_PER_RADIAN)))
        is_near = builder.fcmp_ordered("<", _called(builder, f"llvm.fabs.v{LANES}f64", VECTOR, quarters), _all(MOST_QUARTERS))
        rest = angle
        for part in QUARTER:
            rest = _called(builder, f"llvm.fma.v{LANES}f64", VECTOR, builder.fneg(quarters), _all(part), rest)
        square = builder.fmul(rest, rest)
        cube, fourth = builder.fmul(square, rest), builder.fmul(square, square)
        sine = builder.fadd(rest, builder.fmul(cube, _polynomial(builder, square, SINE)))
        cosine = builder.fsub(_all(1.0), builder.fmul(_all(0.5), square))
        cosine = builder.fadd(cosine, builder.fmul(fourth, _polynomial(builder, square, COSINE)))
        count = _called(builder, f"llvm.fptosi.sat.v{LANES}i32.v{LANES}f64", COUNTS, quarters)
        count = builder.add(count, ir.Constant(COUNTS, [quarters_ahead] * LANES))
        odd = builder.trunc(count, ir.VectorType(ir.IntType(1), LANES))
        back = builder.trunc(builder.lshr(count, ir.Constant(COUNTS, [1] * LANES)), ir.VectorType(ir.IntType(1), LANES))
        chosen = builder.select(odd, cosine, sine)
        return builder.select(is_near, builder.select(back, builder.fneg(chosen), chosen), _all(math.nan))


_circular(math.sin, 0)
_circular(math.cos, 1)


# ---- arrays and records of them ------------------------------------------------------------------------------------------------------


class LaneArrayType(types.Type):
    """The type of vectors in memory, of a shape that the compiler knows.

    Indices are not checked, and do not count from the end.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape
        super().__init__(name=f"LaneArray({shape})")


class LaneRecordType(types.Type):
    """The type of a record's memory."""

    def __init__(self, fields: tuple[tuple[str, tuple[int, ...]], ...]) -> None:
        self.fields = fields
        super().__init__(name=f"LaneRecord({fields})")

    def place(self, name: str) -> tuple[int, tuple[int, ...]] | None:
        """Return first entry and shape of a field, None where there is no such field."""
        first = 0
        for known, shape in self.fields:
            if known == name:
                return first, shape
            first += math.prod(shape)
        return None


@register_model(LaneArrayType)
@register_model(LaneRecordType)
class _PointerModel(models.PrimitiveModel):
    def __init__(self, manager: object, kind: types.Type) -> None:
        super().__init__(manager, kind, ir.PointerType(DOUBLE))  # type: ignore[no-untyped-call]


def _entry(builder: ir.IRBuilder, pointer: ir.Value, entry: ir.Value) -> ir.Value:
    return builder.gep(pointer, [builder.mul(entry, ir.Constant(INDEX, LANES))], inbounds=True, source_etype=DOUBLE)


@infer_getattr
class _Fields(AttributeTemplate):
    key = LaneRecordType

    def generic_resolve(self, record: LaneRecordType, name: str) -> LaneArrayType | None:  # type: ignore[override]
        place = record.place(name)
        return None if place is None else LaneArrayType(place[1])


@_lower_getattr(LaneRecordType)
def _field(context: _Context, builder: ir.IRBuilder, record: LaneRecordType, pointer: ir.Value, name: str) -> ir.Value:
    place = record.place(name)
    assert place is not None
    return _entry(builder, pointer, ir.Constant(INDEX, place[0]))


def _indices(index: types.Type) -> list[types.Type]:
    if not hasattr(index, "__len__"):
        return [index]
    members = cast("Sequence[types.Type]", index)
    return [members[k] for k in range(len(members))]


def _addressed(
    context: _Context, builder: ir.IRBuilder, array: LaneArrayType, index: types.Type, pointer: ir.Value, value: ir.Value
) -> ir.Value:
    kinds = _indices(index)
    values = [builder.extract_value(value, k) for k in range(len(kinds))] if isinstance(index, types.BaseTuple) else [value]
    numbers = [context.cast(builder, one, kind, types.int64) for one, kind in zip(values, kinds, strict=True)]
    entry = ir.Constant(INDEX, 0)
    for size, number in zip(array.shape, numbers, strict=False):
        entry = builder.add(builder.mul(entry, ir.Constant(INDEX, size)), number)
    place = _entry(builder, pointer, entry)
    if len(numbers) == len(array.shape):
        return builder.bitcast(place, ir.PointerType(VECTOR))
    return builder.gep(place, [numbers[-1]], inbounds=True, source_etype=DOUBLE)


def _indexed(array: types.Type, index: types.Type) -> types.Type | None:
    """Return the type of what stands at an index.

    It is a vector, or the number of one machine where the lane is a further index.
    """
    if not isinstance(array, LaneArrayType) or not all(isinstance(one, types.Integer) for one in _indices(index)):
        return None
    return {0: lanes, 1: types.float64}.get(len(_indices(index)) - len(array.shape))


@_infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, args: Arguments, kws: Keywords) -> Signature | None:
        entry = _indexed(*args)
        return None if entry is None else _signature(entry, *args)


@_infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, args: Arguments, kws: Keywords) -> Signature | None:
        array, index, value = args
        entry = _indexed(array, index)
        known = isinstance(value, types.Number) or value == entry
        return _signature(types.none, array, index, entry) if known and entry is not None else None


@_lower(operator.getitem, LaneArrayType, types.Any)
def _read(context: _Context, builder: ir.IRBuilder, sig: Signature, args: tuple[ir.Value, ...]) -> ir.Value:
    kind = VECTOR if sig.return_type == lanes else DOUBLE
    return builder.load(_addressed(context, builder, *sig.args, *args), align=8, typ=kind)


@_lower(operator.setitem, LaneArrayType, types.Any, LanesType)
@_lower(operator.setitem, LaneArrayType, types.Any, types.float64)
def _write(context: _Context, builder: ir.IRBuilder, sig: Signature, args: tuple[ir.Value, ...]) -> ir.Value:
    builder.store(args[2], _addressed(context, builder, *sig.args[:2], *args[:2]), align=8)
    return context.get_dummy_value()


@_infer_global(len)
class _Length(AbstractTemplate):
    def generic(self, args: Arguments, kws: Keywords) -> Signature | None:
        return _signature(types.intp, *args) if len(args) == 1 and isinstance(args[0], LaneArrayType) else None


@_lower(len, LaneArrayType)
def _length(context: _Context, builder: ir.IRBuilder, sig: Signature, args: tuple[ir.Value, ...]) -> ir.Value:
    return context.get_constant(types.intp, sig.args[0].shape[0])


class LaneRecord:
    """Names and shapes of a record's fields, the memory it takes, and its view in compiled code.

    Parameters
    ----------
    fields : mapping of str to tuple of int
        Shape of every field by its name.

    Attributes
    ----------
    view : compiled function
        Takes a record's memory (entries, LANES) and returns the record.
    size : int
        Entries of a record's memory.
    """

    def __init__(self, fields: Mapping[str, tuple[int, ...]]) -> None:
        self._type = LaneRecordType(tuple(fields.items()))
        self.view = _viewer(self._type)
        self.size = sum(math.prod(shape) for shape in fields.values())

    def new(self) -> np.ndarray:
        """Return the memory of a record (entries, LANES), all zeros."""
        count = self.size * LANES
        memory = np.zeros(count + ALIGNMENT // 8)
        skipped = -memory.ctypes.data % ALIGNMENT // 8
        return memory[skipped : skipped + count].reshape(self.size, LANES)

    def field(self, memory: np.ndarray, name: str) -> np.ndarray:
        """Return a field (*shape, LANES), a view of `memory`."""
        place = self._type.place(name)
        if place is None:
            raise KeyError(name)
        first, shape = place
        return memory[first : first + math.prod(shape)].reshape(*shape, LANES)


def _viewer(record: LaneRecordType) -> Callable[[np.ndarray], np.record]:
    @_intrinsic
    def view(typingctx: object, memory: types.Type) -> tuple[Signature, Callable[..., ir.Value]]:
        """Return memory (entries, LANES) as a record of lanes; for compiled code only."""

        def codegen(context: _Context, builder: ir.IRBuilder, sig: Signature, args: tuple[ir.Value, ...]) -> ir.Value:
            return context.make_array(sig.args[0])(context, builder, args[0]).data

        return record(memory), codegen

    return view
