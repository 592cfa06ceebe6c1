"""Geometric calibration: the nine parameters of every exposure, from phantom images, a model, recordings or markers."""
