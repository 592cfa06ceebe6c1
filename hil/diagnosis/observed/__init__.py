"""Recordings on even rows, as the equations take them, and whether they can be used."""
