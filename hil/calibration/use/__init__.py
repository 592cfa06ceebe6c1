"""A calibration in use: look-up tables, the reconstruction volume, overlay errors, image compensation."""
