"""Shapers on both emulated C-arms, in closed loop over the lockstep bus: how much less they vibrate, and how well they track.

    python benchmarks/shaping.py --json benchmarks/results/shaping.json

Measured from the emulator's truth and the link encoders: rms of the detector centre's acceleration between 4 and 20 Hz, and rms of link
position minus raw reference. Shapers are designed from the machine file, which knows of no dry friction. A machine whose effects scatter
from run to run runs with several seeds; rows are means of squares over them.

A move has constant accelerations and speed, without a limit of jerk: residual vibration for two seconds after the shaped reference has
ended, beside the share that the design states. Sweeps at 30 and 55 deg/s keep a third of the limits, jerk too, which leaves room for any
shaper. A raster is the move there and back without a pause, over whole periods after two; at poses of the other axis, too, by one shaper
scheduled over it.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.signal

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import ExperimentError
from hil.experiments import Plan, Scan
from hil.experiments.metadata import experiment_metadata
from hil.machine import Machine, load_machine
from hil.recording import read_recording
from hil.shaping.aim import Aim, periodic, sweep
from hil.shaping.plans import shape_plan
from hil.shaping.poses import scheduled_poses, subject_at
from hil.shaping.shaper_design import Design, design_all, shaper_of
from hil.shaping.shaper_file import ShaperFile
from virtual_bus.physics import Physics

BAND_Hz = (4.0, 20.0)
SETTLE_PERIODS, PERIODS, LAST = 2, 3, 1  # one more period keeps the filter's edge out of what is measured
ALL = SETTLE_PERIODS + PERIODS + LAST
RASTERS = {"propeller": (np.radians(10.0), 3.5), "roll": (np.radians(20.0), 4.8)}  # amplitude [rad], period [s]
AFTER_S = (0.25, 2.25)  # of the end of the shaped reference: what the move itself does to the band is over
DWELL_S = 3.0
STANDS_rad = 1e-7  # a sample: less than an encoder resolves, which a recursive filter comes to
SWEEP_rad = 1.45
HARMONICS = (1, 3, 5)
LIFTED_JERK_rad_s3 = 350.0
TURN_SHARE = 0.55  # leaves room for what harmonic shapers add
GENTLE = 1.0 / 3.0  # what a recommended shaper's gains sum to at most
NAMES = ("ZV", "ZV all", "notch", "hTDF robust", "hTDF quiet")
POSES = 3

Rows = Callable[[Plan, int, float], slice]
"""The rows that count, of a plan, its axis's number and the sample rate."""


@dataclass(frozen=True)
class Case:
    """A raw plan, the machine whose limits it keeps, its shapers' designs, and the rows that are looked at."""

    plan: Plan
    machine: Machine
    designs: dict[str, Design]
    files: dict[str, ShaperFile]
    rows: Rows


def one_way(amplitude: float, acceleration: float, half_s: float, rate_Hz: float) -> np.ndarray:
    """Return positions from 0 to twice the amplitude within a time: constant speed between constant accelerations."""
    ramp = (half_s - np.sqrt(half_s**2 - 8.0 * amplitude / acceleration)) / 2.0
    t = np.arange(round(half_s * rate_Hz)) / rate_Hz
    fast = 0.5 * acceleration * ramp**2 + acceleration * ramp * (t - ramp)
    end = 2.0 * amplitude - 0.5 * acceleration * (half_s - t) ** 2
    return np.where(t < ramp, 0.5 * acceleration * t**2, np.where(t < half_s - ramp, fast, end))


def planned(machine: Machine, pose: np.ndarray, index: int, along: np.ndarray, periods: int) -> Plan:
    """Return the plan of one axis along positions about a pose, over and over."""
    reference = np.tile(pose, (len(along) * periods, 1))
    reference[:, index] += np.tile(along, periods)
    start = reference[0].copy()
    settle = SETTLE_PERIODS if periods > 1 else 0
    metadata = experiment_metadata("scan", period_samples=len(along), settle_periods=settle, periods=periods - settle, start_pose=start)
    return Plan(machine.axes, reference, reference.copy(), np.zeros_like(reference), None, start, metadata)


