"""Values of a data-driven calibration: an image's measurement, knowledge of the parameters, results."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.calibration.data_driven.quasi_static import QuasiStatic

USED, CHANGE, REFUSED = "used", "change", "refused"
"""What became of an image."""

SPOT_M = 10e-6
"""Wobble of the focal spot with the anode, which cannot be predicted."""


@dataclass(frozen=True)
class Measurement:
    """The measurement from one image.

    Attributes
    ----------
    time_s : float
        Middle of the exposure, in the loop's time.
    values : (k,) array
        "phantom": the nine deviations from the nominal geometry at the observer's positions. "marker": what the plate shows beyond nominal,
        focal_u, focal_v, focal_length [m], theta_x, theta_y, theta_z [rad].
    covariance : (k, k) array
    kind : "phantom" or "marker"
    """

    time_s: float
    values: np.ndarray
    covariance: np.ndarray
    kind: str = "phantom"


Sight = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A measurement's change with the parameters (k, p) and with the displacement (k, 6), and its value beyond the observer's (k,)."""


@dataclass(frozen=True)
class Parameters:
    """Estimate of the quasi-static parameters.

    Attributes
    ----------
    values : (p,) array
    covariance : (p, p) array
    """

    values: np.ndarray
    covariance: np.ndarray

    @classmethod
    def unknown(cls, model: QuasiStatic) -> Parameters:
        """Return the prior, before any image."""
        return cls(np.zeros(len(model.names)), np.diag(model.prior**2))

    def aged(self, model: QuasiStatic) -> Parameters:
        """Return the parameters for another scan than the one they were found in."""
        return Parameters(self.values.copy(), self.covariance + np.diag(model.between_scans**2))


@dataclass
class Calibration:
    """The geometry found for a recording.

    Attributes
    ----------
    live : (N, 9) array
        Deviations from nominal as they were known at each sample.
    final : (N, 9) array
        With the parameters found at the end; where marker plates were seen, with the displacement that all images tell.
    covariance : (N, 9, 9) array
        Of `live`.
    parameters : Parameters
        At the end.
    used, refused : lists of int
        Measurements taken in, and those that contradict the rest.
    changes : list of int
        Measurements at which the mount was found moved.
    phantoms : int
        How many of those used show the phantom.
    converged : int or None
        How many of these it took until the place was known as well as asked for.
    history : (images + 1, p) array, (images + 1, p) array
        Parameters and their standard deviations after each image.
    place_sigma_m : list of float
        Predicted standard deviation of the isocentre's place over the recording after each image.
    """

    live: np.ndarray
    final: np.ndarray
    covariance: np.ndarray
    parameters: Parameters
    used: list[int] = field(default_factory=list)
    refused: list[int] = field(default_factory=list)
    changes: list[int] = field(default_factory=list)
    phantoms: int = 0
    converged: int | None = None
    history: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    place_sigma_m: list[float] = field(default_factory=list)

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviations of `live`, (N, 9)."""
        root: np.ndarray = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        return root
