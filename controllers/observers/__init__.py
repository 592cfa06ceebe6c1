"""Observers: where the detector really is, once per sample."""
