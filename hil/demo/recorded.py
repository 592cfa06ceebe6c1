"""The demo's machine, its recordings, and the blind answer to them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.demo.hidden import Envelope
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.retuning.numbers import TUNED
from hil.diagnosis.verdict.values import Outcome
from hil.errors import UnusableInputError
from hil.experiments import Tour
from hil.machine import Machine, load_machine
from hil.machine.load import text_of
from hil.recording import read_recording
from hil.terminal.progress import Bars, follower
from virtual_bus.plant.parameters import possible_parameters

MACHINE = "carm"
TOLERANCE = 0.01
"""Of the machine file's numbers, as after an identification; with its default of 15 % they would take most of what is hidden."""
REPEATS = 3
"""The noise is what repeats differ by; with three, one that differs stands out."""

RECORDINGS = (*(f"tour_{number}.mf4" for number in range(1, REPEATS + 1)), "held_out.mf4")


def _stops(*poses_deg: tuple[float, float]) -> tuple[dict[str, float], ...]:
    return tuple({"propeller": float(np.radians(propeller)), "roll": float(np.radians(roll))} for propeller, roll in poses_deg)


TOUR = Tour(_stops((0, 0), (45, 35), (-35, -40), (0, 0)), pace=0.8, dwell_s=0.1)
"""Both axes at once, far, fast and through standstill both ways: gravity, friction, springs and inertia all change."""
HELD_OUT = Tour(_stops((10, -10), (-35, 30), (25, -25)), pace=0.6, dwell_s=0.3)
"""Another way, on which the answer is judged."""


def demo_machine(out: Path) -> Machine:
    """Write the demo's machine file, the shipped one with tolerances, into a folder and load it.

    Raises
    ------
    UnusableInputError
        The folder cannot be written to.
    """
    path = out / "machine.toml"
    lines = ["", f"# Added for the demo: every number is known to {TOLERANCE:.0%}."]
    known: dict[str, list[str]] = {}
    for parameter in possible_parameters(load_machine(MACHINE).plant):
        if parameter.value != 0.0 and parameter.quantity.startswith(TUNED):
            known.setdefault(parameter.owner, []).append(f"{parameter.name.partition('.')[2]} = {TOLERANCE * abs(parameter.value):.6g}")
    for owner, numbers in known.items():
        lines += ["", f"[tolerances.{owner}]", *numbers]
    try:
        out.mkdir(parents=True, exist_ok=True)
        path.write_text(text_of(MACHINE) + "\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(f"{path}: cannot be written: {error.strerror}") from None
    return load_machine(path)


def recorded(machine: Machine, envelope: Envelope, out: Path, bars: Bars) -> tuple[list[Path], float]:
    """Record the tour, again and again, and the held-out one, on an emulated machine with what the envelope hides.

    Each run is a session of its own, with noise of its own: what goes by the clock, such as a shaking base, repeats.
    """
    experiments = [TOUR] * REPEATS + [HELD_OUT]
    plans = [(experiment.plans(machine)[0], out / name) for experiment, name in zip(experiments, RECORDINGS, strict=True)]
    total = sum(plan.rows for plan, _ in plans)
    secret = machine.with_effects(envelope.effects)
    task, done = bars.add_task("recording", total=total), 0
    for number, (plan, path) in enumerate(plans):
        options = BenchOptions("lockstep:", seed=len(plans) * (envelope.seed or 0) + number, emulated=secret)
        with open_bench(machine, options, plan.start_pose) as bench:
            bench.run(plan, path, follower(bars, task, done))
        done += plan.rows
        bars.update(task, completed=done)
    return [path for _, path in plans], total / machine.sample_rate_Hz


def answered_by(machine: Machine, paths: list[Path], bars: Bars) -> Outcome:
    """Diagnose what was recorded, from the files alone."""
    *train, held = ({path.stem: read_recording(path)} for path in paths)
    task = bars.add_task("diagnosing", total=None)  # nobody counts beforehand what a search takes

    def report(what: str, share: float) -> None:
        bars.update(task, description=what)

    answered = diagnose(machine, {name: one for each in train for name, one in each.items()}, held, report=report, freely=True)
    bars.update(task, description="diagnosed")
    return answered
