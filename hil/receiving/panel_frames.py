"""Frames of a run from wherever its panel leaves them: a spool folder, or a panel on the network that is told when the recording runs."""

from __future__ import annotations

import time
from dataclasses import dataclass
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Protocol

import numpy as np

from drivers.imaging import Frame, FrameSpool, PanelError, PanelLink

ENDS_WITHIN_S = 60.0
"""After `stop`, the longest time in which nothing comes: an emulated panel's images lie behind its exposures."""


class RowSpan:
    """Shared memory: the SYNCs, counted from the nodes' start, of a recording's first and last row; -1 before they are known.

    Parameters
    ----------
    context
        Of `multiprocessing`, whose processes get it as an argument.
    """

    def __init__(self, context: BaseContext) -> None:
        self._memory = context.RawArray("q", [-1, -1])

    def begin(self, syncs: int) -> None:
        """Set row 0 to the next SYNC, after so many."""
        self._memory[0] = syncs + 1

    def end(self, syncs: int) -> None:
        """Set the last row to the last of so many SYNCs."""
        self._memory[1] = syncs

    @property
    def first(self) -> int:
        """SYNC of row 0."""
        return int(self._memory[0])

    @property
    def last(self) -> int:
        """SYNC of the last row."""
        return int(self._memory[1])


@dataclass(frozen=True)
class RemotePanel:
    """A panel on the network, its settings, and when it is told them."""

    url: str
    rate_Hz: float
    binning: int
    period_s: float
    span: RowSpan


class FrameSource(Protocol):
    """Source of the receiving process's frames."""

    def poll(self) -> list[Frame]:
        """Return frames that have come since."""

    def wait(self, seconds: float) -> None:
        """Wait so long, or until something has come."""

    @property
    def is_over(self) -> bool:
        """Tell whether nothing more comes once the run is over."""


class SpooledFrames:
    """A folder: what is in it when the run is over is complete."""

    is_over = True

    def __init__(self, folder: Path) -> None:
        self.poll = FrameSpool(folder).poll

    def wait(self, seconds: float) -> None:
        """See `FrameSource`."""
        time.sleep(seconds)


class PanelFrames:
    """A panel on the network that exposes from row 0 to the last; frames outside are left out.

    Parameters
    ----------
    panel : RemotePanel

    Raises
    ------
    BusUnavailableError
    """

    def __init__(self, panel: RemotePanel) -> None:
        self._panel, self._span = panel, panel.span
        self._link = PanelLink(panel.url, panel.period_s)
        self._is_told = self._is_stopped = False
        self._heard_s = time.monotonic()
        self.wait = self._link.wait

    def poll(self) -> list[Frame]:
        """See `FrameSource`.

        Raises
        ------
        PanelError
            The panel is gone, sends no frames, or does not say that it has ended.
        """
        panel, span = self._panel, self._span
        if not self._is_told and span.first >= 0:
            self._link.expose(panel.rate_Hz, panel.binning, span.first)
            self._is_told = True
        if self._is_told and not self._is_stopped and span.last >= 0:
            self._link.stop()
            self._is_stopped, self._heard_s = True, time.monotonic()
        frames = self._link.poll()
        if frames:
            self._heard_s = time.monotonic()
        elif self._is_stopped and not self.is_over and time.monotonic() - self._heard_s > ENDS_WITHIN_S:
            raise PanelError(f"panel {panel.url}: was told to stop and has not said that it has for {ENDS_WITHIN_S:.0f} s")
        last_s = np.inf if span.last < 0 else (span.last - span.first) * panel.period_s
        return [frame for frame in frames if frame.pulse_s > 0.0 and frame.pulse_s + frame.width_s <= last_s]

    @property
    def is_over(self) -> bool:
        """See `FrameSource`."""
        return not self._is_told or self._link.exposures is not None
