"""How long a diagnosis takes: four repeats and a held-out recording of 60 s, whole catalogue, the C-arm by default. Prints JSON.

python benchmarks/diagnosis_speed.py [--machine carm] [--seconds 60] [--every 2]

Run it twice: the first run compiles the plant. The recordings come from the simulator with friction added at the last axis and
disturbances of its own per repeat: the work hardly depends on what is in them. `--every 2` lets the diagnosis know every second effect of
the catalogue.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does: threads of small products only wait
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from hil.diagnosis.candidates import entries
from hil.diagnosis.diagnose import diagnose
from hil.machine import load_machine
from hil.processes.kept_memory import keep_memory
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import simulate
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

REPEATS = 4
FRICTION, FRICTION_Nm = "coulomb_friction", 8.0
SINES, SHAKEN_Nm = 8, 0.5


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


def shaken(machine, seed: int) -> list[EffectSetting]:
    """What disturbs one repeat: sines of other frequencies and phases at every axis."""
    random = np.random.default_rng(seed)
    return [
        EffectSetting("base_motion", axis, {"A": SHAKEN_Nm, "f": float(f), "phi": float(random.uniform(-np.pi, np.pi))})
        for axis in machine.axes
        for f in np.exp(random.uniform(np.log(0.2), np.log(20.0), SINES))
    ]


def repeated(machine, inputs: Recording, friction: EffectSetting, seed: int) -> Recording:
    """One repeat: simulated with its own disturbances, and noise of the current's and the IMU's sensors."""
    random = np.random.default_rng(seed)
    simulated = simulate(machine, inputs, [friction, *shaken(machine, seed)])
    channels = dict(simulated.channels)
    rms = {f"current_{sensor.axis}": sensor.noise_rms for sensor in machine.plant.currents}
    rms |= {name: 0.01 for name in ("imu_x", "imu_y", "imu_z")} | {name: 1e-3 for name in ("gyro_x", "gyro_y", "gyro_z")}
    for name, deviation in rms.items():
        if name in channels:
            values = simulated[name]
            channels[name] = Channel(simulated.channel(name).unit, values + deviation * random.standard_normal(len(values)))
    return Recording(channels, inputs.metadata)


def know_every(nth: int) -> int:
    """Let the diagnosis try every nth effect alone, the hidden one among them; how many that are."""
    hidden = list(effects()).index(FRICTION)
    known = {name: effect for number, (name, effect) in enumerate(effects().items()) if (number - hidden) % nth == 0}
    entries.effects = lambda: known  # of the library alone
    return len(known)


def main() -> None:
    """Print seconds and peak memory."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="carm", help="a machine with controllers: a file, or the name of a shipped one")
    parser.add_argument("--seconds", type=float, default=60.0)
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
        sets.append({f"run_{experiment}_{n}": repeated(machine, inputs, friction, 10 * experiment + n) for n in range(count)})
    keep_memory()  # as the command does
    wall, processor = time.monotonic(), time.process_time()
    first: list[float] = []
    outcome = diagnose(machine, *sets, first=lambda diagnosis: first.append(diagnosis.seconds))
    wall = time.monotonic() - wall
    own = resource.getrusage(resource.RUSAGE_SELF)
    print(
        json.dumps(
            {
                "machine": machine.name,
                "effects": known,
                "recording_s": arguments.seconds,
                "first_answer_s": round(first[0], 1) if first else None,
                "wall_s": round(wall, 1),
                "processor_s": round(time.process_time() - processor, 1),
                "peak_GB": round(own.ru_maxrss / 1e6, 2),
                "verdict": outcome.diagnosis.verdict,
                "findings": [str(finding.effect) for finding in outcome.diagnosis.findings],
            }
        )
    )


if __name__ == "__main__":
    main()
