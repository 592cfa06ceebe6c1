"""How long a diagnosis takes: four repeats and a held-out recording of 60 s, whole catalogue, the C-arm by default. Prints JSON.

python benchmarks/diagnosis_speed.py [--machine carm] [--seconds 60] [--jobs 2] [--without-search] [--every 2]

Run it twice: the first run compiles the plant. The recordings come from the simulator with friction added at the last axis and noise of its
own per repeat: the work hardly depends on what is in them. `--every 2` lets the diagnosis know every second effect of the catalogue.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does: --jobs are processes, and threads of small products only wait
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.starting import candidates
from hil.machine import load_machine
from hil.processes.kept_memory import keep_memory
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import simulate
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

REPEATS = 4
FRICTION, FRICTION_Nm = "coulomb_friction", 8.0


def driven(machine, seconds: float, seed: int) -> Recording:
    """Slow sines of both axes and a multisine on top."""
    random = np.random.default_rng(seed)
    time_s = np.arange(round(seconds * machine.sample_rate_Hz)) / machine.sample_rate_Hz
    gate = 0.5 - 0.5 * np.cos(np.pi * np.clip(time_s, 0.0, 1.0))
    channels = {"time": Channel("s", time_s)}
    for axis, units in zip(machine.axes, machine.units, strict=True):
        slow = sum(0.04 * np.sin(2.0 * np.pi * f * time_s + random.uniform(0.0, 6.0)) for f in random.uniform(0.05, 0.5, 4))
        fast = sum(0.05 * np.sin(2.0 * np.pi * f * time_s + random.uniform(0.0, 6.0)) for f in random.uniform(1.0, 25.0, 20))
        channels[f"reference_{axis}"] = Channel(units.position, gate * slow)
        channels[f"excitation_{axis}"] = Channel(units.effort, gate * fast)
    return Recording(channels, recording_metadata(machine, experiment={"start_pose": [0.0] * len(machine.axes)}))


def noisy(machine, inputs: Recording, clean: Recording, seed: int) -> Recording:
    """One repeat: coloured noise of 1 % of every channel's motion."""
    random = np.random.default_rng(seed)
    channels = dict(inputs.channels)
    for name in clean.channels:
        if name not in channels:
            values = clean[name]
            slow = np.cumsum(random.standard_normal(len(values))) * 1e-3
            channels[name] = Channel(clean.channel(name).unit, values + 0.01 * values.std() * (slow + random.standard_normal(len(values))))
    return Recording(channels, inputs.metadata)


def know_every(nth: int) -> int:
    """Let the diagnosis try every nth effect alone, the hidden one among them; how many that are."""
    hidden, names = list(effects()).index(FRICTION), list(effects())
    known = {name for number, name in enumerate(names) if (number - hidden) % nth == 0}
    all_places = candidates.places_to_try
    candidates.places_to_try = lambda *given: [place for place in all_places(*given) if place.effect in known]
    return len(known)


def main() -> None:
    """Print seconds and peak memory."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="carm", help="a machine with controllers: a file, or the name of a shipped one")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--without-search", action="store_true", help="leave out the search for the next experiment")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="know every Nth effect of the catalogue alone")
    arguments = parser.parse_args()
    if arguments.every < 1:
        parser.error(f"--every {arguments.every}: one or more")
    machine = load_machine(arguments.machine)
    known = know_every(arguments.every)
    friction = EffectSetting(FRICTION, machine.axes[-1], {"Fc": FRICTION_Nm})
    sets = []
    for experiment, count in ((0, REPEATS), (1, 1)):
        inputs = driven(machine, arguments.seconds, experiment)
        clean = simulate(machine, inputs, [friction])
        sets.append({f"run_{experiment}_{n}": noisy(machine, inputs, clean, 10 * experiment + n) for n in range(count)})
    keep_memory()  # as the command does
    wall, processor = time.monotonic(), time.process_time()
    outcome = diagnose(machine, *sets, jobs=arguments.jobs, look_further=not arguments.without_search)
    wall = time.monotonic() - wall
    own = resource.getrusage(resource.RUSAGE_SELF)
    workers = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        json.dumps(
            {
                "machine": machine.name,
                "effects": known,
                "recording_s": arguments.seconds,
                "jobs": arguments.jobs,
                "search": not arguments.without_search,
                "wall_s": round(wall, 1),
                "processor_s": round(time.process_time() - processor + workers.ru_utime + workers.ru_stime, 1),
                "peak_GB": round((own.ru_maxrss + arguments.jobs * workers.ru_maxrss) / 1e6, 2),
                "verdict": outcome.diagnosis.verdict,
                "findings": [str(finding.effect) for finding in outcome.diagnosis.findings],
            }
        )
    )


if __name__ == "__main__":
    main()
