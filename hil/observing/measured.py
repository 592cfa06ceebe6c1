"""The measurements of a row for the observer, live and in replay alike: missing or repeated readings count as missing."""

from __future__ import annotations

import numpy as np

from controllers.models.modal import ModalModel


class MeasuredRow:
    """The measurements of a row in the order of `ModalModel.channels`, NaN where there is none.

    An IMU whose six channels all read the same as before has sent nothing new: noise alone would have changed one of them. Its reading
    counts as missing, so that an interface that holds the last value is not taken for a machine that stands still. An IMU without noise on
    a machine at perfect rest counts as silent, too.

    Parameters
    ----------
    model : ModalModel

    Attributes
    ----------
    values : (measurements,) array
        Overwritten by every `take`.
    """

    def __init__(self, model: ModalModel) -> None:
        self._first = 2 * len(model.axes)
        self._last = np.full((len(model.sensors), 6), np.nan)
        self.values = np.full(self._first + 6 * len(model.sensors), np.nan)

    def restart(self) -> None:
        """Forget all readings."""
        self._last[:] = np.nan

    def take(self, read: np.ndarray) -> None:
        """Take over a row as read (measurements,)."""
        values = self.values
        values[:] = read
        for index, last in enumerate(self._last):
            now = values[self._first + 6 * index :][:6]
            if np.array_equal(now, last):
                now[:] = np.nan
            elif not np.isnan(now).all():
                last[:] = now
