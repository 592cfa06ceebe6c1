"""Recordings beside their simulation, in units of the noise of repeats: what is left, and whether that is above noise for certain."""
