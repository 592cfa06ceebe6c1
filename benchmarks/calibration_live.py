"""The calibration along with the loop, on the shaken C-arm that is built askew and was bumped: `isocenter run scan --data`.

    python benchmarks/calibration_live.py --work FOLDER --json benchmarks/results/calibration_live.json

FOLDER is that of calibration_side_by_side.py, whose tour, few images and observer of the machine that does not repeat itself are taken. The
bench knows the shipped file; so that it accepts the machine's balance at commissioning, the emulated bodies' centres of mass are put back
by what their frames were shifted. Scored against the truth at every fifth row from the third second on; then the run is replayed, and its
images are taken in afterwards over the whole recording.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from pathlib import Path

import numpy as np
from calibration_side_by_side import ASKEW, UNSEEN, command, machine_text, shaking_text

from hil.calibration.data_file import read_data_file
from hil.calibration.live import LiveCalibration
from hil.calibration.live_file import SIGHTINGS, KeptSightings
from hil.cli.output import Answer
from hil.imaging.emulated import SPOT, true_beam, xray_side
from hil.imaging.geometry import DEVIATIONS
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine, load_machine, machine_from_text
from hil.observing import read_design
from hil.recording import read_recording

HOT_SINCE_S, FROM_S, EVERY, LAST = 0.1, 3.0, 5, 20
RATE_Hz = 7.236
"""Exposures a second: 35.4 ticks apart, so that a minute's pulses meet the ticks in many phases."""


def balanced_text() -> str:
    """The machine askew and bumped, its balance as in the shipped file."""
    text = machine_text(bump=True)
    tree = machine_from_text(text, label="askew").plant.tree
    order = [body.name for body in tree.bodies]
    mass = {body.name: body.mass_kg for body in tree.bodies}
    carried = sum(mass[name] for name in order[order.index("roll_rotor") :])
    back = {name: (name, 1.0) for name in ("tube", "detector")} | {"roll_rotor": ("sleeve", carried / mass["sleeve"])}
    for moved, (body, times) in back.items():
        first = text.index("center_of_mass_m = [", text.index(f'name = "{body}"'))
        last = text.index("]", first)
        center = [float(value) for value in text[first:last].split("[")[1].split(",")]
        put = [round(a - times * b, 9) for a, b in zip(center, ASKEW[moved][0], strict=True)]
        text = text[:first] + f"center_of_mass_m = {put}" + text[last + 1 :]
    return text


def scored(true, beam) -> dict[str, object]:  # type: ignore[no-untyped-def]
    """Rms errors [mm, mrad]; of the source's displacement about the scan's mean."""
    error = 1e3 * beam.deviation_from(true)
    rms = {
        name: float(np.sqrt(np.mean(np.sum(error[:, k : k + 3] ** 2, axis=1))))
        for k, name in ((0, "source"), (3, "phantom"), (6, "rotation"))
    }
    return {**rms, "source_displacement": error[:, :3].std(axis=0).tolist()}


def step_time(machine: Machine, start: Path, observer: Path, images: Path, rows: np.ndarray) -> dict[str, float]:
    """Processor time [us] of the calibration's step, without and with an image."""
    kept = KeptSightings(images / SIGHTINGS)
    live = LiveCalibration(machine, read_data_file(start), read_design(observer).observer(), kept, kept.until_m, kept.poses)
    live.restart(len(rows))
    taken = []
    for k, row in enumerate(rows):
        began, before = time.process_time_ns(), live.used
        live.step(k, row)
        taken.append((1e-3 * (time.process_time_ns() - began), live.used > before))
    alone, with_image = (np.array([each for each, image in taken if image is wanted]) for wanted in (False, True))
    return {"row_median_us": float(np.median(alone)), "image_median_us": float(np.median(with_image))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", metavar="FOLDER", type=Path, required=True, help="of calibration_side_by_side.py")
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    options = parser.parse_args()
    to = Answer(options.json)
    carm, folder = load_machine("carm"), options.work / "not_repeatable"
    built, effects, images = folder / "live.toml", folder / "live.effects.toml", folder / "live.images"
    built.write_text(balanced_text(), encoding="utf-8")
    effects.write_text(shaking_text(22), encoding="utf-8")
    tour, observer = folder / "tour.mf4", folder / "observer.npz"
    first, known, afterwards = (folder / f"{name}.npz" for name in ("live.first", "live.known", "live.afterwards"))
    command("calibrate", "data", "carm", tour, folder / "tour.few", "-o", first)
    marked = ["--marker", folder / "tour.marker", "--start", first, "--design", observer]
    command("calibrate", "data", "carm", tour, folder / "tour.few", *marked, "-o", known)
    shutil.rmtree(images, ignore_errors=True)
    rec, truth = folder / "live.mf4", folder / "live.truth.csv"
    rec.unlink(missing_ok=True)
    live = ["--observer", observer, "--data", known, "--images", images, "--image-rate", RATE_Hz]
    emulated = ["-b", "lockstep:", "--emulated", built, "--effects", effects, "--seed", 13, "--truth", truth]
    command("run", *UNSEEN, "-m", "carm", *emulated, *live, "-o", rec)
    replayed = folder / "live.json"
    command(
        "observe", "carm", rec, "-o", folder / "live.est.npz", "--design", observer, "--data", known, "--images", images, "--json", replayed
    )
    command("calibrate", "data", "carm", rec, images, "--start", known, "--design", observer, "-o", afterwards)
    recording = read_recording(rec, carm)
    rows = np.arange(round(FROM_S * carm.sample_rate_Hz), recording.rows - LAST, EVERY)
    true = true_beam(xray_side(load_machine(str(built)), truth, SPOT, HOT_SINCE_S), recording.time[rows], np.zeros(len(rows)))
    nominal = nominal_beam(carm, recording.matrix([f"estimate_link_position_{axis}" for axis in carm.axes])[rows])
    published = recording.matrix([f"deviation_{name}" for name in DEVIATIONS])[rows]
    later = read_data_file(afterwards)
    names = [name for name, _ in read_design(observer).observer().channels]
    answer = {
        "nominal": scored(true, nominal),
        "live, row by row": scored(true, nominal.moved(published)),
        "live, parameters of the end": scored(true, nominal.moved(read_data_file(images / "geometry.npz").final[rows])),
        "afterwards, as known at each row": scored(true, nominal.moved(later.live[rows])),
        "afterwards, parameters of the end": scored(true, nominal.moved(later.final[rows])),
        "images": int(recording["deviation_images"][-1]),
        "replay": json.loads(replayed.read_text(encoding="utf-8"))["live"],
        "step": step_time(carm, known, observer, images, recording.matrix(names)),
    }
    to.write(answer)


if __name__ == "__main__":
    main()
