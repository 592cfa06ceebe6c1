"""Measurements that arrive late: an image says where the detector was some rows ago.

The observer goes back to that row, takes the image in, and runs through the rows since, which are kept. So a late image counts for exactly
what it would have counted for in time; it costs as many steps as it is late.
"""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_compiled
from controllers.errors import DesignError
from controllers.observers.modal_equations import first_offset
from controllers.observers.modal_observer import ModalObserver
from controllers.observers.publish import displacement_rows, quasi_static
from controllers.observers.square_root import triangularise, update


@exactly_compiled
def _take_in(constants, values, memory, seen, std):  # type: ignore[no-untyped-def]
    n, modes, states = constants.sizes[0], constants.sizes[1], constants.sizes[4]
    rows = np.zeros((2 * n + 6, n + modes))
    displacement_rows(constants, values, memory.x[:n], rows)
    offset = np.zeros(6)
    quasi_static(constants, values, memory.x[:n], rows, offset)
    measured = 0
    for j in range(6):
        measured += seen[j] == seen[j]
    if measured == 0:
        return
    array = np.zeros((measured + states, measured + states))
    innovation = np.zeros(measured)
    column = 0
    for j in range(6):
        if seen[j] != seen[j]:
            continue
        expected = offset[j]
        for i in range(n + modes):
            state = i if i < n else n + i  # [q_r, η] in the state
            expected += rows[2 * n + j, i] * memory.x[state]
            for s in range(states):
                array[measured + s, column] += memory.factor[s, state] * rows[2 * n + j, i]
        if constants.sizes[9] > n:
            state = first_offset(constants) + n + j
            expected += memory.x[state]
            for s in range(states):
                array[measured + s, column] += memory.factor[s, state]
        array[column, column] = std[j]
        innovation[column] = seen[j] - expected
        column += 1
    for s in range(states):
        for k in range(states):
            array[measured + s, measured + k] = memory.factor[s, k]
    triangularise(array, measured + states, measured + states)
    update(array, measured, states, innovation, memory.x, memory.factor)


class LateImages:
    """An observer that also takes late displacements of its detector.

    Parameters
    ----------
    observer : ModalObserver
    rows : int
        How late an image may be.
    """

    def __init__(self, observer: ModalObserver, rows: int = 256) -> None:
        self.observer, self.rows = observer, rows
        states, measurements, axes = len(observer.state), len(observer.model.channels()), len(observer.model.axes)
        self._x, self._factor = np.zeros((rows, states)), np.zeros((rows, states, states))
        self._z, self._command = np.zeros((rows, measurements)), np.zeros((rows, axes))
        self.restart()

    def restart(self) -> None:
        """As the observer's: the next row is row 0."""
        self.observer.restart()
        self.row = -1

    def step_measured(self, z: np.ndarray, command: np.ndarray) -> None:
        """As the observer's."""
        self.observer.step_measured(z, command)
        self.row += 1
        self._keep(z, command)

    def image(self, row: int, displacement: np.ndarray, std: np.ndarray) -> None:
        """The detector's displacement (6,) [m, rad] at a row of the past, NaN where the image does not tell, with standard deviations (6,).

        Raises
        ------
        DesignError
            The row is not kept, or a standard deviation is not positive.
        """
        if not max(0, self.row - self.rows + 2) <= row <= self.row:
            raise DesignError(f"image of row {row}: rows {max(0, self.row - self.rows + 2)} to {self.row} are kept")
        known = np.isfinite(displacement)
        if not (np.asarray(std)[known] > 0.0).all():
            raise DesignError(f"image of row {row}: standard deviations must be positive, not {np.asarray(std)[known]}")
        seen, now, slot = np.where(known, displacement, np.nan), self.row, row % self.rows
        observer = self.observer
        observer.go_back(self._x[slot], self._factor[slot], self._command[slot] if row else None)
        values = observer.model.at(observer.state[: len(observer.model.axes)])
        _take_in(observer.constants, values, observer.memory, seen, np.asarray(std, float))
        self._x[slot], self._factor[slot] = observer.state, observer.memory.factor
        for later in range(row + 1, now + 1):
            slot = later % self.rows
            observer.step_measured(self._z[slot], self._command[slot])
            self._x[slot], self._factor[slot] = observer.state, observer.memory.factor

    def _keep(self, z: np.ndarray, command: np.ndarray) -> None:
        slot = self.row % self.rows
        self._x[slot], self._factor[slot] = self.observer.state, self.observer.memory.factor
        self._z[slot], self._command[slot] = z, command
