"""Feedback of all axes, once per sample: u = C_r r - C_y y + w + feedforward, saturated.

A missing (not finite) reference or position freezes that axis's filters and repeats their last output; a command that would not be finite
repeats the last one. So every command is a number within the limits. The returned mask says on which axes it is a substitute; the loop
decides how long that may go on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from controllers.errors import DesignError
from controllers.sections import feedback_step, preload_state, standstill_states
from controllers.settings import AxisController


class Feedback:
    """The controllers of all axes, with their states.

    Parameters
    ----------
    controllers : sequence of AxisController
        In axis order.

    Raises
    ------
    DesignError
        Sections that are not finite rows (b0, b1, b2, 1, a1, a2).
    """

    def __init__(self, controllers: Sequence[AxisController]) -> None:
        self.controllers = tuple(controllers)
        blocks: list[np.ndarray] = []
        rows: list[tuple[int, int, int]] = []
        end = 0
        for controller in self.controllers:
            separate = controller.reference_sections
            reference = np.empty((0, 6)) if separate is None else _checked(controller.axis, separate)
            position = _checked(controller.axis, controller.position_sections)
            rows.append((end, end + len(reference), end + len(reference) + len(position)))
            end = rows[-1][2]
            blocks += [reference, position]
        self._sections = np.ascontiguousarray(np.vstack(blocks))
        self._rows = np.array(rows, dtype=np.int64)
        self._limit = np.array([controller.limit for controller in self.controllers], dtype=float)
        self._state = np.zeros((end, 2))
        self._held = np.zeros((len(self.controllers), 2))

    def step(self, reference: np.ndarray, position: np.ndarray, excitation: np.ndarray, feedforward: np.ndarray, out: np.ndarray) -> int:
        """Write the saturated command of this sample into `out`; all arrays are (n_axes,) float64.

        Returns
        -------
        int
            Bit i set: axis i had a missing value, and its command repeats the last good one.
        """
        return feedback_step(
            self._sections, self._state, self._rows, self._limit, self._held, reference, position, excitation, feedforward, out
        )

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """`sections`, `state`, `rows`, `limit`, `held` as `feedback_step` takes them; a kernel that runs on them advances this object."""
        return self._sections, self._state, self._rows, self._limit, self._held

    def reset(self) -> None:
        """Set all states to zero."""
        self._state[:] = 0.0
        self._held[:] = 0.0

    def preload(self, holding_effort: np.ndarray, position: np.ndarray, feedforward: np.ndarray | None = None) -> None:
        """Set the states of a lasting standstill: r = y = `position` and command = `holding_effort`, part of it from `feedforward`.

        Parameters
        ----------
        holding_effort, position, feedforward : (n_axes,) arrays
            Efforts in the drives' units; `feedforward` None is zero.

        Raises
        ------
        DesignError
            An axis has no integrator to hold what feedforward leaves, or must hold more than its limit.
        """
        brought = np.zeros(len(self.controllers)) if feedforward is None else np.asarray(feedforward, dtype=float)
        self.reset()
        for axis, controller in enumerate(self.controllers):
            holding = float(holding_effort[axis])
            if abs(holding) > controller.limit:
                raise DesignError(f"{controller.axis}: standstill takes {holding:.4g}, the limit is {controller.limit:.4g}")
            share = holding - float(brought[axis])
            first, middle, end = self._rows[axis]
            try:
                if first == middle:
                    self._state[middle:end] = preload_state(self._sections[middle:end], share)
                else:
                    self._state[first:middle], self._state[middle:end] = standstill_states(
                        self._sections[first:middle], self._sections[middle:end], float(position[axis]), share
                    )
            except DesignError as error:
                raise DesignError(f"{controller.axis}: {error}") from None
            self._held[axis] = share, holding

    @property
    def states(self) -> dict[str, dict[str, np.ndarray]]:
        """Copies of all `zi` arrays: axis -> {"position": (n, 2)} and, with a separate C_r, {"reference": (m, 2)}."""
        table: dict[str, dict[str, np.ndarray]] = {}
        for controller, (first, middle, end) in zip(self.controllers, self._rows, strict=True):
            table[controller.axis] = {"position": self._state[middle:end].copy()}
            if middle > first:
                table[controller.axis]["reference"] = self._state[first:middle].copy()
        return table

    def load_states(self, states: Mapping[str, Mapping[str, ArrayLike]]) -> None:
        """Load the states that `states` returned, as arrays or nested lists.

        Raises
        ------
        DesignError
            An axis or filter is missing, or an array has another shape.
        """
        for controller, (first, middle, end) in zip(self.controllers, self._rows, strict=True):
            for name, rows in (("reference", slice(first, middle)), ("position", slice(middle, end))):
                if rows.start == rows.stop:
                    continue
                try:
                    values = np.asarray(states[controller.axis][name], dtype=float)
                except KeyError:
                    raise DesignError(f"controller states: {controller.axis}.{name} is missing") from None
                fits = (rows.stop - rows.start, 2)
                if values.shape != fits:
                    raise DesignError(f"controller states: {controller.axis}.{name} has shape {values.shape}, {fits} fits")
                self._state[rows] = values
        self._held[:] = 0.0


def _checked(axis: str, sections: np.ndarray) -> np.ndarray:
    table = np.asarray(sections, dtype=float)
    if table.ndim != 2 or table.shape[1] != 6 or len(table) == 0 or not np.isfinite(table).all() or (table[:, 3] != 1.0).any():
        raise DesignError(f"{axis}: sections must be finite rows (b0, b1, b2, 1, a1, a2), at least one")
    return table
