"""Files of named NumPy arrays (.npz): FRF, SHAPER, EST, observer designs, calibrations."""

from __future__ import annotations

import io
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hil.errors import UnusableInputError
from hil.files.atomic import write_atomically
from hil.files.regular import check_regular

_DAMAGED = (
    *(ValueError, TypeError, AttributeError, KeyError, EOFError, RuntimeError, SyntaxError),
    *(tokenize.TokenError, zipfile.BadZipFile, zlib.error, MemoryError),
)
"""Errors of NumPy and zipfile on files that are damaged or of another kind: RuntimeError for an unknown method or password, those of the
tokenizer for an array's header, MemoryError for an array whose header claims more than there is."""

MOST_UNPACKED = 2**29
"""Most bytes that an archive's arrays may have together: a hundred times those of the largest observer design."""


def write_arrays(path: str | Path, arrays: Mapping[str, object]) -> None:
    """Write an archive that NumPy alone can read (docs/generated/file-formats.md); on an error the old file stays.

    Parameters
    ----------
    path : str or Path
    arrays : mapping of str to array, or to values of which NumPy makes one

    Raises
    ------
    RecordingError
        The file cannot be written.
    """
    content = io.BytesIO()
    np.savez_compressed(content, **{name: np.asarray(values) for name, values in arrays.items()})  # type: ignore[arg-type]  # the stub takes allow_pickle for a value
    write_atomically({Path(path): content.getvalue()})


def read_arrays(path: str | Path, what: str, error: type[UnusableInputError] = UnusableInputError) -> dict[str, np.ndarray]:
    """Read every array of an archive by its name.

    Parameters
    ----------
    path : str or Path
    what : str
        Kind of the file, with its article, for the message.
    error : type
        Class of the error that is raised.

    Raises
    ------
    UnusableInputError
        The file is missing, damaged, or no archive of arrays.
    """
    check_regular(Path(path), error)
    try:
        with zipfile.ZipFile(path) as archive:
            claimed = sum(entry.file_size for entry in archive.infolist())
        if claimed > MOST_UNPACKED:
            raise error(f"{path}: not {what}: its arrays claim {claimed} bytes unpacked; at most {MOST_UNPACKED} are read")
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except UnusableInputError:
        raise
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except OSError as problem:
        raise error(f"{path}: not {what} ({problem.strerror or problem})") from None
    except _DAMAGED:  # NumPy's message is about pickles, which no file of this project has
        raise error(f"{path}: not {what}: no whole archive of NumPy arrays (.npz)") from None
