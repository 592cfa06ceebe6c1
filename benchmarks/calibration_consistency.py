"""A scan recalibrated from its own images, on the emulated C-arm built askew: geometry and wires before and after.

    python benchmarks/calibration_consistency.py --work FOLDER --json benchmarks/results/calibration_consistency.json

Begins from the drawing, and from a phantom calibration of the machine before its mount moved by 0.3 mm. A scan's place and size are not
in its images: errors are left after both are fitted. `after_mm` is of what the command leaves, which is the start where it writes no table;
`found_mm` of what it would have written. Steps whose files are in FOLDER are not
done again.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from calibration_side_by_side import UNSEEN, WIRES_Hz, Work, wire_figures
from numpy.polynomial.legendre import legvander
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hil.calibration.consistency.recalibrate import ORDER, recalibrate
from hil.calibration.use.from_phantom_scan import calibrate_phantom_scan
from hil.emulated.scenes import scene
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import nominal_beam, nominal_detector
from hil.machine import Machine
from virtual_bus.xray.imaging import Optics, expected, exposed
from virtual_bus.xray.render import Panel, View

SCENES = ("wires-1mm", "dodecahedron", "aneurysm")
DRAWS, DRAWN_SCENES, DRAWN_VIEWS, DRAWN_BINNING = 8, ("dodecahedron", "aneurysm", "vessel"), 32, 8
POINTS = np.random.default_rng(1).uniform(-0.04, 0.04, (60, 3))


def seen_mm(beam: ConeBeam, detector: Detector, points: np.ndarray) -> np.ndarray:
    """Shadows (N, P, 2) on the panel."""
    own = np.einsum("nab,pb->npa", beam.matrices(detector), np.column_stack([points, np.ones(len(points))]))
    shadows: np.ndarray = 1e3 * detector.pitch_m * own[..., :2] / own[..., 2:]
    return shadows


def shape_error_mm(beam: ConeBeam, true: ConeBeam, detector: Detector) -> float:
    """Rms distance of shadows, the scan's place and size fitted."""
    wanted = seen_mm(true, detector, POINTS)

    def misfit(x: np.ndarray) -> np.ndarray:
        points = np.exp(x[6]) * Rotation.from_rotvec(x[:3]).apply(POINTS) + 0.01 * x[3:6]
        apart: np.ndarray = (seen_mm(beam, detector, points) - wanted).ravel()
        return apart

    return float(np.sqrt(2.0 * np.mean(least_squares(misfit, np.zeros(7)).fun ** 2)))


def drawn(scene_name: str, carm: Machine, seed: int) -> dict[str, object]:
    """One scan of a machine that has changed by a draw: 0.3 mm and 0.3 mrad of degree n over n + 1 in each of the nine parameters."""
    positions = np.column_stack([np.full(DRAWN_VIEWS, np.radians(25.0)), np.radians(np.linspace(-90.0, 90.0, DRAWN_VIEWS))])
    beam, detector = nominal_beam(carm, positions), nominal_detector(carm, DRAWN_BINNING)
    random = np.random.default_rng(seed)
    along = legvander(np.linspace(-1.0, 1.0, DRAWN_VIEWS), ORDER)
    true = beam.moved(along @ (3e-4 / (1.0 + np.arange(ORDER + 1))[:, None] * random.standard_normal((ORDER + 1, 9))))
    panel = Panel(detector.columns, detector.rows, detector.pitch_m, detector.aspect, detector.skew)
    views = [View(*each) for each in zip(true.source_in_phantom_m, true.detector_in_phantom_m, true.rotation, strict=True)]
    images = [exposed(expected([view], panel, scene(scene_name), Optics()), Optics(), random) for view in views]
    found = recalibrate(lambda k: images[k], detector, beam)
    return {
        "before_mm": shape_error_mm(beam, true, detector),
        "found_mm": shape_error_mm(beam.moved(found.deviation), true, detector),
        "stated_mm": 1e3 * found.stated_m,
        "changed": found.sure,
    }


def rms(rows: list[dict[str, object]], key: str) -> float:
    return float(np.sqrt(np.mean([float(row[key]) ** 2 for row in rows])))  # type: ignore[arg-type]


def coverage(carm: Machine) -> dict[str, object]:
    """Stated deviation over true, over draws of machines that have changed."""
    result: dict[str, object] = {}
    for name in DRAWN_SCENES:
        rows = [drawn(name, carm, seed) for seed in range(DRAWS)]
        kept = [row for row in rows if row["changed"]]
        result[name] = {
            "draws": len(rows),
            "changed": len(kept),
            "worse": sum(float(row["found_mm"]) > float(row["before_mm"]) for row in kept),  # type: ignore[arg-type]
            "before_mm": rms(kept, "before_mm"),
            "found_mm": rms(kept, "found_mm"),
            "stated_mm": rms(kept, "stated_mm"),
            "ratio": rms(kept, "stated_mm") / rms(kept, "found_mm"),
        }
        print(name, result[name], flush=True)
    return result


def main() -> None:
    """Run, expose, recalibrate, judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--drawn", type=Path, help="result of draws of machines, which hold the stated deviation to the truth")
    options = parser.parse_args()
    work = Work(options.work, "not_repeatable")
    work.run("earlier", UNSEEN, 1)
    work.run("unseen", UNSEEN, 2, after=True)
    table = calibrate_phantom_scan(work.carm, work.images("earlier", "phantom", WIRES_Hz)).table
    rows: dict[str, dict[str, object]] = {}
    for name in SCENES:
        scan = work.images("unseen", name, WIRES_Hz, "--scene", name, after=True)
        true, nominal = work.truth("unseen", scan, after=True), nominal_beam(work.carm, scan.positions)
        for start, beam in (("drawing", nominal), ("earlier phantom", nominal.moved(table.at(scan.positions)))):
            began = time.process_time()
            found = recalibrate(scan.frame, scan.detector, beam)
            after = beam.moved(found.deviation) if found.sure else beam  # no table is written otherwise
            row: dict[str, object] = {
                "before_mm": shape_error_mm(beam, true, scan.detector),
                "after_mm": shape_error_mm(after, true, scan.detector),
                "changed": found.sure,
                "gain": found.gain,
                "stated_mm": 1e3 * found.stated_m,
                "found_mm": shape_error_mm(beam.moved(found.deviation), true, scan.detector),
                "cpu_s": time.process_time() - began,
            }
            if name.startswith("wires"):
                row |= {
                    f"{figure}_{moment}": value
                    for moment, geometry in (("before", beam), ("after", after), ("true", true))
                    for figure, value in wire_figures(scan, geometry).items()
                    if figure.startswith("peak")
                }
            rows[f"{name}, {start}"] = row
            print(f"{name}, {start}: {row}", flush=True)
    if options.json:
        options.json.write_text(json.dumps({"scans": rows}, indent=1) + "\n", encoding="utf-8")
    if options.drawn:
        options.drawn.write_text(json.dumps({"drawn": coverage(work.carm)}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
