"""The demo, step by step."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.open import open_bench, recording_paths
from hil.bench.options import BenchOptions
from hil.demo.page import write_demo_page
from hil.demo.told import Story
from hil.experiments import Jog, Multisine
from hil.identification import identify, resonances, write_frf
from hil.machine import Machine, load_machine
from hil.recording import read_recording, write_recording
from hil.simulation import compare, simulate
from hil.simulation.linear import sampled_response
from hil.terminal.output import Answer
from hil.terminal.progress import follower, progress
from virtual_bus.settings import EffectSetting

SECRET_FRICTION = EffectSetting("coulomb_friction", "roll", {"Fc": 12.0})
"""What the emulated machine has and its file does not say: 12 Nm, 0.6 A at the roll motor."""

EXPERIMENT = Multisine(
    pose={"roll": np.radians(30.0)}, amplitude_A=0.8, periods=2, settle_periods=1, realisations=3, jog=Jog(line=1), seed=20
)
"""Two experiments of three realisations, 20 s periods: the least that splits noise, nonlinear distortion and both inputs."""


def run_demo(out: Path, answer: Answer) -> dict[str, Any]:
    """Run the demo into the folder `out`; return the JSON document."""
    began = time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    machine = load_machine("carm")
    answer.say(f"{machine.name}: {machine.description}")
    paths, recorded_s, running_s = _record(machine, out, answer)
    recordings = [read_recording(path) for path in paths]
    answer.say(f"recorded {recorded_s:.0f} s of machine time over the CANopen stack at {recorded_s / running_s:.0f} times real time")

    response = identify(recordings, "robust_bla")
    write_frf(response, out / "carm.frf.npz")
    n_y, n_u = response.G.shape[1:]
    answer.say(f"identified a {n_y} x {n_u} frequency response at {len(response.lines)} lines, noise and nonlinear variance apart")

    nominal = simulate(machine, recordings[0])
    friction = simulate(machine, recordings[0], [SECRET_FRICTION])
    write_recording(nominal, out / "simulated_nominal.mf4")
    write_recording(friction, out / "simulated_with_friction.mf4")
    story = Story(
        machine,
        tuple(paths),
        recordings[0],
        response,
        resonances(response),
        sampled_response(machine, np.array(response.pose), response.frequencies_Hz, response.output_names),
        nominal,
        friction,
        compare(recordings[0], nominal),
        compare(recordings[0], friction),
        SECRET_FRICTION,
        recorded_s,
        recorded_s / running_s,
    )
    before, after = (comparison["current_roll"].nrmse for comparison in (story.nominal_comparison, story.friction_comparison))
    answer.say(f"current_roll: simulation off by {before:.1%} (NRMSE) without the friction, {after:.1%} with it")
    page = write_demo_page(story, out)
    seconds = time.perf_counter() - began
    answer.say(f"{page}: the page, after {seconds:.1f} s")
    return {
        "page": page,
        "seconds": seconds,
        "lockstep_times_real_time": recorded_s / running_s,
        "recordings": paths,
        "frf": out / "carm.frf.npz",
        "lines": len(response.lines),
        "nominal": story.nominal_comparison.document(),
        "with_friction": story.friction_comparison.document(),
    }


def _record(machine: Machine, out: Path, answer: Answer) -> tuple[list[Path], float, float]:
    """Run every plan on the emulated machine with the secret friction; return paths, machine time and the time it took."""
    plans = EXPERIMENT.plans(machine)
    paths = recording_paths(out / "carm.mf4", plans)
    for path in paths:
        path.unlink(missing_ok=True)
    recorded_s = running_s = 0.0
    secret = machine.with_effects((SECRET_FRICTION,))
    with open_bench(machine, BenchOptions("lockstep:", seed=1, emulated=secret), plans[0].start_pose) as bench:
        with progress() as bars:
            task = bars.add_task("multisine with jog", total=sum(plan.rows for plan in plans))
            done = 0
            for plan, path in zip(plans, paths, strict=True):
                start = time.perf_counter()
                bench.run(plan, path, follower(bars, task, done))
                running_s += time.perf_counter() - start
                recorded_s += plan.rows / machine.sample_rate_Hz
                done += plan.rows
                bars.update(task, completed=done)
        for line in bench.commissioning:
            answer.say(f"  {line}")
    return paths, recorded_s, running_s
