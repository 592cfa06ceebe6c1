"""Packages of the extra `imaging`, imported where they are used."""

from __future__ import annotations

import importlib
from types import ModuleType

from hil.errors import UnusableInputError

DISTRIBUTIONS = {"tifffile": "scikit-image", "skimage": "scikit-image", "itk": "itk-rtk", "pydicom": "pydicom"}
"""The distribution that contains each package."""


def imaging_package(name: str, what: str) -> ModuleType:
    """Import a module of the extra.

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
