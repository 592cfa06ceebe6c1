"""Calibration by a marker plate on the tube (thesis Chapter 6): tube to panel, scans, the focal spot."""
