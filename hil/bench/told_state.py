"""Words between an attended bench and who reads its lines, who needs none of its machinery."""

from __future__ import annotations

STATE, ROWS = "state ", "rows "
"""How the lines of an attended bench begin; an object follows, as JSON."""

WATCHING, HOMING, READY, TAKING_HOLD, HOLDING, LETTING_GO = "watching", "homing", "ready", "opening brakes", "holding", "closing brakes"
"""What it does: nothing, brakes closed; homing; homed, brakes closed; then the way to a jog, the jog, and the way back."""

ON_THE_WAY, SETTLING, RECORDING = "on the way", "coming to rest", "recording"
"""What a run does between taking hold and closing its brakes: goes to the pose where it starts, waits there until it stands, records."""

STOPPING = "stopping"
"""The motors are being stopped; where a brake is not proven, the drive goes on holding."""

AT_REST = (WATCHING, READY)
"""States in which the drives are disabled and the brakes closed, told only while no drive has voltage."""
