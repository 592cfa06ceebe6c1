"""Inputs of the sample loop: the rows of a plan, and a request to stop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Signals(Protocol):
    """The signals of a plan, row by row, for all axes: arrays of shape (N, n_axes)."""

    @property
    def reference(self) -> np.ndarray:
        """Reference after any shaper [rad or m]."""

    @property
    def reference_raw(self) -> np.ndarray:
        """Reference before any shaper [rad or m]."""

    @property
    def excitation(self) -> np.ndarray:
        """Excitation w in the drives' units."""

    @property
    def feedforward(self) -> np.ndarray | None:
        """Feedforward in the drives' units; None where no axis has one."""


@dataclass
class StopRequest:
    """A request to stop, set from a signal handler or another thread; the loop checks it once per tick."""

    reason: str = ""

    def ask(self, reason: str) -> None:
        """Ask the loop to stop the motors and end; the first reason stands."""
        self.reason = self.reason or reason
