"""Design an observer from measurements of the machine and see where the detector really was during a scan."""

import numpy as np

import hil

carm = hil.open_machine("carm")
lockstep = "lockstep:"

# what a design is made from: responses, standstill, and ordinary operation to tune on
multisine = carm.run(hil.Multisine(period_s=8.0, periods=2, realisations=1, jog=hil.Jog(line=1)), bus=lockstep)
still = carm.run(hil.Static(3.0), bus=lockstep)
scan = carm.run(hil.Scan("propeller", np.radians(-12.0), np.radians(12.0), dwell_s=0.5), bus=lockstep)
design = hil.design_observer(carm, multisines=multisine, standing=still, tuned_on=scan)
print(*design.notes, sep="\n")

estimate = hil.observe(carm, scan, design)
shift_mm = 1e3 * estimate.frame()[["estimate_detector_x", "estimate_detector_y", "estimate_detector_z"]]
print(shift_mm.describe().loc[["min", "max"]])
hil.write_estimate(estimate, "scan.est.npz")
hil.plot(estimate).savefig("estimate.png")
