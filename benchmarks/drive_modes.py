"""Modes of the drives and experiments: multisine with jog, scan with shaper and observer, and homing, over the whole bus in lockstep.

For each of torque, velocity and position mode the C-arm runs multisines in each of four poses. The frequency responses from effort to
encoders and IMU are compared with the linearisation of its equations: how many lines are within their own 95 % bounds. The bounds are
those of the F distribution, because the covariances have few degrees of freedom. A shaped scan with the observer is compared with its
simulation, and the encoders of an axis with each other after homing.

The fault table is run with the drives in each cyclic mode while roll scans; in the profile modes while it is moved to a pose, at its speed
limit, or at half of it where the loop leads; and while its drive searches a limit switch. Drives in profile modes take no effort here.

    python benchmarks/drive_modes.py
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.signal
import scipy.stats

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from bench_machines import CARM, carm_text_in, homing_at_switch_text

from hil.identification import FrequencyResponse, read_frf
from hil.machine import Machine, machine_from_text
from hil.recording import read_recording
from virtual_bus.physics import Physics

RESULTS = Path(__file__).parent / "results" / "drive_modes.json"
ISOCENTER = [sys.executable, "-m", "hil"]
FAILURES = ("not at rest", "did not end", "unnoticed", "never began")
POSES_deg = ((0.0, 0.0), (0.0, 60.0), (40.0, -30.0), (-60.0, 30.0))
PROBABILITY = 0.95
SCAN = ("--axis", "roll", "--from", "-60", "--to", "60", "--speed", "30", "--dwell", "1")


def isocenter(*arguments: str | Path) -> None:
    """Run a command as a user does."""
    subprocess.run([*ISOCENTER, *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def machine_in(mode: str) -> Machine:
    """Return the C-arm with drives in a mode."""
    return CARM if mode == "torque" else machine_from_text(carm_text_in(mode))


def linearised(machine: Machine, pose: np.ndarray, frequencies_Hz: np.ndarray, outputs: Sequence[str]) -> np.ndarray:
    """Return the response (lines, outputs, axes) of the equations from effort to these channels, sampled, one period late."""
    plant = Physics(machine.plant, noise=False).linearise(pose)
    rows = [plant.output_labels.index(name) for name in outputs]
    columns = [plant.input_labels.index(f"command_{axis}") for axis in machine.axes]
    period_s = 1.0 / machine.sample_rate_Hz
    parts = plant.A, plant.B[:, columns], plant.C[rows], plant.D[np.ix_(rows, columns)]
    a, b, c, d, _ = scipy.signal.cont2discrete(parts, period_s)
    z = np.exp(2j * np.pi * frequencies_Hz * period_s)
    return np.array([(c @ np.linalg.solve(each * np.eye(len(a)) - a, b) + d) / each for each in z])


def inside(found: FrequencyResponse, truth: np.ndarray) -> np.ndarray:
    """Return which lines of which entries (lines, outputs, axes) are within their own bounds."""
    variances = np.real(np.diagonal(found.covariance("total"), axis1=1, axis2=2))
    shape = (len(found.lines), len(found.input_names), len(found.output_names))
    variances = variances.reshape(shape).transpose(0, 2, 1)  # columns of vec(G) are stacked
    most = scipy.stats.f.ppf(PROBABILITY, 2.0, 2.0 * found.total_dof)[:, None, None]
    return np.abs(found.G - truth) ** 2 <= variances * most


def multisine(mode: str, file: Path, folder: Path) -> dict[str, float]:
    """Identify in each pose; return the share of lines within their bounds and the median error."""
    machine, counts, errors = machine_in(mode), [], []
    for number, pose in enumerate(POSES_deg):
        at = ",".join(f"{axis}={value}" for axis, value in zip(machine.axes, pose, strict=True))
        out = folder / f"{mode}{number}.mf4"
        isocenter(
            *("run", "multisine", "-m", file, "-b", "lockstep:", "--pose", at, "--seed", str(number), "-o", out),
            *("--period", "10", "--periods", "3", "--realisations", "6", "--amplitude", "0.6", "--jog", "0.2"),
        )
        isocenter("identify", *sorted(folder.glob(f"{out.stem}_*.mf4")), "--method", "robust_bla", "-o", out.with_suffix(".npz"))
        found = read_frf(out.with_suffix(".npz"))
        truth = linearised(machine, np.radians(pose), found.frequencies_Hz, found.output_names)
        counts.append(inside(found, truth))
        rows = [found.output_names.index(f"position_{axis}") for axis in machine.axes]
        errors.append(np.abs(found.G / truth - 1.0)[:, rows, [0, 1]])
    return {
        "inside": float(np.mean(counts)),
        "lines": int(np.size(counts)),
        "median_error": float(np.median(np.concatenate(errors))),
    }


def scan(mode: str, file: Path, folder: Path) -> dict[str, float]:
    """Run a shaped scan with the observer; compare it with its reference, its simulation and the observer's own statistics."""
    shaper, design, first, recorded = (folder / name for name in ("roll.shaper.npz", "design.npz", "first.mf4", "scan.mf4"))
    common = ("run", "scan", "-m", file, "-b", "lockstep:", *SCAN)
    isocenter("shape", file, "--axis", "roll", "-o", shaper)
    isocenter(*common, "-o", first)
    isocenter("observe", file, first, "-o", folder / "first.npz", "--save-design", design)
    isocenter(*common, "--shaper", shaper, "--observer", design, "-o", recorded)
    isocenter("observe", file, recorded, "--design", design, "-o", folder / "scan.npz", "--json", folder / "scan.json")
    isocenter("simulate", file, recorded, "-o", folder / "simulated.mf4")
    run, simulated = read_recording(recorded), read_recording(folder / "simulated.mf4")
    observed = json.loads((folder / "scan.json").read_text())
    return {
        "rows": run.rows,
        "tracking_rad": float(np.nanmax(np.abs(run["reference_roll"] - run["position_roll"]))),
        "simulation_rad": float(np.nanmax(np.abs(run["position_roll"] - simulated["position_roll"]))),
        "mean_nis": observed["mean_nis"],
        "in_band": observed["share_in_band"],
    }


