"""Ten repeats of a scan seen by the marker plate: displacement of tube against panel, overshoot and spread (thesis Figs. 6.13, 6.14).

    python benchmarks/imaging_repeats.py [--out benchmarks/results/imaging_repeats.json] [--machine carm] [--effects FILE]

Roll from -90 to 90 degrees at 30 degrees/s, and propeller from -120 to 120 at 30 and at 55, through the commands `run scan`, `expose` and
`calibrate marker`, each repeat with noise of its own. Focal spot against panel, relative to the first image, as in the thesis; the angles
are held, which makes the problem linear (Sec. 6.4.1). Overshoot is what the source moves beyond the range it covers while the axis moves
steadily: how far the fast scan's ends swing.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import tempfile
from pathlib import Path

import numpy as np

from hil.calibration.marker.tube_to_panel import LINEAR
from hil.cli.app import main as isocenter
from hil.recording import read_recording

SCANS = {
    "roll, 30 deg/s": ("roll", 90.0, 30.0),
    "propeller, 30 deg/s": ("propeller", 120.0, 30.0),
    "propeller, 55 deg/s": ("propeller", 120.0, 55.0),
}
STEADY = 0.98
"""Share of the full speed above which the axis moves steadily."""


def command(*words: object) -> None:
    """Run a command of the package, its answer left aside."""
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            status = isocenter([str(word) for word in words])
        except SystemExit as end:
            status = end.code
    if status:
        raise SystemExit(f"isocenter {' '.join(map(str, words))}: exit status {status}")


def once(scan: str, seed: int, options: argparse.Namespace, work: Path) -> dict[str, np.ndarray]:
    """Displacement (N, 3) of the source [m], its stated deviation (3,), time and axis position of one repeat."""
    axis, reach, speed = SCANS[scan]
    rec, truth, images, out = (work / f"{seed}{suffix}" for suffix in (".mf4", ".truth.csv", ".images", ".npz"))
    there = ["--axis", axis, f"--from={-reach}", f"--to={reach}", "--speed", speed, "--pose", f"{axis}={-reach}", "--seed", seed]
    physics = ["--effects", options.effects] if options.effects else []
    command("run", "scan", "-m", options.machine, "-b", "lockstep:", "--no-real-time", *there, *physics, "--truth", truth, "-o", rec)
    what = ["--marker", "experimental", "--binning", options.binning, "--rate", options.rate, "--seed", seed]
    command("expose", options.machine, rec, "--truth", truth, *what, "-o", images)
    free = [word for name in LINEAR for word in ("--free", name)]
    command("calibrate", "marker", options.machine, images, *free, "-o", out)
    with np.load(out) as seen:
        values, time_s = seen["values"][:, :3], seen["time_s"]
        sigma = np.sqrt(np.nanmedian(seen["covariance"][:, range(3), range(3)], axis=0))
        position = seen["positions"][:, list(seen["axes"]).index(axis)]
    recording = read_recording(rec, None)
    rate = np.gradient(recording[f"position_{axis}"], recording.time)
    return {
        "moved": (values - values[0]) * np.array([1.0, 1.0, -1.0]),
        "sigma": sigma,
        "time": time_s,
        "position": position,
        "steady": np.abs(np.interp(time_s, recording.time, rate)) > STEADY * np.radians(speed),
    }


def summary(repeats: list[dict[str, np.ndarray]]) -> dict[str, object]:
    """Range, overshoot and spread over the repeats, along u, v, w of the panel."""
    count = min(len(each["time"]) for each in repeats)
    moved = np.array([each["moved"][:count] for each in repeats])
    mean, spread = np.nanmean(moved, axis=0), np.nanstd(moved, axis=0, ddof=1)
    steady = np.all([each["steady"][:count] for each in repeats], axis=0)
    quiet = mean[steady]
    over = np.maximum(np.nanmax(mean, axis=0) - quiet.max(axis=0), quiet.min(axis=0) - np.nanmin(mean, axis=0))
    return {
        "repeats": len(repeats),
        "images": count,
        "range_mm": (1e3 * (np.nanmax(mean, axis=0) - np.nanmin(mean, axis=0))).tolist(),
        "largest_mm": (1e3 * np.nanmax(np.abs(mean), axis=0)).tolist(),
        "overshoot_mm": (1e3 * np.maximum(over, 0.0)).tolist(),
        "spread_largest_mm": (1e3 * spread.max(axis=0)).tolist(),
        "spread_rms_mm": (1e3 * np.sqrt(np.mean(spread**2, axis=0))).tolist(),
        "stated_sigma_mm": (1e3 * np.mean([each["sigma"] for each in repeats], axis=0)).tolist(),
        "axis_deg": np.degrees(repeats[0]["position"][:count]).round(2).tolist(),
        "mean_mm": (1e3 * mean).round(4).tolist(),
        "spread_mm": (1e3 * spread).round(4).tolist(),
    }


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/imaging_repeats.json"))
    parser.add_argument("--machine", default="carm")
    parser.add_argument("--effects", type=Path, default=None, help="physics of the machine, added by name")
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--binning", type=int, default=8)
    parser.add_argument("--scan", choices=SCANS, action="append", help="one of them alone; repeated for several")
    parser.add_argument("--rate", type=float, default=7.0)
    options = parser.parse_args()
    document: dict[str, object] = {"machine": options.machine, "binning": options.binning, "scans": {}}
    for scan in options.scan or SCANS:
        with tempfile.TemporaryDirectory() as work:
            found = summary([once(scan, seed, options, Path(work)) for seed in range(options.repeats)])
        document["scans"][scan] = found  # type: ignore[index]
        print(scan, {key: value for key, value in found.items() if key not in ("axis_deg", "mean_mm", "spread_mm")})
    options.out.write_text(json.dumps(document, indent=None) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
