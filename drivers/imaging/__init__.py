"""Frames of an X-ray panel from a spool folder or the network, and the panel's clock in loop time."""

from drivers.imaging.clock import ClocksDisagreeError, PanelClock
from drivers.imaging.panel_link import PanelError, PanelLink
from drivers.imaging.spool import Frame, FrameSpool, SpoolError, write_frame

__all__ = ["ClocksDisagreeError", "Frame", "FrameSpool", "PanelClock", "PanelError", "PanelLink", "SpoolError", "write_frame"]
