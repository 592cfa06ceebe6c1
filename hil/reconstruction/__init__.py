"""Reconstruction from projections, and its quality as a test of the geometry used."""
