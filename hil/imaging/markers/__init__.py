"""Marker plates in X-ray images (thesis Chapter 6): drawings, projection, detection of their lines and points."""

from hil.imaging.markers.detect import MarkerPoints, find_marker
from hil.imaging.markers.plates import PLATES, MarkerPlate, clinical_plate, experimental_plate
from hil.imaging.markers.projection import MarkerProjection

__all__ = ["PLATES", "MarkerPlate", "MarkerPoints", "MarkerProjection", "clinical_plate", "experimental_plate", "find_marker"]
