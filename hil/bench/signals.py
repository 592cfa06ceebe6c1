"""What the sample loop is given: the rows of a plan, and a request to stop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Signals(Protocol):
    """What a plan holds, row by row, for all axes: arrays of shape (N, n_axes)."""

    @property
    def reference(self) -> np.ndarray: ...
    @property
    def reference_raw(self) -> np.ndarray: ...
    @property
    def excitation(self) -> np.ndarray: ...
    @property
    def feedforward(self) -> np.ndarray | None: ...


@dataclass
class StopRequest:
    """Set from a signal handler or another thread; the loop looks at it once per tick."""

    reason: str = ""

    def ask(self, reason: str) -> None:
        """Ask the loop to stop the motors and end; the first reason stands."""
        self.reason = self.reason or reason
