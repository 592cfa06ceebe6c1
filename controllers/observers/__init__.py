"""Observers, which estimate the pose of the detector once per sample."""
