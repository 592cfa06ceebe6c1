"""Marker plates with a patient in the beam: how often they are found, and whether the crossings' stated deviations are true.

    python benchmarks/imaging_patients.py [--out benchmarks/results/imaging_patients.json] [--draws 60] [--binning 4]

Every image has a patient, a pose of the arm, a geometry and noise of its own: seeds 0, 1, 2, ... in order, nothing left out. The panel is
the shipped machine's. A crossing is uncovered where, within a groove's width about it, the anatomy behind is a plane to 5 %; the anatomy
alone is rendered to say so, detection is not told. Beside: the plate's distance from the focal spot against blur (thesis Sec. 6.6).
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from on_engine import add_scheduler, answers
from scipy.spatial.transform import Rotation

from hil.calibration.marker.tube_to_panel import NONLINEAR, fit_marker
from hil.emulated.anatomy import with_patient
from hil.emulated.beam import Beam
from hil.emulated.marker_images import steel
from hil.errors import UnusableInputError
from hil.imaging import Detector
from hil.imaging.markers import PLATES, MarkerPoints, MarkerProjection, find_marker
from hil.imaging.nominal import nominal_detector
from hil.machine import load_machine
from virtual_bus.xray.imaging import Optics, exposed
from virtual_bus.xray.markers import Mounted, expected_with_plate
from virtual_bus.xray.render import Panel, View, transmission

NOMINAL = MarkerProjection.nominal(1.16, 0.25)
ISOCENTER_M = 0.81
"""From the focal spot."""
SPREAD = np.array([4e-3, 4e-3, 4e-3, 5e-3, 5e-3, 8e-3, 0.0, 0.0, 0.0])
"""Half the range of the geometries drawn; sources of this machine move by 4 mm."""
FEWEST_PHOTONS, MOST_PHOTONS = 10_000.0, 40_000.0
PLANE = 0.05
UNCOVERED = 0.8
DISTANCES_M = (0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
SPOTS_M = (0.3e-3, 0.6e-3, 1.0e-3)


def view_of(true: MarkerProjection, turned: np.ndarray) -> tuple[View, Mounted, np.ndarray]:
    """The exposure in the patient's frame, the plate's mounting without its metal, and the panel's orientation."""
    panel = turned @ np.array([0.0, 0.0, 1.16 - ISOCENTER_M])
    view = View(panel + turned @ true.source_m, panel, turned)
    return view, Mounted(None, panel + turned @ true.plate_m, turned @ true.rotation), turned  # type: ignore[arg-type]


def uncovered(name: str, true: MarkerProjection, detector: Detector, anatomy: np.ndarray) -> np.ndarray:
    """Which crossings have nothing but a slowly varying shade about them."""
    plate = PLATES[name]()
    radius = plate.groove_m * 1.16 / 0.25 / detector.pitch_m
    places = detector.to_pixels(true.project(plate.points_m))
    result = np.zeros(len(places), dtype=bool)
    for k, (column, row) in enumerate(places):
        rows, columns = (np.arange(round(at - radius), round(at + radius) + 1) for at in (row, column))
        if rows[0] < 0 or columns[0] < 0 or rows[-1] >= detector.rows or columns[-1] >= detector.columns:
            continue
        shade = np.log(anatomy[np.ix_(rows, columns)])
        v, u = np.meshgrid(rows - row, columns - column, indexing="ij")
        near = np.hypot(u, v) <= radius
        design = np.stack([np.ones(near.sum()), u[near], v[near]], axis=1)
        rest = shade[near] - design @ np.linalg.lstsq(design, shade[near], rcond=None)[0]
        result[k] = np.abs(rest).max() < PLANE
    return result


def one(name: str, seed: int, binning: int) -> dict[str, object]:
    """One image: found or not, errors and deviations [pixel] of its crossings."""
    detector = nominal_detector(load_machine("carm"), binning)
    rng = np.random.default_rng([seed, 57])
    true = MarkerProjection(NOMINAL.values + SPREAD * rng.uniform(-1.0, 1.0, 9))
    turned = Rotation.from_euler("xy", [rng.uniform(-120.0, 120.0), rng.uniform(-90.0, 90.0)], degrees=True).as_matrix()
    photons = float(np.exp(rng.uniform(np.log(FEWEST_PHOTONS), np.log(MOST_PHOTONS))))
    beam = with_patient(Beam([], None, Optics()), seed, photons)
    view, mounting, _ = view_of(true, turned)
    panel = Panel(detector.columns, detector.rows, detector.pitch_m, detector.aspect, detector.skew)
    mounted = Mounted(steel(PLATES[name]()), mounting.origin_m, mounting.rotation)
    image = exposed(expected_with_plate([view], panel, [mounted], beam.optics, beam.items), beam.optics, rng)
    clear = uncovered(name, true, detector, transmission(view, panel, beam.items, 1))
    answer: dict[str, object] = {"seed": seed, "uncovered": float(clear.mean())}
    began = time.process_time()
    try:
        found = find_marker(image, PLATES[name](), NOMINAL, detector)
    except UnusableInputError as error:
        return answer | {"found": False, "why": str(error)}
    answer |= {"seconds": time.process_time() - began, "found": True, "points": len(found.index), "spoilt": found.spoilt}
    error = found.pixels - detector.to_pixels(true.project(PLATES[name]().points_m))[found.index]
    variance = np.diag(found.covariance).reshape(-1, 2)
    return answer | {
        "error_rms": float(np.sqrt(np.mean(error**2))),
        "largest": float(np.abs(error).max()),
        "stated_rms": float(np.sqrt(variance.mean())),
        "standardised": float(np.mean(error**2 / variance)),
        "per_freedom": per_freedom(found, error.ravel()),
    }


