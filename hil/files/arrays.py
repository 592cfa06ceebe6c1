"""Files of named NumPy arrays (.npz): FRF, SHAPER, EST, observer designs, calibrations."""

from __future__ import annotations

import io
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import UnusableInputError
from hil.files.atomic import write_atomically

_DAMAGED = (
    *(ValueError, TypeError, AttributeError, KeyError, EOFError, RuntimeError, SyntaxError),
    *(tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)
"""What NumPy and zipfile raise on files that are something else or have changed: RuntimeError of a method or a password they do not know,
the tokenizer's of an array's header."""


def write_arrays(path: str | Path, arrays: Mapping[str, Any]) -> None:
    """Write an archive that NumPy alone can read (docs/formats.md): whole, or what was in its place stays.

    Parameters
    ----------
    path : str or Path
    arrays : mapping of str to array or what NumPy makes one of

    Raises
    ------
    RecordingError
        The file cannot be written.
    """
    content = io.BytesIO()
    np.savez_compressed(content, **{name: np.asarray(values) for name, values in arrays.items()})  # type: ignore[arg-type]  # the stub takes allow_pickle for a value
    write_atomically({Path(path): content.getvalue()})


def read_arrays(path: str | Path, what: str, error: type[UnusableInputError] = UnusableInputError) -> dict[str, np.ndarray]:
    """Every array of an archive by its name.

    Parameters
    ----------
    path : str or Path
    what : str
        What the file should be, with its article, for the message.
    error : type
        What is raised.

    Raises
    ------
    UnusableInputError
        The file is missing, damaged, or no archive of arrays.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except OSError as problem:
        raise error(f"{path}: not {what} ({problem.strerror or problem})") from None
    except _DAMAGED:  # NumPy's words are of pickles, which no file of ours has
        raise error(f"{path}: not {what}: no whole archive of NumPy arrays (.npz)") from None
