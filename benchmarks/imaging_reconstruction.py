"""Reconstruction: time of a cone-beam volume, and in a plane what number of angles and a detector's offset do (thesis Appendix B).

    python benchmarks/imaging_reconstruction.py --json benchmarks/results/imaging_reconstruction.json --figure plane.png

150 projections of 256 x 256 pixels into 128^3 voxels, wall clock and processor time, the least of three. In the plane: three discs by
parallel beams and by a fan at 30, 60, 100, 150 and 600 angles, and a 0.2 mm wire with the detector 0 and 0.5 mm off.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.reconstruction.fdk import reconstruct
from hil.reconstruction.filtered_backprojection import fan_projections, fan_reconstruction, filtered_backprojection, parallel_projections
from hil.terminal.output import Answer

DISCS = np.array([[0.0, 0.0, 0.05, 20.0], [0.018, 0.006, 0.012, 10.0], [-0.02, -0.015, 0.008, -8.0]])
SIZE, SPACING_m, SOURCE_m, DETECTOR_m = 129, 1e-3, 0.81, 1.16
PSI = (np.arange(301) - 150) * 0.0006
ANGLES = (30, 60, 100, 150, 600)
WIRE_m, WIRE_1_m = 0.1e-3, 5000.0


def cone_beam_time() -> dict[str, float]:
    """Seconds of an FDK reconstruction."""
    angles = np.radians(np.linspace(-105.0, 105.0, 150))
    turned = np.stack([np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]]) for a in angles])
    beam = ConeBeam.from_frames(turned @ [0.0, 0.0, -SOURCE_m], turned @ [0.0, 0.0, DETECTOR_m - SOURCE_m], turned)
    images = np.random.default_rng(0).random((150, 256, 256), dtype=np.float32)
    detector = Detector(256, 256, 1.2e-3)
    walls, processors = [], []
    for _ in range(3):
        wall, processor = time.perf_counter(), time.process_time()
        reconstruct(images, detector, beam, 128, 1e-3)
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return {"wall_s": min(walls), "processor_s": min(processors)}


def discs(fine: int = 4) -> np.ndarray:
    """The discs on the grid."""
    along = (np.arange(SIZE * fine) - (SIZE * fine - 1) / 2.0) * SPACING_m / fine
    x, y = np.meshgrid(along, along)
    values = sum(a * ((x - cx) ** 2 + (y - cy) ** 2 < r**2) for cx, cy, r, a in DISCS)
    return np.asarray(values).reshape(SIZE, fine, SIZE, fine).mean(axis=(1, 3))


def fan(count: int) -> np.ndarray:
    """The discs by a fan over a turn."""
    turn = 2.0 * np.pi * np.arange(count) / count
    return fan_reconstruction(fan_projections(DISCS, turn, PSI, SOURCE_m), turn, PSI, SOURCE_m, SIZE, SPACING_m)


def parallel(count: int, window: str | None = "ramp") -> np.ndarray:
    """The discs by parallel beams over half a turn."""
    angles = np.pi * np.arange(count) / count
    return filtered_backprojection(parallel_projections(discs(), angles, SPACING_m), angles, SPACING_m, window)


def wire_peak(offset_m: float) -> float:
    """Peak of a wire over its attenuation, the largest of nine places between pixels, with the detector shifted by an offset."""
    turn, fine = 2.0 * np.pi * np.arange(720) / 720, 0.1e-3
    psi = (np.arange(201) - 100) * fine / DETECTOR_m
    peaks = []
    for x in np.linspace(0.0, fine, 3):
        for y in np.linspace(0.0, fine, 3):
            wire = np.array([[2e-3 + x, y, WIRE_m, WIRE_1_m]])
            rays = psi[:, None] + offset_m / DETECTOR_m + np.linspace(-0.5, 0.5, 5) * fine / DETECTOR_m  # a pixel sees the mean
            seen = fan_projections(wire, turn, rays.ravel(), SOURCE_m).reshape(len(turn), len(psi), -1).mean(axis=2)
            image = fan_reconstruction(seen, turn, psi, SOURCE_m, 121, 0.07e-3)
            peaks.append(float(image.max()) / WIRE_1_m)
    return max(peaks)


def figure() -> Figure:
    """Discs by numbers of angles."""
    truth = discs()
    panels = {"discs": truth, "backsmear, 150 angles": parallel(150, None), "parallel, 30 angles": parallel(30)}
    panels |= {"parallel, 150 angles": parallel(150), "fan, 30 angles": fan(30), "fan, 150 angles": fan(150)}
    drawn = Figure(figsize=(11.0, 7.2), layout="constrained")
    reach = 0.5e3 * SIZE * SPACING_m
    for panel, (name, image) in zip(drawn.subplots(2, 3).flat, panels.items(), strict=True):
        limits = (None, None) if name.startswith("backsmear") else (-2.0, 32.0)
        shown = panel.imshow(image, cmap="cividis", vmin=limits[0], vmax=limits[1], extent=(-reach, reach, reach, -reach))
        panel.set_title(name, fontsize=10)
        panel.set_xlabel("x [mm]")
        panel.set_ylabel("y [mm]")
        drawn.colorbar(shown, ax=panel, label="attenuation [1/m]", shrink=0.8)
    return drawn


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    parser.add_argument("--figure", metavar="PNG", type=Path, help="draw the discs as well")
    options = parser.parse_args()
    to = Answer(options.json)
    truth = discs()
    along = (np.arange(SIZE) - (SIZE - 1) / 2.0) * SPACING_m
    inside = np.hypot(*np.meshgrid(along, along)) < 0.06

    def error(image: np.ndarray) -> float:
        return float(np.sqrt(np.mean((image - truth)[inside] ** 2)))

    answer = {
        "cone_beam": cone_beam_time(),
        "rms_error_1_m": {
            "parallel": {count: error(parallel(count)) for count in ANGLES},
            "fan": {count: error(fan(count)) for count in ANGLES},
        },
        "wire_peak": {f"{1e3 * offset:g} mm": wire_peak(offset) for offset in (0.0, 0.5e-3)},
    }
    to.write(answer)
    if options.figure is not None:
        figure().savefig(options.figure, dpi=110)


if __name__ == "__main__":
    main()
