"""The detector's pixels: from metres on its plane to columns and rows of the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Detector:
    """A flat panel.

    Pixel (column 0, row 0) is the first stored value of an image array `image[row, column]`; integer coordinates are pixel centres.
    Columns grow with u, rows with v, the panel's centre lies in the middle of the image.

    Attributes
    ----------
    columns, rows : int
    pitch_m : float
        Distance of neighbouring columns [m].
    aspect : float
        Row pitch over column pitch; the thesis's 1 / eta (6.4), without its sign.
    skew : float
        Columns of shift to the right for each row; the thesis's tau (6.4) in pixels.
    """

    columns: int
    rows: int
    pitch_m: float
    aspect: float = 1.0
    skew: float = 0.0

    @property
    def intrinsic(self) -> np.ndarray:
        """Matrix (3, 3) from homogeneous metres (u, v, 1) on the panel to homogeneous (column, row, 1)."""
        scale = 1.0 / self.pitch_m
        middle_row = (self.rows - 1) / 2.0
        return np.array(
            [
                [scale, self.skew * scale / self.aspect, (self.columns - 1) / 2.0],
                [0.0, scale / self.aspect, middle_row],
                [0.0, 0.0, 1.0],
            ]
        )

    def to_pixels(self, points_m: np.ndarray) -> np.ndarray:
        """Convert metres on the panel (..., 2) to columns and rows (..., 2)."""
        k = self.intrinsic
        pixels: np.ndarray = np.asarray(points_m) @ k[:2, :2].T + k[:2, 2]
        return pixels

    def to_metres(self, pixels: np.ndarray) -> np.ndarray:
        """Convert columns and rows (..., 2) to metres on the panel (..., 2)."""
        k = self.intrinsic
        points: np.ndarray = (np.asarray(pixels) - k[:2, 2]) @ np.linalg.inv(k[:2, :2]).T
        return points

    def binned(self, factor: int) -> Detector:
        """Return the panel read with factor x factor pixels as one.

        Raises
        ------
        ValueError
            The factor does not divide columns and rows.
        """
        if self.columns % factor or self.rows % factor:
            raise ValueError(f"{self.columns} x {self.rows} pixels cannot be read {factor} x {factor} at a time")
        return Detector(self.columns // factor, self.rows // factor, self.pitch_m * factor, self.aspect, self.skew)
