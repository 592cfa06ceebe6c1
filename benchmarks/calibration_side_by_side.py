"""Every calibration on the same unseen scan of emulated C-arms: one that repeats itself, one that does not, and the hard one.

    python benchmarks/calibration_side_by_side.py --work FOLDER --json benchmarks/results/calibration_side_by_side.json

The emulated machine is built askew by half a millimetre and half a milliradian; the calibrations know the shipped file, recordings and
images. The one that does not repeat itself is shaken in every run by other sinusoids between 5 and 12 Hz at mount, gears and detector, and
its mount is shifted by 0.3 mm before the unseen scan. The hard one is `carm-real`, whose friction, heat and sensors scatter from run to
run by themselves; with both, it is shaken and shifted, too. Its observer has the file's own numbers: its modes, as multisines find them
with its dry friction, are not alike from pose to pose. Steps whose files are in FOLDER are not done again.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from observer_variances import own_design

from hil.calibration.data_driven.calibrate import calibrate_data
from hil.calibration.data_driven.image_measurements import from_marker, from_phantom
from hil.calibration.data_driven.levelled import levelled
from hil.calibration.data_driven.observed_beam import ObservedBeam, observed_beam, unobserved_beam
from hil.calibration.data_driven.quasi_static import QuasiStatic
from hil.calibration.data_driven.values import Calibration, Parameters
from hil.calibration.kinematic.geometric_model import read_calibration
from hil.calibration.marker.scan import calibrate_marker, nominal_marker
from hil.calibration.phantom.phantom_calibration import calibrate_phantom
from hil.calibration.use.roadmap import overlay
from hil.cli import main as isocenter
from hil.emulated.beam import SPOT
from hil.emulated.images import true_beam, xray_side
from hil.emulated.scenes import scene
from hil.experiments import Static
from hil.identification import read_frf, write_frf
from hil.imaging.geometry import ConeBeam
from hil.imaging.markers import PLATES
from hil.imaging.nominal import nominal_beam
from hil.imaging.phantoms import dodecahedron
from hil.imaging.scan_folder import ImageScan, read_scan
from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, observe, read_design, tune, write_design
from hil.observing.over_poses import axis_grid
from hil.observing.simulated_recordings import emulated_recording, emulated_responses
from hil.reconstruction.fdk import line_integrals, reconstruct
from hil.reconstruction.wire_profiles import wire_quality
from hil.recording import Channel, Recording, read_recording
from hil.simulation import Simulator
from hil.terminal.output import Answer
from hil.verbs.observe import design_observer

HOT_SINCE_S = 0.1  # isocenter expose's first exposure
ASKEW = {
    "ceiling_mount": ((0.6e-3, -0.8e-3, 0.5e-3), (0.03, -0.04, 0.05)),
    "roll_rotor": ((0.3e-3, 0.7e-3, -0.5e-3), (0.05, 0.0, -0.04)),
    "tube": ((0.5e-3, -0.6e-3, 0.8e-3), None),
    "detector": ((-0.7e-3, 0.4e-3, -0.9e-3), (0.06, -0.05, 0.1)),
}
"""How the machine was built: shift [m] and turn [deg] of a body against the drawing."""

BUMP_M = (0.18e-3, 0.20e-3, -0.13e-3)  # 0.3 mm
SHAKEN_Nm = {"ceiling_mount": 40.0, "sleeve": 1.5, "c_arc": 1.5, "detector": 2.0}  # rms; what homing still accepts
SHAKEN_Hz = (5.0, 12.0)
UNSEEN = ["scan", "--axis", "roll", "--from", "-90", "--to", "90", "--pose", "propeller=25"]
SWEEP_S = 6.4
FEW_Hz, RATE_Hz, WIRES_Hz, MODEL_Hz = 0.165, 7.0, 15.0, 1.0
FEW = 20


class Kind(NamedTuple):
    """A machine: the shipped file that the calibrations know, and whether runs are shaken and the mount is shifted before the last."""

    known: str
    shaken: bool


KINDS = {
    "repeatable": Kind("carm", shaken=False),
    "not_repeatable": Kind("carm", shaken=True),
    "real": Kind("carm-real", shaken=False),
    "real_not_repeatable": Kind("carm-real", shaken=True),
}


def machine_text(known: str, bump: bool) -> str:
    """A shipped machine file with its bodies askew."""
    text = load_machine(known).text
    for body, (shift, turn) in ASKEW.items():
        first = text.index("position_m = [", text.index(f'name = "{body}"'))
        last = text.index("]", first)
        nominal = [float(value) for value in text[first:last].split("[")[1].split(",")]
        bumped = BUMP_M if bump and body == "ceiling_mount" else (0.0, 0.0, 0.0)
        place = [round(a + b + c, 9) for a, b, c in zip(nominal, shift, bumped, strict=True)]
        line = f"position_m = {place}" + (f"\norientation_deg = {list(turn)}" if turn else "")
        text = text[:first] + line + text[last + 1 :]
    return text


def shaking_text(seed: int) -> str:
    """Effects file of one run's disturbances: a sinusoid at every body."""
    generator, text = np.random.default_rng(seed), ""
    for body, rms in SHAKEN_Nm.items():
        values = rms * np.sqrt(2.0), generator.uniform(*SHAKEN_Hz), generator.uniform(-np.pi, np.pi)
        text += f'[[effect]]\nname = "base_motion"\nat = "{body}"\nA_Nm = %r\nf_Hz = %r\nphi_rad = %r\n' % tuple(map(float, values))
    return text


