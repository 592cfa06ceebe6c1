"""MATLAB's MAT-file format, version 7.3: an HDF5 file, whose arrays, structures and cells are read by h5py into what `mat5` gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import RecordingError
from hil.extras import extra_package
from hil.recording.mat5 import Value

MARK = b"MATLAB 7.3"
"""First bytes of such a file, before the HDF5 part begins."""

MOST_TIMES = 1032
"""A dataset of more than this many times the file is no data: deflate packs no tighter."""

MOST_BYTES = 2**28
"""Of one variable, as of a file of version 7."""

_MOST_ARRAYS = 100_000
_DEEPEST = 32


def hdf5_arrays(path: Path) -> dict[str, Value]:
    """Return every variable of a file, named as in `mat5.numeric_arrays`.

    Raises
    ------
    RecordingError
        The file is damaged.
    UnusableInputError
        h5py is not installed.
    """
    h5py = extra_package("h5py", "MATLAB files of version 7.3")
    variables: dict[str, Value] = {}
    try:
        with h5py.File(path, "r") as file:
            reader = _Reader(h5py, file, variables, path)
            for name in file:
                if not name.startswith("#"):
                    reader.add(name, file.get(name), 0)
    except RecordingError:
        raise
    except Exception as problem:  # h5py raises errors of many kinds for a damaged file
        raise RecordingError(f"{path}: no MATLAB 7.3 file, or damaged: {str(problem).partition(chr(10))[0]}") from None
    return variables


class _Reader:
    """Adds what is in a file to `variables`."""

    def __init__(self, h5py: Any, file: Any, variables: dict[str, Value], path: Path) -> None:  # noqa: ANN401, no types
        self._h5py, self._file, self._variables, self._path = h5py, file, variables, path
        self._most = min(MOST_BYTES, MOST_TIMES * path.stat().st_size)

    def add(self, name: str, item: Any, depth: int) -> None:  # noqa: ANN401
        """Add a dataset or group, and all in it, under a name."""
        if len(self._variables) >= _MOST_ARRAYS or depth > _DEEPEST:
            raise RecordingError(f"{self._path}: more than {_MOST_ARRAYS} arrays, or structures more than {_DEEPEST} deep")
        if isinstance(item, self._h5py.Group):
            for field in item:
                self.add(f"{name}.{field}", item.get(field), depth + 1)
            if not len(item):
                self._variables[name] = None
        elif not isinstance(item, self._h5py.Dataset) or "MATLAB_empty" in item.attrs:
            self._variables[name] = None
        elif item.size * item.dtype.itemsize > self._most:
            claimed = item.size * item.dtype.itemsize
            raise RecordingError(f"{self._path}: variable {name} claims {claimed} bytes; a variable has at most {self._most}")
        elif item.dtype == self._h5py.ref_dtype:
            self._add_referred(name, item, depth)
        elif _class(item) == "char":
            letters = np.asarray(item[()]).ravel()
            self._variables[name] = "".join(map(chr, letters)) if letters.dtype.kind == "u" and item.ndim == 2 else None
        else:  # MATLAB stores columns first, HDF5 rows
            self._variables[name] = np.asarray(item[()]).T if item.dtype.kind in "fiu" and "MATLAB_sparse" not in item.attrs else None

    def _add_referred(self, name: str, item: Any, depth: int) -> None:  # noqa: ANN401
        """Add a cell array, or a field of an array of structures: `s.f` of element k is `s(k).f`."""
        stem, _, field = name.rpartition(".")
        cell = _class(item) == "cell"
        for place, reference in enumerate(np.asarray(item[()]).T.ravel(order="F"), 1):
            self.add(f"{name}{{{place}}}" if cell else f"{stem}({place}).{field}", self._file[reference], depth + 1)


def _class(item: Any) -> str:  # noqa: ANN401
    kind = item.attrs.get("MATLAB_class", b"")
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)
