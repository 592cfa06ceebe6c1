"""The measurements of a row for the observer, live and in replay alike: missing or repeated readings count as missing."""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_compiled
from controllers.models.modal import ModalModel


@exactly_compiled
def _without_repeats(values: np.ndarray, last: np.ndarray) -> None:
    """Make IMU readings, the last of values (measurements,), NaN where they repeat the last ones (sensors, 6), which the others become."""
    first = len(values) - last.size
    for index in range(len(last)):
        now = values[first + 6 * index :][:6]
        is_repeated, is_absent = True, True
        for k in range(6):
            is_repeated = is_repeated and now[k] == last[index, k]
            is_absent = is_absent and now[k] != now[k]
        for k in range(6):
            if is_repeated:
                now[k] = np.nan
            elif not is_absent:
                last[index, k] = now[k]


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
        self._last = np.full((len(model.sensors), 6), np.nan)
        self.values = np.full(2 * len(model.axes) + 6 * len(model.sensors), np.nan)
        self.take(self.values)  # compiled before a tick waits for it

    def restart(self) -> None:
        """Forget all readings."""
        self._last[:] = np.nan

    def take(self, read: np.ndarray) -> None:
        """Take over a row as read (measurements,)."""
        self.values[:] = read
        _without_repeats(self.values, self._last)
