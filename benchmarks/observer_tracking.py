"""A mode whose frequency has changed by 10 %: how soon the observer that takes it for a state knows, over 20 s of ordinary scanning.

    python benchmarks/observer_tracking.py --design carm.observer.npz --json -

The design is what `observer_scan.py --save-design` writes, tuned on shaken scans; for quiet ones it is tuned again on quiet ones. Its first
mode, the gear of the propeller at 8 Hz, is declared 10 % too low. Beside the error stands what the scan can tell at all: the deviation that
is left after 20 s at the right frequency when it is taken for constant, a Cramér-Rao bound for the modelled noise.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np
from observer_scan import shaken_scan

from controllers.models.modal import ModalModel
from hil.experiments import Scan
from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, observe, read_design, tune
from hil.recording import Recording
from hil.terminal.output import Answer

CHANGE = 1.1
TRACKED = 0.01
SECONDS = 20.0
WALK = 3e-4
"""Of the log frequency ratio per sqrt(s): 0.1 % in 10 s, as a structure that warms up may."""

ADAPTED = (0,)


def scans() -> dict[str, Scan]:
    """Sweeps to and fro for 20 s or more."""
    roll, propeller = (np.radians(-80.0), np.radians(80.0)), (np.radians(-60.0), np.radians(60.0))
    return {
        "roll 30 deg/s": Scan("roll", *roll, np.radians(30.0), sweeps=4),
        "roll 55 deg/s": Scan("roll", *roll, np.radians(55.0), sweeps=5),
        "propeller 30 deg/s": Scan("propeller", *propeller, np.radians(30.0), sweeps=4),
    }


def declared_low(model: ModalModel) -> ModalModel:
    """The model with its first mode 10 % lower; pushes and shapes as they are."""
    n, stride = len(model.axes), model.mode_stride
    coefficients = model.coefficients.copy()
    coefficients[0] *= CHANGE**2
    coefficients[1] *= CHANGE
    coefficients[stride - n : stride] *= CHANGE**2  # pushes are kept over ω²
    coefficients[model.modes * stride + n * (n + 1) + n] *= CHANGE**2
    softened = {"coefficients": coefficients}
    for name in ("directions", "turning"):
        if getattr(model, name) is not None:
            softened[name] = getattr(model, name).copy()
            softened[name][n] *= CHANGE**2
    return dataclasses.replace(model, **softened)


def tracked(design: ObserverDesign, recording: Recording) -> dict[str, float | None]:
    """Error [%] after 20 s, seconds until it stays within 1 %, deviations believed and possible [%]."""
    noise = dataclasses.replace(design.noise, adapted_walk=WALK)
    observer = dataclasses.replace(design, model=declared_low(design.model), noise=noise).observer("ukf", ADAPTED)
    estimate = observe(recording, observer)
    state = estimate.state_names.index("log_frequency_ratio_mode_1")
    rows = estimate.time_s <= estimate.time_s[0] + SECONDS
    error = np.exp(estimate.states[rows, state]) / CHANGE - 1.0
    outside = np.flatnonzero(np.abs(error) > TRACKED)
    settled = 0 if not outside.size else int(outside[-1]) + 1
    constant = design.observer("ekf", ADAPTED)
    observe(recording.part(slice(0, int(rows.sum()))), constant)
    return {
        "error_after_20_s_percent": 100.0 * float(error[-1]),
        "within_1_percent_from_s": float(estimate.time_s[settled] - estimate.time_s[0]) if settled < len(error) else None,
        "deviation_believed_percent": 100.0 * float(np.sqrt(observer.covariance[state, state])),
        "deviation_possible_percent": 100.0 * float(np.sqrt(constant.covariance[state, state])),
    }


def quiet_design(machine: Machine, design: ObserverDesign) -> ObserverDesign:
    """The design tuned on scans that nothing shakes."""
    chosen = [Scan("roll", -1.2, 1.2), Scan("propeller", -1.0, 1.0)]
    records = [shaken_scan(machine, scan.plans(machine)[0], 200 + i, 0.0).recording for i, scan in enumerate(chosen)]
    return dataclasses.replace(design, noise=tune(design.model, design.noise, records).noise)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    parser.add_argument("--design", metavar="FILE", type=Path, required=True, help="design tuned on shaken scans")
    parser.add_argument("--machine", default="carm", help="carm, carm-real, or the path of a C-arm's file")
    options = parser.parse_args()
    to = Answer(options.json)
    machine = load_machine(options.machine)
    design = read_design(options.design)
    answer: dict[str, dict] = {}
    for name, loudness, used in (("shaken", 1.0, design), ("quiet", 0.0, quiet_design(machine, design))):
        answer[name] = {}
        for i, (scan, experiment) in enumerate(scans().items()):
            recording = shaken_scan(machine, experiment.plans(machine)[0], 30 + i, loudness).recording
            answer[name][scan] = tracked(used, recording)
    to.write(answer)


if __name__ == "__main__":
    main()
