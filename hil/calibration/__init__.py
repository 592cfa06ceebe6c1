"""Geometric calibration: what the nine parameters of every exposure are, from phantom images, a model, recordings or markers."""
