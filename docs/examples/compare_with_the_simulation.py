"""Hold a recording against the simulation of its machine file, with and without a friction that the machine has besides."""

import numpy as np

import hil

turntable = hil.open_machine("turntable")
stiff = turntable.with_effect("viscous_friction", at="turn", Fv_Nm_s_rad=8.0)

# the emulated machine has the friction, the loop knows only the file
jog = hil.JogOnly(jog=hil.Jog(np.radians(3.0), line=1), period_s=8.0, periods=1)
recorded = turntable.run(jog, bus="lockstep:", emulated=stiff)

by_file = hil.compare(recorded, hil.simulate(turntable, recorded))
with_friction = hil.compare(recorded, hil.simulate(stiff, recorded))
print(by_file.frame()[["unit", "rms", "nrmse"]])
print(f"command: off by {by_file['command_turn'].nrmse:.1%} without the friction, by {with_friction['command_turn'].nrmse:.1%} with it")

hil.plot(recorded, hil.simulate(turntable, recorded)).savefig("compared.png")
