"""The observer in the sample loop: what the loop hands over per tick, and what a recording gets."""

from __future__ import annotations

import numpy as np

from controllers.observers.modal_observer import ModalObserver
from drivers.interface import Sample


class LiveObserver:
    """One observer for the loop.

    Parameters
    ----------
    observer : ModalObserver

    Attributes
    ----------
    channels : list of (name, unit)
        Columns for the recording, in the order of `estimate`.
    estimate : (channels,) array
        Overwritten by every step; NaN before the first.
    """

    def __init__(self, observer: ModalObserver) -> None:
        self.observer = observer
        self.channels = observer.channels
        self.estimate = observer.estimate
        nothing = np.full(len(observer.model.axes), np.nan)
        observer.step(nothing, nothing, np.full(6, np.nan), np.zeros(len(nothing)))  # compiled before a tick waits for it
        self.restart()

    def restart(self) -> None:
        """Before row 0 of a recording: a replay starts there, too."""
        self.observer.restart()

    def step(self, sample: Sample, command: np.ndarray) -> None:
        """One tick, before the feedback: this tick's sample and the previous row's command (n_axes,), which is on the wire."""
        self.observer.step(sample.position, sample.link_position, sample.imu, command)
