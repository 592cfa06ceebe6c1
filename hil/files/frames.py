"""Tables of results as data frames of pandas, which is an extra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hil.extras import extra_package

if TYPE_CHECKING:
    import pandas as pd

    Column = np.ndarray | Sequence[object]


def data_frame(
    columns: Mapping[str, Column], *, index: Column | None = None, index_name: str = "", units: Mapping[str, str] | None = None
) -> pd.DataFrame:
    """Return columns of equal length as a data frame.

    Parameters
    ----------
    columns : mapping of str to array or sequence
    index : array or sequence, optional
        Label of every row; numbers from 0 unless given.
    index_name : str
    units : mapping of str to str, optional
        Unit of a column by its name, kept in `attrs["units"]`.

    Raises
    ------
    UnusableInputError
        Pandas is not installed.
    """
    pandas = extra_package("pandas", "data frames")
    labels = None if index is None else pandas.Index(index, name=index_name or None)
    frame: pd.DataFrame = pandas.DataFrame(dict(columns), index=labels, columns=list(columns))
    if units is not None:
        frame.attrs["units"] = dict(units)
    return frame


def stacked(frames: Mapping[str, pd.DataFrame], name: str) -> pd.DataFrame:
    """Return data frames one above the other, the key of each as the first level of the index, which is called `name`."""
    pandas = extra_package("pandas", "data frames")
    frame: pd.DataFrame = pandas.concat(frames, names=[name])
    return frame
