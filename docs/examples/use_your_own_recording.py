"""Bring a recording of another system, here a pandas frame with its own names and units, beside a simulation."""

import numpy as np
import pandas as pd

import hil

turntable = hil.open_machine("turntable")

# what another system left: time in ms, angles in degrees, its own names
measured = turntable.run(hil.JogOnly(jog=hil.Jog(line=1), period_s=8.0, periods=1), bus="lockstep:")
log = pd.DataFrame(
    {
        "t_ms": 1e3 * measured.time,
        "setpoint": np.degrees(measured["reference_turn"]),
        "angle": np.degrees(measured["position_turn"]),
        "motor_current": 1e3 * measured["current_turn"],
    }
)

names = {"t_ms": "time", "setpoint": "reference_turn", "angle": "position_turn", "motor_current": "current_turn"}
units = {"time": "ms", "reference_turn": "deg", "position_turn": "deg", "current_turn": "mA"}
recording = hil.recording_from_frame(log.rename(columns=names), turntable, units)
hil.write_recording(recording, "own.mf4")  # opens in asammdf and vendors' tools

print(hil.compare(recording, hil.simulate(turntable, recording)).table())
