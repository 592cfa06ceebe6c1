"""Data-driven calibration (thesis Chapter 5): geometric parameters as states of a filter, offline or during a run."""
