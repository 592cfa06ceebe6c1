"""Imaging: the geometry of an exposure, its exchange formats, and measurements in images."""

from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam

__all__ = ["ConeBeam", "Detector"]
