"""The shipped machine at rest: as it is run in lockstep outside, and over vcan0 inside."""

SHIPPED = "carm"
AT_REST = ("static", "--seconds", "1", "--seed", "3")
FRAMES = "frames.log"
"""The frames of the run in lockstep, in the folder of `prepared.py`."""
