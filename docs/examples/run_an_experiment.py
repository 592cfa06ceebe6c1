"""Run an experiment on the emulated machine and look at what it recorded."""

import numpy as np

import hil

turntable = hil.open_machine("turntable")

# 10 s of standstill, then a slow sine of 2 degrees; on "lockstep:" machine and loop share this process and virtual time
still = turntable.run(hil.Static(seconds=10.0), bus="lockstep:")
jog = turntable.run(hil.JogOnly(jog=hil.Jog(np.radians(2.0), line=1), period_s=8.0, periods=1), bus="lockstep:", out="jog.mf4")

noise_rad = still["position_turn"].std()
error_rad = np.abs(jog["reference_turn"] - jog["position_turn"]).max()
print(f"{still.rows} rows at {still.sample_rate_Hz:g} Hz; encoder noise {1e6 * noise_rad:.1f} µrad")
print(f"largest tracking error of the jog {1e3 * error_rad:.2f} mrad")

frame = jog.frame()  # a pandas.DataFrame over time [s]
print(frame[["reference_turn", "position_turn", "current_turn"]].describe())
print(frame.attrs["units"]["current_turn"])
