"""What the tests on vcan0 need computed: done on the host, where it takes a fraction of the time it takes in a user-mode kernel."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np

from hil.experiments import Static
from hil.machine import load_machine
from hil.observing import design_observer, observe, write_design
from hil.observing.simulated_recordings import emulated_recording, emulated_responses

ISOCENTER = [sys.executable, "-m", "hil"]
DESIGN, SHAPER, RATE, READY = "carm.observer.npz", "roll.shaper.npz", "rate", "ready"
LOOK_S = 0.5


def convert(folder: Path) -> None:
    """The C-arm at 128 Hz, and what `machine convert` says of its margins."""
    converting = [*ISOCENTER, "machine", "convert", "carm", "--rate", "128", "-o", str(folder / "carm_128.toml")]
    done = subprocess.run(converting, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    (folder / "converted.txt").write_text(done.stdout)


def prepare_when_asked(folder: Path, stop: threading.Event) -> None:
    """Prepare for the rate that the tests inside find to be carried, while they go on; `READY` says that it is done, or why not."""
    while not (folder / RATE).exists():
        if stop.wait(LOOK_S):
            return
    said = ""
    try:
        prepare(folder, "carm" if (folder / RATE).read_text() == "256" else str(folder / "carm_128.toml"))
    except Exception as error:
        said = repr(error)
        raise
    finally:
        (folder / READY).with_suffix(".part").write_text(said)
        (folder / READY).with_suffix(".part").rename(folder / READY)


def prepare(folder: Path, machine_name: str) -> None:
    """An observer of a machine about roll 30 degrees, identified on the emulated machine, and a shaper of its roll axis.

    The observer is not tuned, which takes longer than all else; it runs once, so that it need not be compiled again.
    """
    machine, pose = load_machine(machine_name), {"roll": np.radians(30.0)}
    still = emulated_recording(machine, Static(2.0, pose).plans(machine)[0], 1)
    design = design_observer(machine, emulated_responses(machine, [pose]), [still], modes=3)
    observe(still, design.observer())
    write_design(design, folder / DESIGN)
    shaping = [*ISOCENTER, "shape", machine_name, "--axis", "roll", "-o", str(folder / SHAPER)]
    subprocess.run(shaping, capture_output=True, check=True)
