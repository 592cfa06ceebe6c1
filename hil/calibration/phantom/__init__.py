"""Phantom calibration (thesis Sec. 2.2.2): every exposure's geometry from images of a phantom."""
