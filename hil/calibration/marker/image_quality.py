"""Image quality of a running scan, from the marker plate in the images (thesis Sec. 8.2).

Noise, scatter and motion during the exposure all increase the uncertainty of a groove's place; motion also widens its edge in its
direction. So each exposure's deviation and blur against the scan's own median show where image quality suffers, while the scan runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.imaging.markers import MarkerPlate, MarkerPoints

SUSPECT = 5.0
"""An exposure this many robust standard deviations worse than the scan's median is named."""

LEAST_SPREAD = 0.02
"""Of the median: scans differ by that much within themselves, by scatter and the plate's tilt."""


@dataclass(frozen=True)
class ImageQuality:
    """Of N exposures; NaN where the plate was not found.

    Attributes
    ----------
    deviation_pixels : (N,) array
        Root mean square standard deviation of the crossings' coordinates.
    blur_pixels : (N, 2) array
        Standard deviation of the edge's blur along columns and along rows.
    """

    deviation_pixels: np.ndarray
    blur_pixels: np.ndarray

    @property
    def suspects(self) -> list[int]:
        """Return the exposures that are worse than usual for the scan, in order."""
        columns = np.column_stack([self.deviation_pixels, self.blur_pixels])
        middle = np.nanmedian(columns, axis=0)
        spread = np.maximum(1.4826 * np.nanmedian(np.abs(columns - middle), axis=0), LEAST_SPREAD * middle)
        return [int(k) for k in np.flatnonzero((columns > middle + SUSPECT * spread).any(axis=1))]


def quality_of(points: MarkerPoints, plate: MarkerPlate) -> tuple[float, float, float]:
    """Return deviation, blur along columns and blur along rows of one exposure [pixel]."""
    upright = len(plate.x_m)

    def blur(lines: Sequence[float]) -> float:
        return float(np.median(lines)) if lines else float("nan")

    across_columns = blur([line.blur for k, line in points.lines.items() if k < upright])
    across_rows = blur([line.blur for k, line in points.lines.items() if k >= upright])
    return float(np.sqrt(np.mean(np.diag(points.covariance)))), across_columns, across_rows
