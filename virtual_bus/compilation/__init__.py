"""Compilation of the plant and its effects: numba's options, generated modules on disk, keys of caches."""
