"""What the tests on vcan0 need computed: done on the host, where it takes a fraction of the time it takes in a user-mode kernel."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from hil.experiments import Static
from hil.machine import load_machine
from hil.observing import design_observer, observe, write_design
from hil.observing.simulated_recordings import emulated_recording, emulated_responses

DESIGN, SHAPER = "carm.observer.npz", "roll.shaper.npz"


def prepare(folder: Path) -> None:
    """An observer of carm about roll 30 degrees, identified on the emulated machine, and a shaper of its roll axis.

    The observer is not tuned, which takes longer than all else; it runs once, so that it need not be compiled again.
    """
    machine, pose = load_machine("carm"), {"roll": np.radians(30.0)}
    still = emulated_recording(machine, Static(2.0, pose).plans(machine)[0], 1)
    design = design_observer(machine, emulated_responses(machine, [pose]), [still], modes=3)
    observe(still, design.observer())
    write_design(design, folder / DESIGN)
    shaping = [sys.executable, "-m", "hil", "shape", "carm", "--axis", "roll", "-o", str(folder / SHAPER)]
    subprocess.run(shaping, capture_output=True, check=True)
