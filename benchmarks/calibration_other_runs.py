"""A machine of the side-by-side comparison in further scans: other disturbances, other photons, the same tour.

    python benchmarks/calibration_other_runs.py --work FOLDER --json benchmarks/results/calibration_other_runs.json
    python benchmarks/calibration_other_runs.py --kind real --scans 3 --work FOLDER --json -

FOLDER is that of calibration_side_by_side.py, whose tour, observer and model are gone on from. One scan is one draw of photons and of
disturbances; what a calibration is worth is its median over several. Each data-driven calibration goes on from two knowledges of the tour:
from 21 images of the phantom, and from the 127 that the model has. Both have 21 of a plate besides.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from calibration_side_by_side import FEW, KINDS, UNSEEN, FEW_Hz, MODEL_Hz, RATE_Hz, Work, at, fitted, looked_at, plate, scored

from hil.calibration.data_driven.calibrate import calibrate_data
from hil.calibration.data_driven.observed_beam import ObservedBeam, unobserved_beam
from hil.calibration.data_driven.quasi_static import QuasiStatic
from hil.calibration.data_driven.values import Measurement, Parameters
from hil.calibration.kinematic.geometric_model import read_calibration
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.observing import read_design
from hil.terminal.output import Answer

FIRST_SEED = 40
"""Of the disturbances and of the photons; the comparison's own are 11 to 13, and 0. Twice as many as scans are tried at most."""

TOLD_M = 0.1e-3
"""Standard deviation (and rad) with which the truth is told where only the observer's own error is asked: no less than that error in any
coordinate, so that none is taken for contradicted."""

OWN = "parameters fitted to the truth, the rest is the observer's"

SCORES = ("source_mm", "phantom_mm", "rotation_mrad")


def in_time(*groups: Sequence[Measurement]) -> list[Measurement]:
    """All of them, by the time of their exposures."""
    return sorted((each for group in groups for each in group), key=lambda each: each.time_s)


class Tours:
    """What is known from the tour, by how many images of the phantom."""

    def __init__(self, work: Work) -> None:
        self.work, self.model = work, QuasiStatic.of(work.carm)
        self.design = read_design(work.folder / "observer.npz")
        few, many = work.images("tour", "few", FEW_Hz), work.images("tour", "phantom", MODEL_Hz)
        plates = plate(work, work.images("tour", "marker", FEW_Hz, "--marker", "experimental"))
        plain = unobserved_beam(work.carm, work.recording("tour"))
        unknown = Parameters.unknown(self.model)
        self.first = calibrate_data(self.model, plain, fitted(work, few, plain), unknown).parameters
        observed = looked_at(work, "tour", self.design, self.first, self.model)
        self.known: dict[str, Parameters] = {}
        for scan in (few, many):
            seen = in_time(fitted(work, scan, observed), plates)
            self.known[f"{len(scan)} images of the tour"] = calibrate_data(self.model, observed, seen, unknown).parameters


def observers_own(tours: Tours, observed: ObservedBeam, times_s: np.ndarray, true: ConeBeam) -> np.ndarray:
    """(N, 9) deviations with the parameters that fit the truth itself best: what is left is the observer's, whatever images tell."""
    positions, _, _ = observed.at(times_s)
    deviation = true.deviation_from(nominal_beam(tours.work.carm, positions))
    told = [Measurement(float(time), each, TOLD_M**2 * np.eye(9)) for time, each in zip(times_s, deviation, strict=True)]
    held = dataclasses.replace(observed, displacement_std=np.full(6, 1e-9))
    return calibrate_data(tours.model, held, told, Parameters.unknown(tours.model)).final


def another_scan(tours: Tours, seed: int) -> dict[str, dict[str, float]]:
    """Every calibration on a scan of its own."""
    work, name = tours.work, f"unseen_{seed}"
    work.run(name, UNSEEN, seed, after=True)
    phantom = work.images(name, "phantom", RATE_Hz, "--seed", seed, after=True)
    marked = work.images(name, "marker", RATE_Hz, "--marker", "experimental", "--seed", seed, after=True)
    true = work.truth(name, phantom, after=True)
    model = read_calibration(work.folder / "model.npz", work.carm)
    beams = {"model-based": nominal_beam(work.carm, phantom.positions).moved(model.at(phantom.positions))}
    plates = plate(work, marked)
    for label, known in tours.known.items():
        observed = looked_at(work, name, tours.design, known, tours.model)
        beams[OWN] = at(work.carm, observed, observers_own(tours, observed, phantom.middle_s, true), phantom)
        images = fitted(work, phantom, observed)
        for what, measurements, most in (
            ("images", images, None),
            (f"images withdrawn after {FEW}", images, FEW),
            (f"a plate in every exposure, images withdrawn after {FEW}", in_time(images, plates), FEW),
        ):
            run = calibrate_data(tours.model, observed, measurements, known.aged(tours.model), most=most)
            beams[f"{label}; {what}"] = at(work.carm, observed, run.final, phantom)
    result = {}
    for label, beam in beams.items():
        score = scored(true, beam, phantom.detector)
        result[label] = {each: float(score[each]) for each in SCORES} | {"overlay_mm": float(score["overlay_mm"]["centre"]["mean"])}  # type: ignore[arg-type,index]
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", metavar="FOLDER", type=Path, required=True, help="that of calibration_side_by_side.py, after its run")
    parser.add_argument("--kind", choices=KINDS, default="not_repeatable", help="of that comparison's machines")
    parser.add_argument("--scans", metavar="N", type=int, default=6, help="further scans")
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    options = parser.parse_args()
    to = Answer(options.json)
    tours = Tours(Work(options.work, options.kind))
    scans, not_run = [], []
    for seed in range(FIRST_SEED, FIRST_SEED + 2 * options.scans):
        if len(scans) == options.scans:
            break
        kept = tours.work.folder / f"unseen_{seed}.json"
        try:
            if not kept.exists():
                kept.write_text(json.dumps(another_scan(tours, seed)), encoding="utf-8")
        except SystemExit:
            not_run.append(seed)  # shaken so that homing's first-move check refuses: said on standard error
            continue
        scans.append({"seed": seed, "calibrations": json.loads(kept.read_text(encoding="utf-8"))})
        print(f"scan {seed}: {scans[-1]}", file=sys.stderr, flush=True)
    if not scans:
        parser.exit(1, f"none of {len(not_run)} runs was possible; the reasons stand above\n")
    summary = {}
    for label in scans[0]["calibrations"]:
        over, model = (
            np.array([[scan["calibrations"][name][each] for each in SCORES] for scan in scans]) for name in (label, "model-based")
        )
        times = model / over
        summary[label] = {
            "median": dict(zip(SCORES, np.median(over, axis=0).tolist(), strict=True)),
            "times_better_than_model": dict(zip(SCORES, np.median(times, axis=0).tolist(), strict=True)),
            "least_times": dict(zip(SCORES, times.min(axis=0).tolist(), strict=True)),
        }
    to.write({"summary": summary, "scans": scans, "not_run": not_run})


if __name__ == "__main__":
    main()
