"""Frames of an X-ray panel as they come: a spool folder or a network line, and the panel's clock against the loop's."""

from drivers.imaging.clock import ClocksDisagreeError, PanelClock
from drivers.imaging.panel_link import PanelError, PanelLink
from drivers.imaging.spool import Frame, FrameSpool, SpoolError, write_frame

__all__ = ["ClocksDisagreeError", "Frame", "FrameSpool", "PanelClock", "PanelError", "PanelLink", "SpoolError", "write_frame"]
