"""Frames of an X-ray panel as they come: a spool folder, and the panel's clock against the loop's."""

from drivers.imaging.clock import ClocksDisagree, PanelClock
from drivers.imaging.spool import Frame, FrameSpool, SpoolError, write_frame

__all__ = ["ClocksDisagree", "Frame", "FrameSpool", "PanelClock", "SpoolError", "write_frame"]
