"""What the tests on vcan0 need computed: done on the host, where it takes a fraction of the time it takes in a user-mode kernel."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np
import pytest
from at_rest import AT_REST, FRAMES, SHIPPED

import hil
from hil.cli import main
from hil.experiments import Static
from hil.machine import load_machine
from hil.observing import design_observer, observe, write_design
from hil.observing.simulated_recordings import emulated_recording, emulated_responses

DESIGN, SHAPER, READY = "carm.observer.npz", "roll.shaper.npz", "ready"


def run_in_lockstep(folder: Path) -> None:
    """Keep the frames of a second at rest.

    What is compiled for it is then found by the processes inside, for whom compiling takes several times as long.
    """
    run = ["run", *AT_REST, "-m", SHIPPED, "-b", "lockstep:", "--frame-log", str(folder / FRAMES), "-o", str(folder / "lockstep.mf4")]
    with contextlib.redirect_stdout(io.StringIO()), pytest.raises(SystemExit) as left:
        main(run)
    assert left.value.code == 0


def prepare_beside(folder: Path) -> None:
    """Prepare while the tests inside go on; `READY` says that it is done, or why not."""
    said = ""
    try:
        prepare(folder)
    except Exception as error:
        said = repr(error)
        raise
    finally:
        (folder / READY).with_suffix(".part").write_text(said)
        (folder / READY).with_suffix(".part").rename(folder / READY)  # whole or not there, for who looks for it inside


def prepare(folder: Path) -> None:
    """An observer of the C-arm about roll 30 degrees, identified on the emulated machine, and a shaper of its roll axis.

    The observer is not tuned, which takes longer than all else; it runs once, so that it need not be compiled again.
    """
    machine, pose = load_machine(SHIPPED), {"roll": np.radians(30.0)}
    still = emulated_recording(machine, Static(2.0, pose).plans(machine)[0], 1)
    design = design_observer(machine, emulated_responses(machine, [pose]), [still], modes=3)
    observe(still, design.observer())
    write_design(design, folder / DESIGN)
    hil.write_shaper(hil.shape(machine, "roll").file, folder / SHAPER)
