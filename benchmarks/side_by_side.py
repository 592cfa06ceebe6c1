"""Free runs of one machine side by side and one after the other: processor time of each, their ratio and their difference. Prints JSON.

python benchmarks/side_by_side.py [--machine carm] [--seconds 60] [--effect coulomb_friction Fc=8] [--rounds 5]

Each round runs LANES machines whose parameters differ by up to a hundredth both ways, in turns; the least of the rounds counts, and the
first is none of them: `first_s` is what it took side by side, with ISOCENTER_CACHE an empty folder mostly compiling its kernel.
"""

from __future__ import annotations

import argparse
import json
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from diagnosis_speed import driven

from hil.machine import load_machine
from hil.simulation import Outputs, Simulator
from hil.simulation.simulate import inputs_of
from hil.simulation.smooth import smooth
from virtual_bus.plant.lanes import LANES
from virtual_bus.settings import EffectSetting

SPREAD = 0.01


def main() -> None:
    """Print milliseconds per run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="carm", help="a machine with controllers: a file, or the name of a shipped one")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--effect", nargs="+", metavar=("NAME", "PARAMETER=VALUE"), help="at the last axis; none by default")
    arguments = parser.parse_args()
    machine = load_machine(arguments.machine)
    effects = ()
    if arguments.effect:
        name, *given = arguments.effect
        effects = (EffectSetting(name, machine.axes[-1], {key: float(value) for key, value in (one.split("=") for one in given)}),)
    simulator, inputs = Simulator(smooth(machine)), inputs_of(machine, driven(machine, arguments.seconds, 0))
    random, nominal = np.random.default_rng(1), simulator.plant.nominal
    trials = [(nominal * (1.0 + SPREAD * random.uniform(-1.0, 1.0, len(nominal))), effects) for _ in range(LANES)]
    together, alone = [], []
    for _ in range(arguments.rounds + 1):  # the first loads or compiles
        start = time.process_time()
        answers = simulator.run_all(inputs, trials)
        middle = time.process_time()
        singles = [simulator.run(inputs, *trial) for trial in trials]
        together.append((middle - start) / LANES)
        alone.append((time.process_time() - middle) / LANES)
    differences = [
        float(np.abs(answer.position - single.position).max() / np.ptp(single.position, axis=0).max())
        for answer, single in zip(answers, singles, strict=True)
        if isinstance(answer, Outputs)
    ]
    one, other = min(together[1:]), min(alone[1:])
    print(
        json.dumps(
            {
                "machine": machine.name,
                "effects": [setting.name for setting in effects],
                "recording_s": arguments.seconds,
                "side_by_side_ms": round(1e3 * one, 2),
                "one_after_the_other_ms": round(1e3 * other, 2),
                "ratio": round(other / one, 2),
                "first_s": round(LANES * together[0], 1),
                "difference_of_travel": max(differences),
            }
        )
    )


if __name__ == "__main__":
    main()
