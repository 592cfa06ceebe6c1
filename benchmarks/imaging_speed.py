"""Processor time of an image: a marker plate or the bullet phantom found and its pose fitted, against a frame's time at 30 a second.

    python benchmarks/imaging_speed.py [--out benchmarks/results/imaging_speed.json] [--binnings 8 4 2]

Images are made beforehand; processor time, not wall clock, so that a loaded machine counts the same. One process does all of it.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from hil.emulated.marker_images import expected_image
from hil.emulated.scenes import scene
from hil.imaging import Detector
from hil.imaging.markers import PLATES, MarkerProjection
from hil.imaging.nominal import nominal_beam, nominal_detector
from hil.machine import Machine, load_machine
from hil.receiving.sight import marker_in, phantom_in
from virtual_bus.xray.imaging import Optics, expected, exposed
from virtual_bus.xray.render import Panel, View

FRAME_S = 1.0 / 30.0
POSE = np.array([0.3, 0.5])
NOMINAL = MarkerProjection.nominal(1.16, 0.25)
MOVED = np.array([1e-3, -2e-3, 1e-3, 2e-3, -1e-3, 1e-3, 2e-3, -1e-3, 3e-3])
"""Deviation of the geometry seen from where it is looked for [m, rad]."""


def images(machine: Machine, detector: Detector) -> dict[str, np.ndarray]:
    """An image of each kind."""
    rng, optics = np.random.default_rng(1), Optics()
    beam = nominal_beam(machine, POSE).moved(MOVED[None])
    view = View(beam.source_in_phantom_m[0], beam.detector_in_phantom_m[0], beam.rotation[0])
    panel = Panel(detector.columns, detector.rows, detector.pitch_m, detector.aspect, detector.skew)
    made = {"phantom": exposed(expected([view], panel, scene("dodecahedron"), optics), optics, rng)}
    true = MarkerProjection(NOMINAL.values + np.append(MOVED[:6], np.zeros(3)))
    return made | {name: exposed(expected_image(plate(), true, detector, optics), optics, rng) for name, plate in PLATES.items()}


def seconds(machine: Machine, detector: Detector, name: str, image: np.ndarray, repeats: int) -> float:
    """Median processor time of one image, after a first that compiles."""
    taken = []
    for _ in range(repeats + 1):
        began = time.process_time()
        found = phantom_in(image, detector, machine, POSE) if name == "phantom" else marker_in(image, detector, name, NOMINAL)
        taken.append(time.process_time() - began)
        assert found is not None, f"{name} not found"
    return float(np.median(taken[1:]))


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/imaging_speed.json"))
    parser.add_argument("--binnings", type=int, nargs="+", default=[8, 4, 2])
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    machine = load_machine("carm")
    document: dict[str, dict[str, float]] = {}
    for binning in options.binnings:
        detector = nominal_detector(machine, binning)
        for name, image in images(machine, detector).items():
            taken = seconds(machine, detector, name, image, options.repeats)
            what = f"{name}, {detector.columns} x {detector.rows}"
            document[what] = {"processor_s": taken, "share_of_frame": taken / FRAME_S}
            print(f"{what:30s} {1e3 * taken:6.1f} ms, {taken / FRAME_S:5.2f} of a frame", flush=True)
    options.out.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
