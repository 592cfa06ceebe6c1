"""The calibration along with the loop, on the shaken C-arm that is built askew and was bumped: `isocenter run scan --data`.

    python benchmarks/calibration_live.py --work FOLDER --json benchmarks/results/calibration_live.json
    python benchmarks/calibration_live.py --work FOLDER --bus udp: --json benchmarks/results/calibration_live_wall.json

FOLDER is that of calibration_side_by_side.py, whose tour, few images and observer of the machine that does not repeat itself are taken. The
bench knows the shipped file; so that it accepts the machine's balance at commissioning, the emulated bodies' centres of mass are put back
by what their frames were shifted. Scored against the truth at every fifth row from the third second on; then the run is replayed, and its
images are taken in afterwards over the whole recording. With --bus the emulated machine and its panel are processes of their own, on the
wall clock; limits of silence are lifted then, and a tick that comes late is put off, as the machine file of an emulated machine may say.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from calibration_side_by_side import ASKEW, UNSEEN, command, machine_text, shaking_text

from hil.calibration.data_driven.data_file import read_data_file
from hil.calibration.data_driven.live import LiveCalibration
from hil.calibration.data_driven.live_file import SIGHTINGS, KeptSightings
from hil.emulated.beam import SPOT
from hil.emulated.images import true_beam, xray_side
from hil.imaging.geometry import DEVIATIONS
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine, load_machine, machine_from_text
from hil.observing import read_design
from hil.recording import read_recording
from hil.terminal.output import Answer

HOT_SINCE_S, FROM_S, EVERY, LAST = 0.1, 3.0, 5, 20
ISOCENTER = [sys.executable, "-m", "hil"]
ATTEMPTS = 8
"""Of commissioning on the wall clock: the shaken machine's first move goes the wrong way where the shaking is just against it."""

PATIENT = {
    "overrun_ticks": '10000\noverrun = "wait"',
    "stale_ticks": "64",
    "heartbeat_s": "1.0",
    "master_heartbeat_s": "0.5",
    "answer_timeout_s": '2.0\nanswers = "awaited"',
    "stale_after_s": "20.0",
}
"""Limits on the wall clock."""

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


def patient(text: str) -> str:
    """The machine file with these limits."""
    for key, value in PATIENT.items():
        text = re.sub(rf"(?m)^{key} = [0-9.]+", f"{key} = {value}", text)
    return text


