"""Frames looked at as they come, and their measurements sent to the loop (`hil.imaging.mailbox`)."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass

import numpy as np

from drivers.imaging import Frame, PanelClock
from hil.imaging.detector import Detector
from hil.imaging.mailbox import Mailbox, Sighting
from hil.imaging.markers import MarkerProjection
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine
from hil.receiving.sight import SeenMarker, phantom_in

TOLD_WITHIN_S = 0.1
"""Longest wait for a row: the loop has stopped, or loses ticks."""

ASKS_EVERY_S = 1e-3

PULSES = 1024
"""The last of them tell the panel's clock to a thousandth of a tick; all of an hour's would take as long as the image."""


@dataclass(frozen=True)
class Live:
    """What a receiver needs to serve a live calibration: the machine, and where its measurements go.

    `counts_syncs` is a panel's whose pulses are in periods of SYNC, not in the loop's time. With `skips`, a frame behind which a newer one
    waits is not looked at, so that what is looked at is never old; in lockstep, where time stands still meanwhile, all are. With
    `real_time`, the receiver asks for real-time scheduling, after the loop.
    """

    machine: Machine
    mailbox: Mailbox
    counts_syncs: bool = False
    skips: bool = False
    real_time: bool = False


class Watch:
    """Turns frames into sightings.

    The panel's clock in the loop's time is a line through the last pulses, known to some part of a tick; to half of one from the first.
    Its uncertainty is counted in the covariance: a pose that is some milliseconds off is off along the motion.

    Parameters
    ----------
    live : Live
    detector : Detector
    nominal : MarkerProjection, optional
        Of the marker plate that is looked for; None: the phantom is.
    """

    def __init__(self, live: Live, detector: Detector, nominal: MarkerProjection | None) -> None:
        self._machine, self._mailbox, self._detector, self._nominal = live.machine, live.mailbox, detector, nominal
        self._counts_syncs = live.counts_syncs
        self._period_s = 1.0 / live.machine.sample_rate_Hz
        self._panel_s: deque[float] = deque(maxlen=PULSES)
        self._pulse_s: deque[float] = deque(maxlen=PULSES)
        self._ids: deque[int] = deque(maxlen=PULSES)
        self._handled = 0

    def take(self, frame: Frame, plate: SeenMarker | None) -> None:
        """Take one frame, and the marker plate's parameters in it, where one is looked for.

        They come from `hil.receiving.sight.marker_in`.

        Raises
        ------
        ClocksDisagreeError
        """
        self._stamp(frame)
        clock = PanelClock(np.array(self._panel_s), np.array(self._pulse_s), self._period_s, np.array(self._ids), fewest=1)
        self._send(frame, plate, clock)
        self._mailbox.handled()
        self._handled += 1

    def skip(self, frame: Frame) -> None:
        """Leave a frame out, of which only the stamps count."""
        self._stamp(frame)
        self._mailbox.skipped()

    def _stamp(self, frame: Frame) -> None:
        self._panel_s.append(frame.panel_s)
        self._pulse_s.append(frame.pulse_s)
        self._ids.append(frame.exposure_id)

    def _until_told(self, time_s: float) -> None:
        """Wait until the loop has told the row after a time: a fast panel's image is there before it."""
        row, given_up_s = int(time_s / self._period_s) + 1, time.monotonic() + TOLD_WITHIN_S
        while self._mailbox.newest(syncs=self._counts_syncs) < row and time.monotonic() < given_up_s:
            time.sleep(ASKS_EVERY_S)

    def _send(self, frame: Frame, plate: SeenMarker | None, clock: PanelClock) -> None:
        time_s = float(clock.to_loop(np.array(frame.panel_s))) + 0.5 * frame.width_s * clock.rate
        is_before_row_0 = time_s < 0.0
        self._until_told(time_s)
        if self._counts_syncs:
            time_s = self._mailbox.loop_time(time_s, self._period_s)
        here = before = None
        if np.isfinite(time_s):
            here = self._mailbox.pose_at(time_s, self._period_s)
            before = self._mailbox.pose_at(max(time_s - self._period_s, 0.0), self._period_s)
        if here is None or before is None:
            if not is_before_row_0:
                self._mailbox.unplaced()
            return
        if self._nominal is not None:
            if plate is not None:
                values = plate[0] - self._nominal.values[:6]
                self._mailbox.send(Sighting(frame.exposure_id, self._handled, time_s, "marker", here, values, plate[1]))
            return
        found = phantom_in(frame.image, self._detector, self._machine, here)
        if found is None:
            return
        moving = nominal_beam(self._machine, here).deviation_from(nominal_beam(self._machine, before))[0] / self._period_s
        covariance = found[1] + clock.doubt_s**2 * np.outer(moving, moving)
        self._mailbox.send(Sighting(frame.exposure_id, self._handled, time_s, "phantom", here, found[0], covariance))
