"""Local models over scheduling parameters: nD-LPM and nD-LRM (thesis Chapter 4)."""
