"""Recordings on equal rows, which of them repeat each other, and what they show by themselves: lost samples, coarse lattices."""
