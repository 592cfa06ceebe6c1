"""The inputs of a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

COMPILED_FOR: Final = ("C_CONTIGUOUS", "WRITEABLE")
"""Arrays that kernels take. Numba compiles a kernel once more for arrays that are read-only, as those of a recording are."""


@dataclass(frozen=True)
class Restarts:
    """Rows at which a simulation goes on from a given state: the windows of a recording, one after the other, in one run.

    Attributes
    ----------
    rows : (R,) int array
    joints : (F,) int array
        Which joints are set; the others, such as springs that no sensor follows, keep their simulated state.
    position, speed : (R, F) arrays
    """

    rows: np.ndarray
    joints: np.ndarray
    position: np.ndarray
    speed: np.ndarray


@dataclass(frozen=True)
class Inputs:
    """The inputs of a simulation; arrays (N, n_axes) in axis order.

    Attributes
    ----------
    reference : array or None
        [rad or m]; None for a machine without controllers.
    excitation : array
        w, in the drives' units.
    feedforward : array
        In the drives' units.
    command : array or None
        Used instead of a reference for a machine without controllers.
    start_pose : (n_axes,) array
        The requested pose at row 0.
    deviation : (n_axes,) array or None
        Deviation of the axes from it, in elastic equilibrium [rad or m]; None: zero.
    start_speed : (n_axes,) array or None
        Speeds of the driven joints at row 0 [rad/s or m/s], springs at rest; None: standstill.
    controller_states : mapping or None
        As `Feedback.states`; None: integrators at the holding effort.
    first_effort : (n_axes,) array or None
        Beside a command: acts from row 0 on, until the first command does; None: what holds the machine there.
    restarts : Restarts or None
        Of machines that run side by side.
    """

    reference: np.ndarray | None
    excitation: np.ndarray
    feedforward: np.ndarray
    command: np.ndarray | None
    start_pose: np.ndarray
    controller_states: Mapping[str, Any] | None = None
    start_speed: np.ndarray | None = None
    deviation: np.ndarray | None = None
    first_effort: np.ndarray | None = None
    restarts: Restarts | None = None

    @property
    def standing_pose(self) -> np.ndarray:
        """Positions (n_axes,) of the axes at row 0."""
        return self.start_pose if self.deviation is None else self.start_pose + self.deviation

    @property
    def settled(self) -> Inputs:
        """Return the inputs without recorded controller states, so that the controllers hold any simulated machine at row 0."""
        return self if self.start_speed is not None else replace(self, controller_states=None)