def after_the_end(plan: Plan, index: int, rate_Hz: float) -> slice:
    """Return the rows after the reference has come to its end."""
    end = int(np.flatnonzero(np.abs(np.diff(plan.reference[:, index])) > STANDS_rad)[-1]) + 1
    return slice(end + round(AFTER_S[0] * rate_Hz), end + round(AFTER_S[1] * rate_Hz))


def whole_periods(plan: Plan, index: int, rate_Hz: float) -> slice:
    """Return the rows of the periods that count."""
    period = int(plan.metadata["period_samples"])
    return slice(SETTLE_PERIODS * period, (SETTLE_PERIODS + PERIODS) * period)


def cases(machine: Machine, axis: str) -> dict[str, Case]:
    """Return what one axis is judged in."""
    index, rate, nominal = machine.axis_index(axis), machine.sample_rate_Hz, np.zeros(len(machine.axes))
    limit, (amplitude, period_s) = machine.limits[index], RASTERS[axis]
    physics = Physics(machine.plant, noise=False)
    lifted = replace(machine, limits=tuple(replace(each, jerk=LIFTED_JERK_rad_s3) for each in machine.limits))
    limits = (replace(each, acceleration=GENTLE * each.acceleration, jerk=GENTLE * each.jerk) for each in machine.limits)
    gentle = replace(machine, limits=tuple(limits))

    def designs(aim: Aim, poses: np.ndarray) -> dict[str, Design]:
        found = design_all([subject_at(machine, pose, axis, "link", physics) for pose in poses], aim, rate)
        return {design.name: design for design in found.designs}

    def case(plan: Plan, of: Machine, made: dict[str, Design], rows: Rows) -> Case:
        files = {name: ShaperFile((shaper_of(made[name], axis, rate),), rate) for name in NAMES}
        return Case(plan, of, made, files, rows)

    way = one_way(amplitude, TURN_SHARE * limit.acceleration, period_s / 2.0, rate)
    raster = np.concatenate([way, 2.0 * amplitude - way]) - amplitude
    stands = np.full(round(DWELL_S * rate), 2.0 * amplitude)
    once, again = designs(sweep(), nominal[None]), designs(periodic(period_s, HARMONICS), nominal[None])
    still = planned(machine, nominal, index, 0.0 * stands, 1)
    found = {"standing": Case(still, machine, {}, {}, lambda *_: slice(round(AFTER_S[0] * rate), round(AFTER_S[1] * rate)))}
    found["move"] = case(planned(lifted, nominal, index, np.concatenate([way, stands]), 1), lifted, once, after_the_end)
    for speed in (30.0, 55.0):
        plan = Scan(axis, -SWEEP_rad, SWEEP_rad, speed=np.radians(speed), dwell_s=1.5).plans(gentle)[0]
        found[f"sweep, {speed:g} deg/s"] = case(plan, machine, once, lambda *_: slice(None))
    found["raster"] = case(planned(lifted, nominal, index, raster, ALL), lifted, again, whole_periods)
    other = 1 - index
    poses = scheduled_poses(machine, nominal, machine.axes[other])
    quiet = designs(periodic(period_s, HARMONICS), poses)["hTDF quiet"]
    scheduled = shaper_of(quiet, axis, rate, poses[:, other].tolist(), machine.axes[other])
    reach = machine.limits[other]
    for value in np.linspace(0.9 * reach.lower, 0.9 * reach.upper, POSES):
        pose = nominal.copy()
        pose[other] = value
        plan = planned(lifted, pose, index, raster, ALL)
        files = {"hTDF quiet, scheduled": ShaperFile((scheduled,), rate)}
        found[f"raster, {machine.axes[other]} {np.degrees(value):.0f} deg"] = Case(plan, lifted, {}, files, whole_periods)
    return found