class Work:
    """One machine's files."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.known, self.shaken = KINDS[kind]
        self.folder, self.shared = folder / kind, folder / self.known  # what machines of one file have alike
        for each in (self.folder, self.shared):
            each.mkdir(parents=True, exist_ok=True)
        self.carm = load_machine(self.known)
        for name, bump in (("before", False), ("after", True)):
            (self.shared / f"{name}.toml").write_text(machine_text(self.known, bump), encoding="utf-8")

    def run(self, name: str, experiment: list[str], seed: int, after: bool = False) -> Path:
        """Recording and truth of one run."""
        out = self.folder / f"{name}.mf4"
        if not out.exists():
            more = []
            if self.shaken:
                effects = self.folder / f"{name}.effects.toml"
                effects.write_text(shaking_text(seed), encoding="utf-8")
                more = ["--effects", effects]
            machine = self.machine_file(after)
            kept = ["-b", "lockstep:", "--seed", seed, "--truth", out.with_suffix(".truth.csv"), "-o", out]
            command("run", *experiment, "-m", machine, *kept, *more)
        return out

    def machine_file(self, after: bool) -> Path:
        return self.shared / ("after.toml" if after and self.shaken else "before.toml")

    def images(self, name: str, what: str, rate_Hz: float, *options: object, after: bool = False) -> ImageScan:
        """Images of a run."""
        out = self.folder / f"{name}.{what}"
        if not (out / "exposures.csv").exists():
            rec = self.folder / f"{name}.mf4"
            shown = ["--truth", rec.with_suffix(".truth.csv"), "--rate", rate_Hz, "-o", out, *options]
            command("expose", self.machine_file(after), rec, *shown)
        return read_scan(out)

    def recording(self, name: str) -> Recording:
        return read_recording(self.folder / f"{name}.mf4", self.carm)

    def truth(self, name: str, scan: ImageScan, after: bool = False) -> ConeBeam:
        side = xray_side(load_machine(str(self.machine_file(after))), self.folder / f"{name}.truth.csv", SPOT, HOT_SINCE_S)
        return true_beam(side, scan.start_s, scan.width_s)


def command(*arguments: object) -> None:
    """One isocenter command in this process."""
    try:
        isocenter([str(argument) for argument in arguments])
    except SystemExit as ended:
        if ended.code:
            raise


def responses(folder: Path, machine: Machine) -> tuple[list, list[Recording]]:
    """Frequency responses and standing records of the machine as built, undisturbed."""
    grids = {axis: axis_grid(machine, k, n) for k, (axis, n) in enumerate(zip(machine.axes, (5, 11), strict=True))}
    poses = [dict(zip(grids, pose, strict=True)) for pose in product(*grids.values())]
    files = [folder / "responses" / f"{k}.npz" for k in range(len(poses))]
    built = load_machine(str(folder / "before.toml"))
    if not all(file.exists() for file in files):
        files[0].parent.mkdir(exist_ok=True)
        for file, response in zip(files, emulated_responses(built, poses), strict=True):
            write_frf(response, file)
    simulator = Simulator(built)
    standing = [emulated_recording(built, Static(4.0, pose).plans(built)[0], 500 + k, simulator) for k, pose in enumerate(poses)]
    return [read_frf(file) for file in files], standing


def designed(work: Work, first: Parameters, model: QuasiStatic) -> ObserverDesign:
    """The observer, identified and tuned; where dry friction spoils that, with the file's own numbers and its effects as noise."""
    machine = work.carm
    if machine.own_effects:
        return own_design(machine, told=True)
    measured, standing = responses(work.shared, machine)
    design = design_observer(machine, measured, standing=[levelled(machine, each, model, first.values) for each in standing])
    tuned = tune(design.model, design.noise, [levelled(machine, work.recording("before"), model, first.values)])
    return dataclasses.replace(design, noise=tuned.noise)


