"""Reconstruction from projections, and what it says of the geometry it was made with."""
