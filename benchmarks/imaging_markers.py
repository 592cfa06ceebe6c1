"""Marker plates: how close crossings are found, how long it takes, and whether poses scatter as their covariance says.

    python benchmarks/imaging_markers.py [--out benchmarks/results/imaging_markers.json] [--draws 12] [--poses 100]

640 x 512 pixels of 0.5 mm, the plate 0.25 m in front of the focal spot, every draw with a geometry and noise of its own. `panel blur`:
1.2 pixels, all of it the panel's. `focal spot`: a spot of 0.6 mm and a panel of 0.2 mm, about as wide. 10 % scatter either way. Photons
are those of the open beam; the plate passes a sixth of them, its grooves two fifths. `edges`: hybrid median, Canny, Hough and least
squares alone. Seconds are the process's.
"""

from __future__ import annotations

import argparse
import functools
import json
import time
from pathlib import Path

import numpy as np
from on_engine import add_scheduler, answers

from hil.calibration.marker.tube_to_panel import LINEAR, NONLINEAR, fit_marker
from hil.emulated.marker_images import expected_image
from hil.imaging import Detector
from hil.imaging.markers import PLATES, MarkerProjection, experimental_plate, find_marker
from hil.imaging.markers.canny_hough import coarse_points
from virtual_bus.xray.imaging import Optics, exposed

DETECTOR = Detector(columns=640, rows=512, pitch_m=0.5e-3)
NOMINAL = MarkerProjection.nominal(1.16, 0.25)
SPREAD = np.array([4e-3, 4e-3, 4e-3, 5e-3, 5e-3, 8e-3, 0.0, 0.0, 0.0])
"""Half the range of the draws; sources of this machine move by 4 mm."""
OPTICS = {"panel blur": {"spot_m": 0.0, "spread_m": 0.6e-3}, "focal spot": {"spot_m": 0.6e-3, "spread_m": 0.2e-3}}


@functools.cache
def compiled() -> None:
    """Find a marker, so that all is compiled and imported before the clock runs."""
    plate, optics = experimental_plate(), Optics(photons=2000.0, **OPTICS["panel blur"])
    find_marker(exposed(expected_image(plate, NOMINAL, DETECTOR, optics), optics, np.random.default_rng(7)), plate, NOMINAL, DETECTOR)


def crossings(name: str, photons: float, blur: str, draws: int) -> dict[str, float | int]:
    """Errors [pixel] and seconds over the draws."""
    plate, optics = PLATES[name](), Optics(photons=photons, **OPTICS[blur])
    compiled()
    rng = np.random.default_rng(7)
    fine, coarse, predicted, worst, seconds, refused = [], [], [], [], [], 0
    for _ in range(draws):
        true = MarkerProjection(NOMINAL.values + SPREAD * rng.uniform(-1.0, 1.0, 9))
        image = exposed(expected_image(plate, true, DETECTOR, optics), optics, rng)
        places = DETECTOR.to_pixels(true.project(plate.points_m))
        began = time.process_time()
        found = find_marker(image, plate, NOMINAL, DETECTOR)
        seconds.append(time.process_time() - began)
        edges = coarse_points(image, plate, NOMINAL, DETECTOR)
        error = found.pixels - places[found.index]
        fine.append(np.mean(error**2))
        worst.append(np.abs(error).max())
        predicted.append(np.mean(np.diag(found.covariance)))
        coarse.append(np.mean((edges.pixels - places[edges.index]) ** 2))
        refused += len(found.refused)
    return {
        "images": draws,
        "rms_pixels": float(np.sqrt(np.mean(fine))),
        "largest_pixels": float(np.max(worst)),
        "predicted_pixels": float(np.sqrt(np.mean(predicted))),
        "edges_rms_pixels": float(np.sqrt(np.mean(coarse))),
        "lines_refused": refused,
        "median_s": float(np.median(seconds)),
        "slowest_s": float(np.max(seconds)),
    }


def poses(photons: float, draws: int) -> dict[str, dict[str, list[float] | float]]:
    """One geometry, many images: scatter and bias of the pose beside its covariance [m, rad]."""
    plate, optics = experimental_plate(), Optics(photons=photons, **OPTICS["panel blur"])
    rng = np.random.default_rng(8)
    true = MarkerProjection(NOMINAL.values + np.array([1e-3, -2e-3, 2e-3, 4e-3, -3e-3, 6e-3, 0.0, 0.0, 0.0]))
    known = MarkerProjection(np.concatenate([NOMINAL.values[:3], true.values[3:]]))
    mean = expected_image(plate, true, DETECTOR, optics)
    found = [find_marker(exposed(mean, optics, rng), plate, NOMINAL, DETECTOR) for _ in range(draws)]
    result: dict[str, dict[str, list[float] | float]] = {}
    for name, free, start in (("angles fitted", NONLINEAR, NOMINAL), ("angles known", LINEAR, known)):
        fits = [fit_marker(points, plate, DETECTOR, start, free) for points in found]
        count = len(free)
        error = np.array([fit.projection.values - true.values for fit in fits])[:, :count]
        covariance = np.mean([fit.covariance for fit in fits], axis=0)[:count, :count]
        result[name] = {
            "parameters": list(free),
            "bias": error.mean(axis=0).tolist(),
            "deviation": error.std(axis=0, ddof=1).tolist(),
            "predicted": np.sqrt(np.diag(covariance)).tolist(),
            "squared_error_per_parameter": float(np.mean(np.einsum("na,ab,nb->n", error, np.linalg.inv(covariance), error)) / count),
        }
    return result


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/imaging_markers.json"))
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--poses", type=int, default=100)
    add_scheduler(parser)
    arguments = parser.parse_args()
    document: dict[str, object] = {"crossings": {}, "poses": {}}
    sweep = [
        {"name": name, "photons": photons, "blur": blur, "draws": arguments.draws}
        for name in PLATES
        for blur in OPTICS
        for photons in (2000.0, 200.0)
    ]
    for one, figures in zip(sweep, answers(crossings, sweep, arguments.scheduler), strict=True):
        key = f"{one['name']}, {one['blur']}, {one['photons']:g} photons"
        document["crossings"][key] = figures
        print(
            f"{key:40s} rms {figures['rms_pixels']:.4f} px (predicted {figures['predicted_pixels']:.4f}, largest"
            f" {figures['largest_pixels']:.3f}), edges {figures['edges_rms_pixels']:.3f}; {figures['median_s']:.3f} s"
        )
    levels = [{"photons": photons, "draws": arguments.poses} for photons in (2000.0, 200.0)]
    for photons, measured in zip((2000.0, 200.0), answers(poses, levels, arguments.scheduler), strict=True):
        document["poses"][f"{photons:g} photons"] = measured
        for name, figures in measured.items():
            micro = [f"{1e6 * value:.1f}" for value in figures["deviation"]]
            print(f"{photons:g} photons, {name}: deviation {', '.join(micro)} um, urad;", end=" ")
            print(f"squared error {figures['squared_error_per_parameter']:.2f} per parameter")
    arguments.out.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