def fitted(work: Work, scan: ImageScan, observed: ObservedBeam) -> list:
    """Phantom images as measurements."""
    positions, _, _ = observed.at(scan.middle_s)
    fit = calibrate_phantom(scan, dodecahedron(), nominal_beam(work.carm, positions))
    return from_phantom(work.carm, scan, fit, observed)


def plate(work: Work, scan: ImageScan) -> list:
    """Marker images as measurements."""
    nominal = nominal_marker(nominal_beam(work.carm, scan.positions), 1e-3 * float(scan.notes["marker_distance_mm"]))
    return from_marker(scan, calibrate_marker(scan, PLATES[str(scan.notes["marker"])](), nominal))


def looked_at(work: Work, name: str, design, parameters: Parameters, model: QuasiStatic) -> ObservedBeam:  # type: ignore[no-untyped-def]
    """The observer over a recording whose inertial measurements are levelled."""
    recording = levelled(work.carm, work.recording(name), model, parameters.values)
    estimate = observe(recording, design.observer())
    columns = zip(estimate.names, estimate.units, estimate.values.T, strict=True)
    return observed_beam(work.carm, Recording({**recording.channels, **{each: Channel(unit, v) for each, unit, v in columns}}, {}))


def scored(true: ConeBeam, beam: ConeBeam, detector) -> dict[str, object]:  # type: ignore[no-untyped-def]
    """Errors [mm, mrad] over the exposures, and overlay errors [mm]."""
    error = 1e3 * beam.deviation_from(true)

    def rms(columns: slice) -> float:
        return float(np.sqrt(np.mean(np.sum(error[:, columns] ** 2, axis=1))))

    table = {place: {name: 1e3 * value for name, value in row.items()} for place, row in overlay(true, beam, detector).table.items()}
    return {
        "source_mm": rms(slice(0, 3)),
        "phantom_mm": rms(slice(3, 6)),
        "rotation_mrad": rms(slice(6, 9)),
        "each": np.sqrt(np.mean(error**2, axis=0)).tolist(),
        "source_displacement_error_mm": error[:, :3].std(axis=0).tolist(),  # about the scan's mean: where the plate is mounted is not in it
        "overlay_mm": table,
    }


def wires(work: Work, label: str, scan: ImageScan, beam: ConeBeam) -> dict[str, float]:
    """Peaks [1/m] and places [mm] of the wires in the reconstruction; kept in the work folder."""
    file = work.folder / "wires.json"
    kept = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    if label not in kept:
        kept[label] = wire_figures(scan, beam)
        file.write_text(json.dumps(kept), encoding="utf-8")
    return kept[label]


def wire_figures(scan: ImageScan, beam: ConeBeam) -> dict[str, float]:
    """Reconstruct and look."""
    images = np.array([line_integrals(scan.frame(k)) for k in range(len(scan))])
    volume = reconstruct(images, scan.detector, beam, 128, 0.5e-3)
    rods = scene("wires-1mm")
    found = {axis: wire_quality(volume, rod.start_m, rod.end_m, rod.attenuation_1_m) for axis, rod in zip("xyz", rods, strict=True)}
    peaks = {f"peak_{axis}_1_m": quality.peak_1_m for axis, quality in found.items()}
    return peaks | {f"off_{axis}_mm": 1e3 * float(np.linalg.norm(quality.offset_m)) for axis, quality in found.items()}


