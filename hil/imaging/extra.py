"""Packages of the extra `imaging`, imported where they are used."""

from __future__ import annotations

import importlib
from typing import Any

from hil.errors import UnusableInputError

DISTRIBUTIONS = {"tifffile": "scikit-image", "skimage": "scikit-image", "itk": "itk-rtk", "pydicom": "pydicom"}
"""What brings each package."""


def imaging_package(name: str, what: str) -> Any:
    """A module of the extra.

    Parameters
    ----------
    name : str
        Of the module; its first part is one of `DISTRIBUTIONS`.
    what : str
        What needs it, for the message.

    Raises
    ------
    UnusableInputError
        It is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise UnusableInputError(f"{what} need {DISTRIBUTIONS[name.partition('.')[0]]}: pip install 'isocenter[imaging]'") from None
