"""Commission a machine in one go: check, home, record, identify, shape, scan, and hold the simulation against it."""

import hil

turntable = hil.open_machine("turntable")
found = hil.commission(turntable, bus="lockstep:", out="commissioned")
for step in found.steps:
    print("ok  " if step.ok else "FAIL", step.name, *step.said, sep="  ")

assert found.comparison is not None  # it came so far
print(found.comparison.table())
frf = hil.read_frf(found.folder / "turntable.frf.npz")
print(f"{len(frf.lines)} lines identified; the folder holds every recording")
