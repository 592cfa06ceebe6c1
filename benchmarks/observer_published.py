"""All that the observer publishes, held to truth, for the design that one command makes: stated deviation over true error.

    python benchmarks/observer_published.py --json -

`hil.design_observer(MACHINE)` designs; then each scan is made by machines that are drawn within the ranges of the file's effects, others
than those to which the design was held. Root mean squares over all rows after the first second, components together.
"""

from __future__ import annotations

import argparse

import numpy as np

import hil
from controllers.observers.publish import QUANTITIES, of_quantities
from hil.experiments import Plan, Scan
from hil.machine import Machine, load_machine
from hil.machine.drawn import drawn
from hil.observing.held_to_truth import errors_and_variances
from hil.observing.true_scan import true_scan
from hil.terminal.output import Answer

FIRST_SEED = 7000
METHODS = ("kf", "ekf", "ukf")


def scans(machine: Machine) -> dict[str, Plan]:
    """Return the scans judged."""
    roll, propeller = (np.radians(-80.0), np.radians(80.0)), (np.radians(-60.0), np.radians(60.0))
    slow, fast, aside = np.radians(30.0), np.radians(55.0), {"propeller": np.radians(37.0)}
    made = {
        "roll 30 deg/s, quiet": Scan("roll", *roll, slow),
        "roll 30 deg/s, propeller at 37 deg, quiet": Scan("roll", *roll, slow, aside),
        "roll 55 deg/s, fast": Scan("roll", *roll, fast),
        "propeller 30 deg/s, reversed": Scan("propeller", *propeller, slow, sweeps=2),
    }
    return {name: scan.plans(machine)[0] for name, scan in made.items()}


def rows_of(name: str, seeds: int) -> dict[str, dict[str, float]]:
    """Return the table's rows of a machine."""
    machine, rows = load_machine(name), {}
    design, groups = hil.design_observer(machine), of_quantities(len(machine.axes))
    for scan, plan in scans(machine).items():
        sums, nis = np.zeros((len(METHODS), 2, len(QUANTITIES))), np.zeros(len(METHODS))
        for number in range(seeds):
            one = drawn(machine, number, seeds)
            true = true_scan(one, plan, FIRST_SEED + number)
            for which, method in enumerate(METHODS):
                error, variance, consistency = errors_and_variances(one, true, design.observer(method))  # type: ignore[arg-type]
                nis[which] += consistency / seeds
                for q in range(len(QUANTITIES)):
                    sums[which, :, q] += np.mean(variance[:, groups == q]), np.mean(error[:, groups == q] ** 2)
        for which, method in enumerate(METHODS):
            ratios = np.sqrt(sums[which, 0] / sums[which, 1])
            rows[f"{name}, {scan}: {method}"] = dict(zip(QUANTITIES, ratios.tolist(), strict=True)) | {"nis": float(nis[which])}
    return rows


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="machines per scan")
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    options = parser.parse_args()
    to = Answer(options.json)
    rows = {key: row for name in ("carm", "carm-real") for key, row in rows_of(name, options.seeds).items()}
    outside = sum(not 0.7 <= row[name] <= 1.5 for row in rows.values() for name in QUANTITIES)
    to.write({"seeds": options.seeds, "cells": len(rows) * len(QUANTITIES), "outside": outside, "rows": rows})


if __name__ == "__main__":
    main()
