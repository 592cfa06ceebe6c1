"""Frames of a run, received by a process beside the loop's: taken from the spool, looked at for a marker plate, written as a scan."""

from __future__ import annotations

import csv
import time
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np

from drivers.errors import DriverError
from drivers.imaging import FrameSpool, PanelClock
from hil.calibration.marker import fit_marker
from hil.errors import UnusableInput
from hil.imaging.detector import Detector
from hil.imaging.extra import imaging_package
from hil.imaging.markers import PLATES, MarkerProjection, find_marker
from hil.imaging.scan_folder import FRAMES

LOOKS_EVERY_S = 0.05
STAMPS, MARKERS, TROUBLE = "stamps.csv", "markers.csv", "trouble.txt"
WATCHED = ("focal_u [m]", "focal_v [m]", "focal_length [m]", "theta_x [rad]", "theta_y [rad]", "theta_z [rad]")


@dataclass(frozen=True)
class ReceiverOrder:
    """What the process is told.

    Attributes
    ----------
    spool, folder : Path
        Where frames come from, and the scan's folder.
    detector : Detector
    plate : str, optional
        Marker plate to look for in every frame.
    nominal : MarkerProjection, optional
        Where it should be.
    """

    spool: Path
    folder: Path
    detector: Detector
    plate: str | None
    nominal: MarkerProjection | None


def serve(order: ReceiverOrder, is_over: Event) -> None:
    """Take frames until the panel is done and all have been taken; what goes wrong is left in a file for the bench to say."""
    try:
        _serve(order, is_over)
    except (DriverError, UnusableInput, OSError) as error:
        (order.folder / TROUBLE).write_text(str(error), encoding="utf-8")


def _serve(order: ReceiverOrder, is_over: Event) -> None:
    tifffile = imaging_package("tifffile", "images")
    spool, folder = FrameSpool(order.spool), order.folder
    shape = order.detector.rows, order.detector.columns
    with (
        tifffile.TiffWriter(folder / FRAMES) as images,
        (folder / STAMPS).open("w", newline="", encoding="utf-8") as stamps,
        (folder / MARKERS).open("w", newline="", encoding="utf-8") as markers,
    ):
        stamp_rows, marker_rows = csv.writer(stamps), csv.writer(markers)
        marker_rows.writerow(["exposure_id", *WATCHED, "points"])
        while True:
            over = is_over.is_set()
            for frame in spool.poll():
                if frame.image.shape != shape:
                    came = f"{frame.image.shape[1]} x {frame.image.shape[0]}"
                    raise UnusableInput(f"{order.spool}: frame {frame.exposure_id} is {came} pixels; the panel has {shape[1]} x {shape[0]}")
                images.write(frame.image, contiguous=True)
                stamp_rows.writerow([frame.exposure_id, repr(frame.panel_s), repr(frame.width_s), repr(frame.pulse_s)])
                if order.plate is not None and order.nominal is not None:
                    marker_rows.writerow([frame.exposure_id, *_look(frame.image, order.plate, order.nominal, order.detector)])
                    markers.flush()
                stamps.flush()
            if over:
                return
            time.sleep(LOOKS_EVERY_S)


def _look(image: np.ndarray, name: str, nominal: MarkerProjection, detector: Detector) -> list[object]:
    """The plate's six parameters in one frame, empty where it is not seen."""
    plate = PLATES[name]()
    try:
        found = find_marker(image, plate, nominal, detector)
        fit = fit_marker(found, plate, detector, nominal)
    except UnusableInput:
        return [""] * len(WATCHED) + [0]
    return [*(repr(float(value)) for value in fit.projection.values[:6]), len(found.index)]


def received(folder: Path, period_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, PanelClock]:
    """Numbers, starts and widths (N,) in the loop's time of what was received.

    Raises
    ------
    UnusableInput
        Nothing was received, or the receiver ran into something.
    ClocksDisagree
        The panel's stamps do not fit the loop's pulses.
    """
    trouble = folder / TROUBLE
    if trouble.exists():
        raise UnusableInput(trouble.read_text(encoding="utf-8"))
    with (folder / STAMPS).open(newline="", encoding="utf-8") as file:
        table = np.array([[float(cell) for cell in row] for row in csv.reader(file)])
    if not len(table):
        raise UnusableInput(f"{folder}: no frame came; is the panel exposing, and is this its folder?")
    clock = PanelClock(table[:, 1], table[:, 3], period_s)
    return table[:, 0].astype(int), clock.to_loop(table[:, 1]), table[:, 2] * clock.rate, clock