def per_freedom(found: MarkerPoints, error: np.ndarray) -> float:
    """Squared error over the whole covariance, per degree of freedom."""
    values, vectors = np.linalg.eigh(found.covariance)
    seen = values > 1e-9 * values.max()
    return float(np.mean((vectors[:, seen].T @ error) ** 2 / values[seen]))


def summed(images: list[dict[str, object]]) -> dict[str, object]:
    """Shares and ratios over images: with most points uncovered, with fewer, and all."""
    groups = {
        f"{UNCOVERED:.0%} uncovered or more": [each for each in images if float(each["uncovered"]) >= UNCOVERED],  # type: ignore[arg-type]
        "fewer uncovered": [each for each in images if float(each["uncovered"]) < UNCOVERED],  # type: ignore[arg-type]
        "all": images,
    }
    result: dict[str, object] = {}
    for name, group in groups.items():
        found = [each for each in group if each["found"]]
        values = {
            key: np.array([each[key] for each in found], dtype=float) for key in ("error_rms", "stated_rms", "standardised", "spoilt")
        }
        if not found:
            result[name] = {"images": len(group), "found": 0}
            continue
        true, stated = (float(np.sqrt(np.mean(values[key] ** 2))) for key in ("error_rms", "stated_rms"))
        result[name] = {
            "images": len(group),
            "found": len(found),
            "true_pixels": true,
            "stated_pixels": stated,
            "stated_over_true": stated / true,
            "stated_over_true_standardised": float(1.0 / np.sqrt(np.mean(values["standardised"]))),
            "stated_over_true_median_image": float(np.median(values["stated_rms"] / values["error_rms"])),
            "largest_pixels": max(float(each["largest"]) for each in found),  # type: ignore[arg-type]
            "pieces_spoilt_median": float(np.median(values["spoilt"])),
            "seconds_median": float(np.median([each["seconds"] for each in found])),
        }
    return result


def against_distance(detector: Detector, draws: int) -> dict[str, dict[str, object]]:
    """Sec. 6.6: near the spot a plate's image moves more and is blurred more; the same plate everywhere, no patient."""
    rows: dict[str, dict[str, object]] = {}
    for spot in SPOTS_M:
        for distance in DISTANCES_M:
            optics, plate = Optics(spot_m=spot), PLATES["experimental"]()
            panel = Panel(detector.columns, detector.rows, detector.pitch_m, detector.aspect, detector.skew)
            nominal = MarkerProjection.nominal(1.16, distance)
            fits, errors, stated, blur, points = [], [], [], [], []
            for seed in range(draws):
                rng = np.random.default_rng([seed, 66])
                true = MarkerProjection(nominal.values + SPREAD * rng.uniform(-1.0, 1.0, 9))
                view, mounting, _ = view_of(true, np.eye(3))
                mounted = Mounted(steel(plate), mounting.origin_m, mounting.rotation)
                image = exposed(expected_with_plate([view], panel, [mounted], optics), optics, rng)
                found = find_marker(image, plate, nominal, detector)
                fit = fit_marker(found, plate, detector, nominal, NONLINEAR)
                fits.append(fit.projection.values - true.values)
                errors.append(np.mean((found.pixels - detector.to_pixels(true.project(plate.points_m))[found.index]) ** 2))
                stated.append(np.mean(np.diag(found.covariance)))
                blur.append(np.median([line.blur for line in found.lines.values()]) * detector.pitch_m)
                points.append(len(found.index))
            rms = np.sqrt(np.mean(np.square(fits), axis=0))
            rows[f"{1e3 * spot:g} mm, {distance:g} m"] = {
                "spot_mm": 1e3 * spot,
                "distance_m": distance,
                "magnification": 1.16 / distance,
                "blur_mm": 1e3 * float(np.median(blur)),
                "crossings": float(np.median(points)),
                "true_pixels": float(np.sqrt(np.mean(errors))),
                "stated_pixels": float(np.sqrt(np.mean(stated))),
                "focal_u_um": 1e6 * float(rms[0]),
                "focal_length_um": 1e6 * float(rms[2]),
                "theta_x_urad": 1e6 * float(rms[3]),
                "theta_z_urad": 1e6 * float(rms[5]),
            }
            print(rows[f"{1e3 * spot:g} mm, {distance:g} m"])
    return rows


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/imaging_patients.json"))
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--distance-draws", type=int, default=10)
    parser.add_argument("--binning", type=int, default=4)
    add_scheduler(parser)
    arguments = parser.parse_args()
    detector = nominal_detector(load_machine("carm"), arguments.binning)
    document: dict[str, object] = {"binning": arguments.binning, "patients": {}, "distance": {}}
    for name in PLATES:
        each = [{"name": name, "seed": seed, "binning": arguments.binning} for seed in range(arguments.draws)]
        images = answers(one, each, arguments.scheduler)
        document["patients"][name] = (
            summed(images)
            | {  # type: ignore[index]
                "not found": [each for each in images if not each["found"]],
                "worst": sorted((each for each in images if each["found"]), key=lambda each: -float(each["standardised"]))[:3],  # type: ignore[arg-type]
            }
        )
        print(name, json.dumps(document["patients"][name], indent=1))  # type: ignore[index]
    if arguments.distance_draws:
        document["distance"] = against_distance(detector, arguments.distance_draws)
    arguments.out.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
