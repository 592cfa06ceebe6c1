"""What the tests on vcan0 need computed: done on the host, where it takes a fraction of the time it takes in a user-mode kernel."""

from __future__ import annotations

import contextlib
import io
import threading
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.cli import main
from hil.experiments import Static
from hil.machine import load_machine
from hil.observing import design_observer, observe, write_design
from hil.observing.simulated_recordings import emulated_recording, emulated_responses

DESIGN, SHAPER, RATE, READY = "carm.observer.npz", "roll.shaper.npz", "rate", "ready"
LOOK_S = 0.5


def compile_first(folder: Path) -> None:
    """Run once in lockstep: what is compiled is then found by the processes inside, for whom compiling takes several times as long."""
    run = ["run", "static", "--seconds", "0.1", "--machine", "carm", "--bus", "lockstep:", "-o", str(folder / "compiled.mf4")]
    assert isocenter(run)[0] == 0


def convert(folder: Path) -> None:
    """The C-arm at 128 Hz, and what `machine convert` says of its margins."""
    status, said = isocenter(["machine", "convert", "carm", "--rate", "128", "-o", str(folder / "carm_128.toml")])
    assert status in (0, 1)
    (folder / "converted.txt").write_text(said)


def isocenter(words: list[str]) -> tuple[int, str]:
    """Run a command in this process, where what other tests compile is at hand: its status, and what it prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), pytest.raises(SystemExit) as left:
        main(words)
    assert isinstance(left.value.code, int)
    return left.value.code, printed.getvalue()


def prepare_when_asked(folder: Path, shaped: bool, stop: threading.Event) -> None:
    """Prepare for the rate that the tests inside find to be carried, while they go on; `READY` says that it is done, or why not."""
    while not (folder / RATE).exists():
        if stop.wait(LOOK_S):
            return
    said = ""
    try:
        prepare(folder, "carm" if (folder / RATE).read_text() == "256" else str(folder / "carm_128.toml"), shaped)
    except Exception as error:
        said = repr(error)
        raise
    finally:
        (folder / READY).with_suffix(".part").write_text(said)
        (folder / READY).with_suffix(".part").rename(folder / READY)


def prepare(folder: Path, machine_name: str, shaped: bool) -> None:
    """An observer of a machine about roll 30 degrees, identified on the emulated machine, and a shaper of its roll axis if wanted.

    The observer is not tuned, which takes longer than all else; it runs once, so that it need not be compiled again.
    """
    machine, pose = load_machine(machine_name), {"roll": np.radians(30.0)}
    still = emulated_recording(machine, Static(2.0, pose).plans(machine)[0], 1)
    design = design_observer(machine, emulated_responses(machine, [pose]), [still], modes=3)
    observe(still, design.observer())
    write_design(design, folder / DESIGN)
    if shaped:
        hil.write_shaper(hil.shape(machine, "roll").file, folder / SHAPER)