def side_by_side(folder: Path, kind: str, say: Callable[[str], None]) -> dict[str, object]:
    """All calibrations on one machine."""
    work, began = Work(folder, kind), time.perf_counter()
    machine = work.carm
    model = QuasiStatic.of(machine)
    tour = work.shared / "tour.toml"
    if not tour.exists():
        command("calibrate", "scan", work.known, "-o", tour)
    work.run("tour", [str(tour)], 11)
    work.run("before", UNSEEN, 12)
    work.run("unseen", UNSEEN, 13, after=True)
    few, few_marked = work.images("tour", "few", FEW_Hz), work.images("tour", "marker", FEW_Hz, "--marker", "experimental")
    phantom = work.images("unseen", "phantom", RATE_Hz, after=True)
    marked = work.images("unseen", "marker", RATE_Hz, "--marker", "experimental", after=True)
    thin = work.images("unseen", "wires", WIRES_Hz, "--scene", "wires-1mm", after=True)
    work.images("before", "phantom", RATE_Hz)
    work.images("tour", "phantom", MODEL_Hz)
    say(f"images after {time.perf_counter() - began:.0f} s")
    for name, made in (("lookup", ["phantom", work.known, "before.phantom"]), ("model", ["model", work.known, "tour.phantom"])):
        if not (work.folder / f"{name}.npz").exists():
            command("calibrate", made[0], made[1], work.folder / made[2], "-o", work.folder / f"{name}.npz")
    say(f"look-up and model after {time.perf_counter() - began:.0f} s")
    # Quasi-static parameters from few images of the tour, first without an observer; with them the observer is designed
    plain = unobserved_beam(machine, work.recording("tour"))
    first = calibrate_data(model, plain, fitted(work, few, plain), Parameters.unknown(model)).parameters
    made = work.folder / "observer.npz"
    if not made.exists():
        write_design(designed(work, first, model), made)
    design = read_design(made)
    say(f"observer after {time.perf_counter() - began:.0f} s")
    on_tour = looked_at(work, "tour", design, first, model)
    seen = fitted(work, few, on_tour) + plate(work, few_marked)
    known = calibrate_data(model, on_tour, sorted(seen, key=lambda each: each.time_s), Parameters.unknown(model))
    on_scan = looked_at(work, "unseen", design, known.parameters, model)
    images, plates = fitted(work, phantom, on_scan), plate(work, marked)
    aged = known.parameters.aged(model)

    def data(measurements: list, **options: int) -> Calibration:
        return calibrate_data(model, on_scan, sorted(measurements, key=lambda each: each.time_s), aged, **options)  # type: ignore[arg-type]

    quiet = unobserved_beam(machine, work.recording("unseen"))
    found: dict[str, tuple[ObservedBeam, np.ndarray]] = {
        "quasi-static parameters alone": (quiet, calibrate_data(model, quiet, [], known.parameters).final)
    }
    runs = {
        "data-driven, images": data(images),
        f"data-driven, images withdrawn after {FEW}": data(images, most=FEW),
        "data-driven, no image since the tour": data([]),
        f"marker-augmented, images withdrawn after {FEW}": data(images + plates, most=FEW),
        "marker-augmented, no phantom since the tour": data(plates),
    }
    for name, run in runs.items():
        found[name] = (on_scan, run.final)
        if name != "data-driven, no image since the tour":
            found[f"{name}, live"] = (on_scan, run.live)
    rows: dict[str, Callable[[ImageScan], ConeBeam]] = {"nominal": lambda scan: nominal_beam(machine, scan.positions)}
    for name, label in (("lookup", "phantom look-up"), ("model", "model-based")):
        table = read_calibration(work.folder / f"{name}.npz", machine)
        rows[label] = lambda scan, table=table: nominal_beam(machine, scan.positions).moved(table.at(scan.positions))  # type: ignore[misc]
    for label, (observed, deviation) in found.items():
        rows[label] = lambda scan, observed=observed, deviation=deviation: at(machine, observed, deviation, scan)  # type: ignore[misc]
    true, true_thin = work.truth("unseen", phantom, after=True), work.truth("unseen", thin, after=True)
    table = {"true geometry": {"wires": wires(work, "true geometry", thin, true_thin)}}
    for label, beam in rows.items():
        table[label] = scored(true, beam(phantom), phantom.detector)  # type: ignore[assignment]
        if not label.endswith("live"):
            table[label]["wires"] = wires(work, label, thin, beam(thin))  # type: ignore[assignment]
        say(f"{label}: " + ", ".join(f"{name} {value:.3f}" for name, value in table[label].items() if isinstance(value, float)))
    changes = {name: {"used": len(run.used), "refused": run.refused, "changes": run.changes} for name, run in runs.items()}
    sigma = {name: np.median(run.sigma, axis=0).tolist() for name, run in runs.items()}
    return {"rows": table, "images": changes, "sigma": sigma, "tour": convergence(work, model, on_tour, seen, phantom, true)}


