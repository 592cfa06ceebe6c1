"""Data-driven calibration (Chapter 5): quasi-static parameters and the detector's displacement as states of one filter at the sample rate.

The observer's estimate moves the displacement from sample to sample, and its error decays to zero, so that it cannot drift. The parameters
are constant, except for what they may have changed by since the last scan. Images measure the sum of both at the instant they show. They
arrive late: the displacement of that instant is kept as a separate state until they do, which is the same as having had them in time. Once
the parameters have converged, the filter can do without images of the phantom.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from controllers.filtering.late_measurements import LateMeasurements
from hil.calibration.data_driven.quasi_static import QuasiStatic
from hil.calibration.data_driven.values import CHANGE, REFUSED, USED, Parameters

STRAYS_S = 3.0
"""How long an error of the observer's displacement lasts: most of it lies below 0.5 Hz (docs/explanation/observer.md)."""

CHANGED = {size: float(chi2.ppf(1.0 - 1e-6, size)) for size in (6, 9)}
"""Limit of an image's normalised innovation by its size: beyond it the machine has changed, or the image shows something else."""


class DataDrivenFilter(LateMeasurements):
    """States: p parameters, six errors of the observer's displacement, and six more for every image on its way.

    Parameters
    ----------
    model : QuasiStatic
    start : Parameters
    displacement_std : (6,) array

    Attributes
    ----------
    x, covariance : (states,), (states, states) arrays
    renewed_variance : (6,) array
        Of the displacement's error once nothing is known of it.
    """

    def __init__(self, model: QuasiStatic, start: Parameters, displacement_std: np.ndarray) -> None:
        self.model, self.size = model, len(model.names)
        self.renewed_variance = np.asarray(displacement_std) ** 2
        count = self.size + 6
        super().__init__(np.zeros(count), np.zeros((count, count)), np.arange(self.size, count))
        self.x[: self.size] = start.values
        self.covariance[: self.size, : self.size] = start.covariance
        self.covariance[self.size :, self.size :] = np.diag(self.renewed_variance)

    @property
    def parameters(self) -> Parameters:
        """Return the present estimate."""
        return Parameters(self.x[: self.size].copy(), self.covariance[: self.size, : self.size].copy())

    def predict(self, seconds: float) -> None:
        """Let time pass: the displacement's error fades and is renewed."""
        place = slice(self.size, self.size + 6)
        kept = np.exp(-seconds / STRAYS_S)
        self.x[place] *= kept
        self.covariance[place, :] *= kept
        self.covariance[:, place] *= kept
        self.covariance[place, place] += (1.0 - kept**2) * np.diag(self.renewed_variance)

    def innovation(self, number: int, rows: np.ndarray, twist: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what an image measures beyond what is expected, and how it depends on the states.

        Parameters
        ----------
        number : int
            Of an image exposed.
        rows : (k, p) array
            Change of what it measures with the parameters.
        twist : (k, 6) array
            With the detector's displacement.
        rest : (k,) array
            Measured, less what the observer says.
        """
        gradient = np.zeros((len(rest), len(self.x)))
        gradient[:, : self.size] = rows
        gradient[:, self.copies(number)] = twist
        return rest - gradient @ self.x, gradient

    def forget_mount(self) -> None:
        """Make the mount unknown: the machine was moved against what is imaged."""
        for k, name in enumerate(self.model.names):
            if name.startswith(("mount_place", "mount_turn")):
                self.covariance[k, k] += self.model.prior[k] ** 2


def displacement_columns(model: QuasiStatic) -> slice:
    """Return the columns of the detector's own offsets: its displacement moves the geometry as they do."""
    first = model.names.index("detector_place_x")
    return slice(first, first + 6)


def take_in(work: DataDrivenFilter, k: int, rows: np.ndarray, twist: np.ndarray, rest: np.ndarray, covariance: np.ndarray) -> str:
    """Take in a measurement that was exposed as number `k`, see `DataDrivenFilter.innovation`.

    Returns
    -------
    str
        `USED`; `CHANGE`: after the mount had been made unknown; `REFUSED`: it contradicts even then.
    """
    innovation, gradient = work.innovation(k, rows, twist, rest)
    how = USED
    if work.surprise(innovation, gradient, covariance) > CHANGED[len(innovation)]:
        before = work.covariance.copy()
        work.forget_mount()
        if work.surprise(innovation, gradient, covariance) > CHANGED[len(innovation)]:
            work.covariance = before
            return REFUSED
        how = CHANGE
    work.update(innovation, gradient, covariance)
    return how


def place_sigma(work: DataDrivenFilter, rows: np.ndarray) -> float:
    """Return the standard deviation [m] of the isocentre's place in the detector's frame by the parameters alone.

    It is the rms over poses, per component.
    """
    covariance = work.covariance[: work.size, : work.size]
    return float(np.sqrt(np.mean(np.sum((rows @ covariance) * rows, axis=2))))
