"""Figures: drawing apart from computing; every function returns a matplotlib Figure."""
