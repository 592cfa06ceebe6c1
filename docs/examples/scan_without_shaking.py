"""Design a reference shaper for a scan and see what it saves."""

import numpy as np
from scipy import signal

import hil

carm = hil.open_machine("carm")
shaper = hil.shape(carm, "propeller")
print(shaper.frame()[["vibration", "vibration_at_10", "transient_s", "gain_sum"]])
print(f"recommended: {shaper.chosen.name}; gain for a constant reference {shaper.control.dcgain():.6f}")

scan = hil.Scan("propeller", np.radians(-30.0), np.radians(30.0))
plain = carm.run(scan, bus="lockstep:", noise=False)  # without the sensors' noise, to see the ringing alone
shaped = carm.run(scan, bus="lockstep:", noise=False, shaper=shaper)


def ringing(recording: hil.Recording) -> float:
    """Return the rms acceleration [m/s^2] across the detector, 4 to 20 Hz, in the second after the reference has come to rest."""
    band = signal.butter(2, (4.0, 20.0), "bandpass", fs=recording.sample_rate_Hz, output="sos")
    moves = np.flatnonzero(np.diff(recording["reference_propeller"]))
    rest = signal.sosfiltfilt(band, recording["imu_y"])[moves[-1] + 1 :][: round(recording.sample_rate_Hz)]
    return float(np.std(rest))


before, after = ringing(plain), ringing(shaped)
print(f"after the sweep the detector rings by {1e3 * before:.1f} mm/s² without the shaper, by {1e3 * after:.1f} mm/s² with it")
hil.write_shaper(shaper.file, "propeller.shaper.npz")  # for `isocenter run scan --shaper`