def run(machine: Machine, plan: Plan, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the detector centre (N, 3) [m] from the truth and link position minus raw reference (N, axes) of one plan over lockstep."""
    with tempfile.TemporaryDirectory() as folder:
        recording_path, truth_path = Path(folder) / "run.mf4", Path(folder) / "truth.csv"
        with open_bench(machine, BenchOptions("lockstep:", seed=seed, truth=truth_path), plan.start_pose) as bench:
            bench.run(plan, recording_path)
        recording = read_recording(recording_path)
        header = truth_path.read_text().split("\n", 1)[0].split(",")
        columns = [header.index(f"pose_detector_{axis} [m]") for axis in "xyz"]
        centre = np.loadtxt(truth_path, delimiter=",", skiprows=1, usecols=columns)
    error = recording.matrix([f"link_position_{axis}" for axis in machine.axes]) - plan.reference_raw
    return centre[: plan.rows], error - error[:8].mean(axis=0)


def band_accelerations(centre: np.ndarray, sample_rate_Hz: float) -> np.ndarray:
    """Size (N,) of the acceleration [m/s^2] within the band, by a filter without phase over the whole run.

    No Fourier lines of the displacement: what little a period fails to close by, times frequency squared, would drown the band.
    """
    accelerations = np.vstack([np.zeros((1, 3)), np.diff(centre, 2, axis=0) * sample_rate_Hz**2, np.zeros((1, 3))])
    sections = scipy.signal.butter(2, BAND_Hz, "bandpass", fs=sample_rate_Hz, output="sos")  # a steeper one rings itself for half a second
    return np.linalg.norm(scipy.signal.sosfiltfilt(sections, accelerations, axis=0), axis=1)


def measured(case: Case, index: int, seeds: int) -> dict[str, dict[str, float]]:
    """Return vibration and tracking error of every shaper, and of none, with the share that is left and the one that the design states."""
    rate, table = case.machine.sample_rate_Hz, {}
    for name, file in {"none": None, **case.files}.items():
        try:
            plan = case.plan if file is None else shape_plan(case.plan, file, case.machine)
        except ExperimentError as error:  # a shaper whose shaped reference breaks a limit has no row
            print(f"{name}: {error}", file=sys.stderr)
            continue
        rows, found = case.rows(plan, index, rate), []
        for seed in range(seeds):
            centre, error = run(case.machine, plan, seed)
            sizes = band_accelerations(centre, rate)[rows], np.degrees(error[rows, index]) * 1e3
            found.append([float(np.mean(each**2)) for each in sizes])
        vibration, tracking = np.sqrt(np.mean(found, axis=0))
        each = np.sqrt(np.array(found)[:, 0])
        table[name] = {"vibration_m_s2": float(vibration), "tracking_mdeg": float(tracking), "scatter_m_s2": float(each.std())}
        table[name]["left"] = table[name]["vibration_m_s2"] / table["none"]["vibration_m_s2"]
        if case.rows is after_the_end and name in case.designs:
            verdict = case.designs[name].verdict
            table[name] |= {"stated": verdict.vibration, "stated_at_10_percent": verdict.vibration_at_10}
    return table


def main() -> None:
    """Run everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", action="append", help="carm, carm-real (both unless given)")
    parser.add_argument("--axis", action="append", help="both unless given")
    parser.add_argument("--case", action="append", help="such as move, or raster; all unless given")
    parser.add_argument("--seeds", type=int, default=3, help="of a machine whose effects scatter")
    parser.add_argument("--json", metavar="FILE", type=Path, required=True, help="the answer; what is in it already is not measured again")
    options = parser.parse_args()
    rows = json.loads(options.json.read_text())["rows"] if options.json.exists() else {}
    for name in options.machine or ["carm", "carm-real"]:
        machine = load_machine(name)
        scatters = any(effect.scatter for effect in machine.own_effects)
        for axis in options.axis or machine.axes:
            for label, case in cases(machine, axis).items():
                if (options.case and label not in options.case) or name in rows.get(f"{axis}, {label}: none", {}):
                    continue
                for shaper, row in measured(case, machine.axis_index(axis), options.seeds if scatters else 1).items():
                    rows.setdefault(f"{axis}, {label}: {shaper}", {})[name] = row
                    print(f"{name}, {axis}, {label}: {shaper}: {row}", file=sys.stderr, flush=True)
                options.json.write_text(json.dumps({"seeds": options.seeds, "rows": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
