"""The true motion of tube and panel between the samples of the emulated machine, and of the focal spot on the tube."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from virtual_bus.xray.render import View


@dataclass(frozen=True)
class FocalSpot:
    """Motion of the focal spot on the tube, in the tube's frame.

    Attributes
    ----------
    heating_m : (3,) array
        How far it has drifted when the anode is hot.
    heating_s : float
        Time constant of the drift; it begins with the first exposure.
    wobble_m : (3,) array
        Amplitude of the motion with the anode's rotation.
    anode_Hz : float
    """

    heating_m: np.ndarray
    heating_s: float
    wobble_m: np.ndarray
    anode_Hz: float

    def offset_m(self, time_s: np.ndarray, hot_since_s: float) -> np.ndarray:
        """Return the spot's offset (..., 3) at times (...)."""
        warm = 1.0 - np.exp(-np.maximum(np.asarray(time_s) - hot_since_s, 0.0) / self.heating_s)
        turned = np.sin(2.0 * np.pi * self.anode_Hz * np.asarray(time_s))
        offset: np.ndarray = warm[..., None] * self.heating_m + turned[..., None] * self.wobble_m
        return offset


STILL = FocalSpot(np.zeros(3), 1.0, np.zeros(3), 1.0)
"""A focal spot that stays."""


class PoseTrack:
    """Pose of a body between samples: cubic splines of position and rotation through every sample.

    Parameters
    ----------
    time_s : (N,) array
        Rising.
    position_m : (N, 3) array
    rotation : (N, 3, 3) array
    """

    def __init__(self, time_s: np.ndarray, position_m: np.ndarray, rotation: np.ndarray) -> None:
        self.first_s, self.last_s = float(time_s[0]), float(time_s[-1])
        self._position = CubicSpline(time_s, position_m)
        self._rotation = RotationSpline(time_s, Rotation.from_matrix(rotation))

    def __call__(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return position (n, 3) and rotation (n, 3, 3) at times (n,)."""
        return self._position(time_s), self._rotation(time_s).as_matrix()


@dataclass(frozen=True)
class XraySide:
    """Tube and panel of an emulated machine.

    Attributes
    ----------
    tube, panel : PoseTrack
        Frames of the bodies that carry them, in the world.
    source_m : (3,) array
        The cold focal spot in the tube's frame.
    center_m : (3,) array
        The panel's centre in its body's frame.
    spot : FocalSpot
    hot_since_s : float
        Start of the first exposure.
    """

    tube: PoseTrack
    panel: PoseTrack
    source_m: np.ndarray
    center_m: np.ndarray
    spot: FocalSpot
    hot_since_s: float

    def views(self, start_s: float, width_s: float, count: int) -> list[View]:
        """Return views evenly spread over an exposure; one in its middle if `count` is 1."""
        times = start_s + width_s * (np.arange(count) + 0.5) / count
        tube_position, tube_rotation = self.tube(times)
        panel_position, panel_rotation = self.panel(times)
        on_tube = self.source_m + self.spot.offset_m(times, self.hot_since_s)
        source = tube_position + (tube_rotation @ on_tube[..., None])[..., 0]
        return [View(s, p + r @ self.center_m, r) for s, p, r in zip(source, panel_position, panel_rotation, strict=True)]
