"""Files of named NumPy arrays (.npz): FRF, SHAPER, EST, observer designs."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from hil.errors import UnusableInput


def read_arrays(path: str | Path, what: str, error: type[UnusableInput] = UnusableInput) -> dict[str, np.ndarray]:
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
    UnusableInput
        The file is missing or no archive of arrays.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except (OSError, ValueError, EOFError, AttributeError, TypeError, zipfile.BadZipFile) as problem:
        raise error(f"{path}: not {what} ({problem})") from None
