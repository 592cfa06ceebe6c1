"""The observer in the sample loop: what the loop hands over per tick, and what a recording gets."""

from __future__ import annotations

from typing import Any

import numpy as np

from controllers.observers.modal_observer import ModalObserver
from drivers.interface import Sample
from hil.observing.measured import MeasuredRow


class LiveObserver:
    """One observer for the loop.

    Parameters
    ----------
    observer : ModalObserver
    design : str
        Where its design is from, for the recording's metadata.

    Attributes
    ----------
    channels : list of (name, unit)
        Columns for the recording, in the order of `estimate`.
    estimate : (channels,) array
        Overwritten by every step; NaN before the first.
    effort : (n_axes,) array
        What it adds to the command: nothing.
    metadata : mapping
        Of the recording, so that a replay is the same filter.
    """

    def __init__(self, observer: ModalObserver, design: str = "") -> None:
        self.observer = observer
        self.channels = list(observer.channels)
        self.estimate = observer.estimate
        axes = len(observer.model.axes)
        self.effort = np.zeros(axes)
        adapted = [mode + 1 for mode in observer.adapted]
        self.metadata: dict[str, Any] = {"design": design, "filter": observer.kind, "adapted_modes": adapted}
        self._row = MeasuredRow(observer.model)
        self._read = np.full(2 * axes + 6, np.nan)
        observer.step_measured(self._row.values, np.zeros(axes))  # compiled before a tick waits for it
        self.restart(0)

    def restart(self, rows: int) -> None:
        """Before row 0 of a recording: a replay starts there, too."""
        self._row.restart()
        self.observer.restart()

    def step(self, sample: Sample, command: np.ndarray) -> None:
        """One tick, before the feedback: this tick's sample and the previous row's command (n_axes,), which is on the wire."""
        read, axes = self._read, len(command)
        read[:axes] = sample.position
        read[axes : 2 * axes] = sample.link_position
        read[2 * axes :] = sample.imu
        self._row.take(read)
        self.observer.step_measured(self._row.values, command)