@contextlib.contextmanager
def emulated(machine: Path, bus: str, *options: object) -> Iterator[None]:
    """The emulated machine and its panel, in processes of their own."""
    told = [*map(str, options), "--panel", "dodecahedron", "--json", "-"]
    command_line = [*ISOCENTER, "emulate", str(machine), "--bus", bus, *told]
    # a session of its own, as in another terminal: where the kernel groups by session, its panel would else get what the loop leaves
    process = subprocess.Popen(command_line, stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert process.stdout is not None and process.stdout.readline(), "the emulator did not start"
        yield
    finally:
        process.terminate()
        process.wait()


def cut(whole: Path, truth: Path, first_s: float, rows: int) -> None:
    """Of a truth file what belongs to a recording, whose IMU says when it began by the emulated machine's clock, to 0.1 ms."""
    header, *lines = whole.read_text(encoding="utf-8").splitlines()
    times = np.array([float(line.split(",", 1)[0]) for line in lines])
    first = int(np.argmin(np.abs(times - first_s)))
    truth.write_text("\n".join([header, *lines[first : first + rows]]) + "\n", encoding="utf-8")


def on_the_wall_clock(folder: Path, bus: str, built: Path, effects: Path, real_time: bool, live: list[object]) -> dict[str, object]:
    """Run between processes: how the loop kept its time, and how late images were."""
    rec, truth, whole, told = (folder / f"live.{name}" for name in ("mf4", "truth.csv", "truth.whole.csv", "run.json"))
    bench = folder / "live.bench.toml"
    bench.write_text(patient(load_machine("carm").text), encoding="utf-8")
    scheduler = [] if real_time else ["--no-real-time"]
    with emulated(built, bus, "--effects", effects, "--seed", 13, "--truth", whole, "--pose", "propeller=25,roll=-90", *scheduler):
        run = ["run", *UNSEEN, "-m", bench, "-b", bus, *scheduler, *live, "-o", rec, "--json", told]
        for _ in range(ATTEMPTS):
            shutil.rmtree(folder / "live.images", ignore_errors=True)
            # a command of its own: processes that this one starts import this file before they do anything
            if not subprocess.run([*ISOCENTER, *map(str, run)], check=False).returncode:
                break
    recording = read_recording(rec, load_machine("carm"))
    cut(whole, truth, float(recording["imu_time"][0]), recording.rows)
    answer = json.loads(told.read_text(encoding="utf-8"))
    with np.load(folder / "live.images" / SIGHTINGS) as seen:
        late = seen["row"] - seen["time_s"] * load_machine("carm").sample_rate_Hz
    p50, p90 = np.percentile(late, [50.0, 90.0])
    return {
        "bus": bus,
        "scheduler": answer["scheduler"],
        "timing": answer["recordings"][0]["timing"],
        "images": {key: value for key, value in answer["calibration"].items() if key not in ("source", "geometry")},
        "late_ticks": {"p50": p50, "p90": p90, "max": late.max()},
    }


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
    parser.add_argument("--bus", metavar="URL", default="lockstep:", help="another one is between processes, on the wall clock")
    parser.add_argument("--rate", metavar="HZ", type=float, default=RATE_Hz, help="exposures a second")
    parser.add_argument("--binning", metavar="N", type=int, default=4, help="N x N pixels of the panel are read as one")
    parser.add_argument("--real-time", action=argparse.BooleanOptionalAction, default=True, help="with --bus, as isocenter run")
    options = parser.parse_args()
    to = Answer(options.json)
    carm, folder = load_machine("carm"), options.work / "not_repeatable"
    built, effects, images = folder / "live.toml", folder / "live.effects.toml", folder / "live.images"
    lockstep = options.bus.startswith("lockstep:")
    built.write_text(balanced_text() if lockstep else patient(balanced_text()), encoding="utf-8")
    effects.write_text(shaking_text(22), encoding="utf-8")
    tour, observer = folder / "tour.mf4", folder / "observer.npz"
    first, known, afterwards = (folder / f"{name}.npz" for name in ("live.first", "live.known", "live.afterwards"))
    if not known.exists():
        command("calibrate", "data", "carm", tour, folder / "tour.few", "-o", first)
        marked = ["--marker", folder / "tour.marker", "--start", first, "--design", observer]
        command("calibrate", "data", "carm", tour, folder / "tour.few", *marked, "-o", known)
    shutil.rmtree(images, ignore_errors=True)
    rec, truth = folder / "live.mf4", folder / "live.truth.csv"
    rec.unlink(missing_ok=True)
    live: list[object] = ["--observer", observer, "--data", known, "--images", images, "--image-rate", options.rate]
    live += ["--image-binning", options.binning]
    wall: dict[str, object] = {}
    if lockstep:
        there = ["-b", options.bus, "--emulated", built, "--effects", effects, "--seed", 13, "--truth", truth]
        command("run", *UNSEEN, "-m", "carm", *there, *live, "-o", rec)
    else:
        wall["wall clock"] = on_the_wall_clock(folder, options.bus, built, effects, options.real_time, live)
    replayed = folder / "live.json"
    command(
        "observe", "carm", rec, "-o", folder / "live.est.npz", "--design", observer, "--data", known, "--images", images, "--json", replayed
    )
    command("calibrate", "data", "carm", rec, images, "--start", known, "--design", observer, "-o", afterwards)
    recording = read_recording(rec, carm)
    rows = np.arange(round(FROM_S * carm.sample_rate_Hz), recording.rows - LAST, EVERY)
    true = true_beam(xray_side(load_machine(str(built)), truth, SPOT, HOT_SINCE_S), rows / carm.sample_rate_Hz, np.zeros(len(rows)))
    nominal = nominal_beam(carm, recording.matrix([f"estimate_link_position_{axis}" for axis in carm.axes])[rows])
    published = recording.matrix([f"deviation_{name}" for name in DEVIATIONS])[rows]
    later = read_data_file(afterwards)
    names = [name for name, _ in read_design(observer).observer().channels]
    answer = wall | {
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
