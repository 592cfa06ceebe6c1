"""Model-based calibration (thesis Sec. 2.3): Denavit-Hartenberg parameters and flexible joints identified from measured poses."""
