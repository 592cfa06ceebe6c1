"""Frames of a run, received by a process beside the loop's: taken from the panel, looked at for a marker plate, written as a scan."""

from __future__ import annotations

import csv
import io
import time
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.errors import DriverError
from drivers.imaging import PanelClock
from hil.errors import BadAnswerError, UnusableInputError
from hil.extras import extra_package
from hil.imaging.detector import Detector
from hil.imaging.markers import MarkerProjection
from hil.imaging.scan_folder import FRAMES
from hil.processes.real_time import behind_the_loop
from hil.receiving.frame_measurements import Live, Watch
from hil.receiving.panel_frames import FrameSource, PanelFrames, RemotePanel, SpooledFrames
from hil.receiving.sight import SeenMarker, marker_in, rehearse

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

LOOKS_EVERY_S = 0.01
"""A third of a frame's time at 30 a second; a panel on the network is heard at once."""

PIECE_BYTES = 2**16
"""Written at once: a kernel may leave a processor with whoever writes until that is done, 5 ms for a frame, whatever the loop needs."""

RESTS = 0.25
"""Share of what an image takes that a receiver leaves to others, if need be before the next one: under real-time scheduling they would get
nothing from one that cannot keep up."""

STAMPS, MARKERS, TROUBLE = "stamps.csv", "markers.csv", "trouble.txt"
WATCHED = ("focal_u [m]", "focal_v [m]", "focal_length [m]", "theta_x [rad]", "theta_y [rad]", "theta_z [rad]")


@dataclass(frozen=True)
class ReceiverOrder:
    """Orders for the process.

    Attributes
    ----------
    panel : Path or RemotePanel
        Where frames come from: a folder, or a line.
    folder : Path
        The scan's.
    detector : Detector
    plate : str, optional
        Marker plate to look for in every frame.
    nominal : MarkerProjection, optional
        Where it should be.
    live : Live, optional
        A live calibration that waits for what frames show: the plate, or without one the phantom.
    """

    panel: Path | RemotePanel
    folder: Path
    detector: Detector
    plate: str | None
    nominal: MarkerProjection | None
    live: Live | None = None


def serve(order: ReceiverOrder, is_over: Event, is_ready: Event) -> None:
    """Say when frames may come and take them until the panel is done and all have been taken; leave an error in a file for the bench."""
    try:
        _serve(order, is_over, is_ready)
    except (DriverError, UnusableInputError, OSError) as error:
        (order.folder / TROUBLE).write_text(str(error), encoding="utf-8")


def _serve(order: ReceiverOrder, is_over: Event, is_ready: Event) -> None:
    tifffile = extra_package("tifffile", "images")
    folder = order.folder
    source: FrameSource = SpooledFrames(order.panel) if isinstance(order.panel, Path) else PanelFrames(order.panel)
    watch = None if order.live is None else Watch(order.live, order.detector, order.nominal)
    shape = order.detector.rows, order.detector.columns
    if order.live is not None:
        rehearse(order.detector, order.live.machine, order.plate, order.nominal)
        if order.live.real_time:
            behind_the_loop()
    with (
        _InPieces(folder / FRAMES, "w") as file,
        tifffile.TiffWriter(file) as images,
        (folder / STAMPS).open("w", newline="", encoding="utf-8") as stamps,
        (folder / MARKERS).open("w", newline="", encoding="utf-8") as markers,
    ):
        stamp_rows, marker_rows = csv.writer(stamps), csv.writer(markers)
        marker_rows.writerow(["exposure_id", *WATCHED, "points"])
        is_ready.set()
        marker: SeenMarker | None = None
        busy_s = idle_s = 0.0  # since the last frame was done with
        while True:
            over, began_s = is_over.is_set(), time.monotonic()
            frames = source.poll()
            for frame in frames:
                if frame.image.shape != shape:
                    came = f"{frame.image.shape[1]} x {frame.image.shape[0]}"
                    whose = order.panel if isinstance(order.panel, Path) else f"panel {order.panel.url}"
                    raise UnusableInputError(f"{whose}: frame {frame.exposure_id} is {came} pixels; the panel has {shape[1]} x {shape[0]}")
            # looked at before they are written, as the loop waits for what they show
            skipped = len(frames) - 1 if order.live is not None and order.live.skips else 0
            for k, frame in enumerate(frames):
                if watch is not None and k < skipped:
                    watch.skip(frame)
                    continue
                if order.plate is not None and order.nominal is not None:
                    marker = marker_in(frame.image, order.detector, order.plate, order.nominal, marker)
                    cells = [""] * len(WATCHED) + [0]
                    if marker is not None:
                        cells = [*(repr(float(value)) for value in marker[0]), len(marker[2].index)]
                    marker_rows.writerow([frame.exposure_id, *cells])
                if watch is not None:
                    watch.take(frame, marker)
            for frame in frames:
                images.write(frame.image, contiguous=True)
                stamp_rows.writerow([frame.exposure_id, repr(frame.panel_s), repr(frame.width_s), repr(frame.pulse_s)])
            if frames:
                markers.flush()
                stamps.flush()
            if over and source.is_over:
                return
            busy_s += time.monotonic() - began_s
            if frames:
                if order.live is not None and order.live.real_time and (rest_s := RESTS * busy_s - idle_s) > 0.0:
                    time.sleep(rest_s)
                busy_s = idle_s = 0.0
            began_s = time.monotonic()
            source.wait(LOOKS_EVERY_S)
            idle_s += time.monotonic() - began_s


class _InPieces(io.FileIO):
    """A file that is written in pieces of `PIECE_BYTES`."""

    def fileno(self) -> int:
        """Refuse, as NumPy would write by it, in one piece."""
        raise io.UnsupportedOperation("fileno")

    def write(self, data: ReadableBuffer) -> int:
        """Write all of it."""
        rest = whole = memoryview(data).cast("B")
        while rest:
            rest = rest[super().write(rest[:PIECE_BYTES]) :]
        return len(whole)


def received(folder: Path, period_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, PanelClock]:
    """Return numbers, starts and widths (N,) of what was received, in the time base of the pulses.

    Raises
    ------
    BadAnswerError
        Nothing was received, or the receiver ran into something.
    ClocksDisagreeError
        The panel's stamps do not fit the loop's pulses.
    """
    trouble = folder / TROUBLE
    if trouble.exists():
        raise BadAnswerError(trouble.read_text(encoding="utf-8"))
    with (folder / STAMPS).open(newline="", encoding="utf-8") as file:
        table = np.array([[float(cell) for cell in row] for row in csv.reader(file)])
    if not len(table):
        raise BadAnswerError(f"{folder}: no frame came; is the panel exposing, and is this its folder?")
    clock = PanelClock(table[:, 1], table[:, 3], period_s, table[:, 0])
    return table[:, 0].astype(int), clock.to_loop(table[:, 1]), table[:, 2] * clock.rate, clock
