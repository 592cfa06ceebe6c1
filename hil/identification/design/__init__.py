"""Excitation designed from a first measurement (thesis Sec. 3.3)."""