def at(machine: Machine, observed: ObservedBeam, deviation: np.ndarray, scan: ImageScan) -> ConeBeam:
    """Geometry of exposures from that of samples."""
    positions, found, _ = dataclasses.replace(observed, deviation=deviation).at(scan.middle_s)
    return nominal_beam(machine, positions).moved(found)


def around(observed: ObservedBeam, time_s: float) -> ObservedBeam:
    """The samples next to an instant: all that one image needs."""
    middle = int(np.searchsorted(observed.time_s, time_s))
    near = slice(max(0, middle - 8), middle + 8)
    arrays = {name: getattr(observed, name)[near] for name in ("time_s", "positions", "deviation", "load")}
    return dataclasses.replace(observed, **arrays)


def convergence(
    work: Work, model: QuasiStatic, on_tour: ObservedBeam, seen: list, scan: ImageScan, true: ConeBeam
) -> dict[str, list[dict[str, float]]]:
    """Held-out error of the parameters on the unseen scan after every image: poses interleaved, and one sweep after the other."""
    quiet = unobserved_beam(work.carm, work.recording("unseen"))
    phantoms = [each for each in seen if each.kind == "phantom"]
    mixed = np.argsort(np.arange(len(phantoms)) * 7 % len(phantoms), kind="stable")
    result: dict[str, list[dict[str, float]]] = {}
    for label, order in (("interleaved", mixed), ("in the tour's order", np.arange(len(phantoms)))):
        result[label] = []
        parameters = Parameters.unknown(model)
        for k in order:
            parameters = calibrate_data(model, around(on_tour, phantoms[k].time_s), [phantoms[k]], parameters).parameters
            beam = at(work.carm, quiet, calibrate_data(model, quiet, [], parameters).final, scan)
            score = scored(true, beam, scan.detector)
            result[label].append({name: float(score[name]) for name in ("source_mm", "phantom_mm", "rotation_mrad")})  # type: ignore[arg-type]
    return result


def workload() -> dict[str, object]:
    """Seconds of acquisition for a stated workload: two axes, two speeds, five poses of the other axis each."""
    scans, positions = 2 * 2, 5
    settle_s, tour_s = 20.0, 127.0
    by_phantom = scans * positions * 2.0 * (SWEEP_S + 2.0 + settle_s)
    return {
        "workload": "look-up tables of 2 axes x 2 speeds x 5 poses of the other axis, both ways, 20 s to bring about each sweep; one tour",
        "phantom_s": by_phantom,
        "tour_s": tour_s,
        "times": by_phantom / tour_s,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", metavar="FOLDER", type=Path, required=True, help="recordings and images; kept")
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    parser.add_argument("--only", choices=KINDS, help="one machine alone")
    options = parser.parse_args()
    to = Answer(options.json)
    options.work.mkdir(parents=True, exist_ok=True)
    answer: dict[str, object] = {"workload": workload()}
    for name in KINDS:
        if options.only not in (None, name):
            continue
        kept = options.work / f"{name}.json"
        if not kept.exists():
            found = side_by_side(options.work, name, lambda text: print(text, file=sys.stderr, flush=True))
            kept.write_text(json.dumps(found), encoding="utf-8")
        answer[name] = json.loads(kept.read_text(encoding="utf-8"))
    to.write(answer)


if __name__ == "__main__":
    main()
