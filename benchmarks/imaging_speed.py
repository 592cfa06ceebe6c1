"""Processor time of an image: a marker plate or the bullet phantom found and its pose fitted, against a frame's time at 30 a second.

    python benchmarks/imaging_speed.py [--out benchmarks/results/imaging_speed.json] [--binnings 8 4 2]

Plates twice: in an image alone, and followed from one image to the next, in which the plate is elsewhere by as much as a scan moves it in a
thirtieth of a second. Images are made beforehand; processor time, not wall clock, so that a loaded machine counts the same, and one process
does all of it.
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


STEP = 0.3 * np.array([1e-4, -1e-4, 1e-4, 1e-5, 1e-5, 2e-5])
"""From one image of a plate to the next [m, rad]."""


def images(machine: Machine, detector: Detector) -> dict[str, list[np.ndarray]]:
    """Two images of each kind, one after the other."""
    rng, optics = np.random.default_rng(1), Optics()
    beam = nominal_beam(machine, POSE).moved(MOVED[None])
    view = View(beam.source_in_phantom_m[0], beam.detector_in_phantom_m[0], beam.rotation[0])
    panel = Panel(detector.columns, detector.rows, detector.pitch_m, detector.aspect, detector.skew)
    seen = expected([view], panel, scene("dodecahedron"), optics)
    made = {"phantom": [exposed(seen, optics, rng) for _ in range(2)]}
    true = [MarkerProjection(NOMINAL.values + np.append(MOVED[:6] + by, np.zeros(3))) for by in (np.zeros(6), STEP)]
    for name, plate in PLATES.items():
        made[name] = [exposed(expected_image(plate(), each, detector, optics), optics, rng) for each in true]
    return made


def seconds(machine: Machine, detector: Detector, name: str, pair: list[np.ndarray], repeats: int) -> dict[str, float]:
    """Median processor time of one image, after first ones that compile: alone, and of a plate followed."""
    taken: dict[str, list[float]] = {"alone": []} if name == "phantom" else {"alone": [], "followed": []}
    last = None
    for k in range(repeats + 2):
        for how, times in taken.items():
            began = time.process_time()
            if name == "phantom":
                found = phantom_in(pair[k % 2], detector, machine, POSE)
            else:
                found = marker_in(pair[k % 2], detector, name, NOMINAL, last if how == "followed" else None)
            times.append(time.process_time() - began)
            assert found is not None, f"{name} not found"
        last = found
    return {how: float(np.median(each[2:])) for how, each in taken.items()}


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
        for name, pair in images(machine, detector).items():
            for how, taken in seconds(machine, detector, name, pair, options.repeats).items():
                what = f"{name}{', followed' if how == 'followed' else ''}, {detector.columns} x {detector.rows}"
                document[what] = {"processor_s": taken, "share_of_frame": taken / FRAME_S}
                print(f"{what:40s} {1e3 * taken:6.1f} ms, {taken / FRAME_S:5.2f} of a frame", flush=True)
    options.out.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
