"""From the images of a phantom scan to its look-up table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil.calibration.phantom.phantom_calibration import look_for_bullets
from hil.calibration.phantom.pixel_shape import fit_pixels
from hil.calibration.phantom.pose import PoseFit, fit_poses
from hil.calibration.use.lookup_table import LookUp, look_up_of, standing, sweep_speed
from hil.imaging.detector import Detector
from hil.imaging.nominal import nominal_beam
from hil.imaging.phantoms import dodecahedron
from hil.imaging.scan_folder import ImageScan
from hil.machine import Machine


@dataclass(frozen=True)
class PhantomScan:
    """A phantom-calibrated scan.

    Attributes
    ----------
    table : LookUp
    fit : PoseFit
        Of every exposure.
    panel : Detector
        With fitted pixels where they were asked for.
    pixel_sigma : (2,) array or None
        Standard deviations of its aspect and skew.
    """

    table: LookUp
    fit: PoseFit
    panel: Detector
    pixel_sigma: np.ndarray | None


def calibrate_phantom_scan(
    machine: Machine,
    scan: ImageScan,
    *,
    six: bool = False,
    pixels: bool = False,
    at_standstill: bool = False,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> PhantomScan:
    """Calibrate every exposure of a scan of the bullet phantom.

    Parameters
    ----------
    machine : Machine
        Whose file says the nominal geometry.
    scan : ImageScan
    six : bool
        Hold the source at nominal and fit six parameters only.
    pixels : bool
        Fit the pixels' aspect and skew, too, one for the whole scan.
    at_standstill : bool
        Keep the poses at which the machine stood, averaged: a roadmapping grid.
    jobs : int
        Processes that look at images.
    progress : callable
        Told how many of how many images are done.

    Raises
    ------
    UnusableInputError
        Images that show no phantom, or a scan whose axis positions are not known.
    """
    positions = scan.positions_of(machine)
    nominal = nominal_beam(machine, positions)
    bullets = dodecahedron()
    observed, sigma = look_for_bullets(scan, bullets, nominal, jobs, progress)
    panel, known = scan.detector, None
    if pixels:
        seen = panel.to_pixels(observed)
        panel, known = fit_pixels(bullets.centers_m, seen, sigma / panel.pitch_m, nominal, panel).of_the_panel(panel)
        observed = panel.to_metres(seen)
    fit = fit_poses(bullets.centers_m, observed, sigma, nominal, not six)
    speed = [float(each) if np.isfinite(each) else None for each in sweep_speed(scan.middle_s, positions)]
    notes = {"machine": machine.name, "hash": machine.hash, "six": six, "speed": speed}
    table = look_up_of(fit, nominal, scan.axes, positions, notes)
    return PhantomScan(standing(table) if at_standstill else table, fit, panel, known)
