"""How long 60 s of the C-arm in closed loop at 1 kHz with friction take.

    python benchmarks/closed_loop.py --json -

The controllers are the shipped design, discretised at 1 kHz. Best of several runs after one that compiles.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from controllers.loop_shaping import cascade, gain, lag, lead, notch
from hil.machine import Machine, load_machine, machine_from_text
from hil.simulation import Inputs, Simulator
from virtual_bus.settings import EffectSetting

RATE_Hz = 1000.0
SECONDS = 60.0
RUNS = 15


def fast_carm() -> Machine:
    """The shipped C-arm at 1 kHz, one plant step a sample, with its controllers' design repeated at that rate."""
    text = load_machine("carm").text
    for old, new in (("sample_rate_Hz = 256.0", f"sample_rate_Hz = {RATE_Hz}"), ("substeps = 4", "substeps = 1"), ("= 0.0025", "= 0.0005")):
        assert old in text, f"{old}: no longer in the shipped file"
        text = text.replace(old, new, 1)
    machine = machine_from_text(text)
    designs = (
        cascade(gain(1140.0), lag(0.0, 0.1, RATE_Hz), lead(3.7, 76.0, RATE_Hz), notch(9.0, 0.375, 0.8, RATE_Hz)),
        cascade(gain(820.0), lag(0.0, 0.12, RATE_Hz), lead(2.2, 70.0, RATE_Hz), notch(22.0, 0.2, 1.0, RATE_Hz)),
    )
    pairs = zip(machine.controllers, designs, strict=True)
    return replace(machine, controllers=tuple(replace(each, position_sections=sections) for each, sections in pairs))


def inputs(machine: Machine) -> Inputs:
    """A jog on both axes and a band of lines, at roll 20 deg."""
    rows = round(SECONDS * RATE_Hz)
    time_s = np.arange(rows) / RATE_Hz
    phases = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, (2, 400))
    lines = np.arange(3, 803, 2) * 0.05
    excitation = np.zeros((rows, 2))
    for axis in range(2):
        for line, phase in zip(lines, phases[axis], strict=True):
            excitation[:, axis] += 0.05 * np.cos(2.0 * np.pi * line * time_s + phase)
    pose = np.radians([0.0, 20.0])
    reference = pose + np.outer(np.sin(2.0 * np.pi * 0.05 * time_s), np.radians([2.0, 2.0]))
    return Inputs(reference, excitation, np.zeros((rows, 2)), None, pose)


def timed(simulator: Simulator, given: Inputs, effects: tuple[EffectSetting, ...]) -> dict[str, float]:
    """Wall and processor time of one run, best of several [s]."""
    simulator.run(given, effects=effects)
    wall, processor = [], []
    for _ in range(RUNS):
        started, cpu_started = time.perf_counter(), time.process_time()
        simulator.run(given, effects=effects)
        wall.append(time.perf_counter() - started)
        processor.append(time.process_time() - cpu_started)
    return {"wall_s": min(wall), "wall_median_s": float(np.median(wall)), "processor_s": min(processor)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    target = parser.parse_args().json
    machine = fast_carm()
    simulator = Simulator(machine)
    given = inputs(machine)
    friction = tuple(EffectSetting("coulomb_friction", axis, {"Fc": 12.0}) for axis in machine.axes)
    answer = {
        "machine": machine.name,
        "degrees_of_freedom": len(machine.plant.tree.joints),
        "seconds_simulated": SECONDS,
        "rate_Hz": RATE_Hz,
        "with_coulomb_friction": timed(simulator, given, friction),
        "without_friction": timed(simulator, given, ()),
    }
    text = json.dumps(answer, indent=2) + "\n"
    if target == "-":
        sys.stdout.write(text)
    else:
        Path(target).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
