"""Packages of the distribution's extras, imported where they are used."""

from __future__ import annotations

import importlib
from types import ModuleType

from hil.errors import UnusableInputError

EXTRAS = {
    "tifffile": ("imaging", "scikit-image"),
    "skimage": ("imaging", "scikit-image"),
    "itk": ("imaging", "itk-rtk"),
    "pydicom": ("imaging", "pydicom"),
    "h5py": ("logs", "h5py"),
    "pyarrow": ("logs", "pyarrow"),
    "mcap": ("logs", "mcap"),
    "mcap_ros2": ("logs", "mcap-ros2-support"),
    "mujoco": ("models", "mujoco"),
    "foxglove": ("foxglove", "foxglove-sdk"),
    "pyuff": ("logs", "pyuff"),
    "pandas": ("frames", "pandas"),
    "dask": ("fleet", "dask[distributed]"),
    "distributed": ("fleet", "dask[distributed]"),
    "fsspec": ("fleet", "fsspec"),
    "duckdb": ("fleet", "duckdb"),
}
"""The extra that brings each package, and the distribution that contains it."""


def extra_package(name: str, what: str) -> ModuleType:
    """Import a module of an extra.

    Parameters
    ----------
    name : str
        Of the module; its first part is one of `EXTRAS`.
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
        extra, distribution = EXTRAS[name.partition(".")[0]]
        raise UnusableInputError(f"{what} need {distribution}: pip install 'isocenter[{extra}]'") from None
