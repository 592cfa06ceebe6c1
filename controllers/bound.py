"""Arrays that are handed to compiled functions once, instead of with every call.

numba takes each array of a tuple apart at every call, which for the fifty of an observer is a good part of a step. What is bound is taken
apart once: a call then costs the same for one array and for all. The arrays are those of the caller, who
goes on reading and writing them; which arrays they are cannot be changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

from numba import config, types
from numba.experimental import structref

from controllers.compiled import exactly_compiled


class BoundType(types.StructRef):
    """numba's type of `Bound`."""

    def preprocess_fields(self, fields: Sequence[tuple[str, types.Type]]) -> tuple[tuple[str, types.Type], ...]:
        """Return the fields' types, without the values of literals."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)  # type: ignore[no-untyped-call]


structref.register(BoundType)  # type: ignore[no-untyped-call]


class Bound(structref.StructRefProxy):
    """A reference to a tuple, of arrays or of named tuples of them, for compiled functions. It is neither copied nor pickled."""

    held: tuple[Any, ...]


structref.define_boxing(BoundType, Bound)  # type: ignore[no-untyped-call]
structref.define_constructor(Bound, BoundType, ["held"])  # type: ignore[no-untyped-call]


@exactly_compiled
def _bound(held: tuple[object, ...]) -> Bound:
    return Bound(held)  # type: ignore[no-untyped-call]


def bound(held: tuple[object, ...]) -> Bound:
    """Bind a tuple; see `Bound`. With numba's compilation switched off, an object with the tuple does as well."""
    return cast(Bound, SimpleNamespace(held=held)) if config.DISABLE_JIT else _bound(held)  # type: ignore[attr-defined]
