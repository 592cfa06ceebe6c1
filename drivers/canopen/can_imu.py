"""An IMU as a CANopen node: its objects, and what they mean. CiA has no profile of IMUs, so these are a manufacturer's."""

from __future__ import annotations

FORCE, RATE, COUNTER = 0x2100, 0x2101, 0x2102
"""Specific force and angular rate, subindices 1 to 3 for x, y, z, signed 16 bits each; number of the sample, unsigned 16 bits."""

FORCE_STEP_m_s2, RATE_STEP_rad_s = 1e-3, 1e-4
COUNTS = 1 << 16

OBJECTS = [(FORCE, 1), (FORCE, 2), (FORCE, 3), (RATE, 1), (RATE, 2), (RATE, 3)]
"""In the order of an IMU's channels."""