def homing(mode: str, file: Path, folder: Path) -> dict[str, float]:
    """Check the first move and home every axis; return by how much the encoders of an axis differ at most."""
    isocenter("home", "-m", file, "-b", "lockstep:", "--json", folder / "home.json")
    said = " ".join(json.loads((folder / "home.json").read_text())["checks"])
    return {"encoders_differ_rad": max(float(number) for number in re.findall(r"differ by (\S+) rad", said))}


def faults(mode: str, file: Path, folder: Path) -> dict[str, object]:
    """Run the whole fault table while roll scans."""
    return tried(file, folder, "scan")


def faults_moved(mode: str, file: Path, folder: Path) -> dict[str, object]:
    """Run the fault table while roll is moved to a pose."""
    return tried(file, folder, "move")


def faults_homing(mode: str, file: Path, folder: Path) -> dict[str, object]:
    """Run the fault table while roll's drive searches a limit switch."""
    file.write_text(homing_at_switch_text(file.read_text()))
    return tried(file, folder, "homing")


def tried(file: Path, folder: Path, motion: str) -> dict[str, object]:
    """Run a fault table; return how many rows ended how."""
    command = [*ISOCENTER, "faults", "check", file, "-o", folder / "faults", "--while", motion]
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL)
    return told(json.loads((folder / "faults" / "faults.json").read_text())["faults"])


def told(rows: Sequence[dict[str, Any]]) -> dict[str, object]:
    """Return how many rows of a fault table ended how, and what is wrong with each that fails."""
    over = {row["name"]: words for row in rows if (words := over_budget(row["budget"]))}
    bad = {row["name"]: row["verdict"] for row in rows if row["verdict"] in FAILURES}
    contradicted = {row["name"]: f"said: {'; '.join(row['contradicted'])}" for row in rows if row["contradicted"]}
    return {
        "rows": len(rows),
        **Counter(row["verdict"].replace(" ", "_") for row in rows),
        "over_budget": len(over),
        "contradicted": len(contradicted),
        "failing": {name: {"what": words} for name, words in (over | contradicted | bad).items()},
    }


def over_budget(use: dict[str, Any] | None) -> str:
    """Return in words what a stop took beyond its budget; '' where it kept it or has none."""
    if use is None:
        return ""
    took = (("time_s", "allowed_s", "s"), ("travel", "allowed_travel", "rad"))
    over = [
        f"{'no end' if use[key] is None else f'{use[key]:.2f}'} of {use[allowed]:.2f} {unit}"
        for key, allowed, unit in took
        if use[key] is None or use[key] > use[allowed]
    ]
    return f"{use['name']}: {', '.join(over)}" if over else ""


EXPERIMENTS = multisine, scan, homing, faults
MEASURES: dict[str, tuple[Callable[[str, Path, Path], dict[str, Any]], ...]] = {
    "torque": (*EXPERIMENTS, faults_homing),
    "velocity": EXPERIMENTS,
    "position": EXPERIMENTS,
    "profile_velocity": (faults_moved,),
    "profile_position": (faults_moved,),
}
"""By mode. A homing run is the drive's own motion, the same in every mode."""


def main() -> None:
    """Measure what the file lacks, and write it after every part."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for mode, measures in MEASURES.items():
        own = results.setdefault(mode, {})
        for measure in measures:
            if measure.__name__ in own:
                continue
            with tempfile.TemporaryDirectory() as name:
                file = Path(name) / f"{mode}.toml"
                file.write_text(machine_in(mode).text)
                own[measure.__name__] = measure(mode, file, Path(name))
            print(mode, measure.__name__, own[measure.__name__], flush=True)
            RESULTS.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
