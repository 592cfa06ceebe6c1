"""Shapers on the emulated C-arm, in closed loop over the lockstep bus: how much less it vibrates, and how well it tracks.

    python benchmarks/shaping.py --json shaping.json

Measured from the emulator's truth and the link encoders, sensor noise off (the drives' and encoders' resolution stays): rms of the detector
centre's acceleration between 4 and 20 Hz, and rms of link position minus raw reference.

Sweeps of roll and propeller at 30 and 55 deg/s, jerk-limited, every shaper on the same raw reference, and none at the machine's full
limits. Periodic scans: a raster at constant speed with acceleration-limited turns, whose jerk is not limited (harmonics without end): the
machine's jerk limit is lifted in this benchmark for the unshaped run. Measured over whole periods after two. A raster that keeps the jerk
limit by itself comes after it.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import replace
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
from hil.shaping.plans import Shaped, shape_plan
from hil.shaping.poses import scheduled_poses, subject_at
from hil.shaping.shaper_design import Design, design_all, shaper_of
from hil.shaping.shaper_file import ShaperFile
from virtual_bus.physics import Physics

BAND_Hz = (4.0, 20.0)
SETTLE_PERIODS, PERIODS, LAST = 2, 3, 1  # one more period keeps the filter's edge out of what is measured
ALL = SETTLE_PERIODS + PERIODS + LAST
RASTERS = {"propeller": (np.radians(10.0), 3.0), "roll": (np.radians(20.0), 4.0)}  # amplitude [rad], period [s]
HARMONICS = (1, 3, 5)
LIFTED_JERK_rad_s3 = 350.0
TURN_SHARE = 0.75
NAMES = ("ZV", "ZV all", "notch", "hTDF robust", "hTDF quiet")


def designs_of(machine: Machine, axis: str, aim: Aim, poses: np.ndarray) -> dict[str, Design]:
    """Every candidate by name."""
    physics = Physics(machine.plant, noise=False)
    found = design_all([subject_at(machine, pose, axis, "link", physics) for pose in poses], aim, machine.sample_rate_Hz)
    return {design.name: design for design in found.designs}


def file_of(design: Design, machine: Machine, axis: str, positions: np.ndarray | None = None, over: str = "") -> ShaperFile:
    """A design as a SHAPER file holds it."""
    shaper = shaper_of(design, axis, machine.sample_rate_Hz, (0.0,) if positions is None else positions.tolist(), over)
    return ShaperFile((shaper,), machine.sample_rate_Hz)


def run(machine: Machine, plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Detector centre (N, 3) [m] from the truth and link position minus raw reference (N, axes) of one plan over lockstep."""
    with tempfile.TemporaryDirectory() as folder:
        recording_path, truth_path = Path(folder) / "run.mf4", Path(folder) / "truth.csv"
        with open_bench(machine, BenchOptions("lockstep:", noise=False, truth=truth_path), plan.start_pose) as bench:
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
    sections = scipy.signal.butter(6, BAND_Hz, "bandpass", fs=sample_rate_Hz, output="sos")
    return np.linalg.norm(scipy.signal.sosfiltfilt(sections, accelerations, axis=0), axis=1)


def measured(machine: Machine, plan: Plan, axis: str, rows: slice) -> dict[str, float]:
    """Both measures of one run over some of its rows."""
    centre, error = run(machine, plan)
    size = band_accelerations(centre, machine.sample_rate_Hz)[rows]
    return {
        "vibration_m_s2": float(np.sqrt(np.mean(size**2))),
        "tracking_rms_mdeg": float(np.degrees(np.sqrt(np.mean(error[rows, machine.axis_index(axis)] ** 2))) * 1e3),
    }


def with_factors(table: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """How many times less than without a shaper."""
    none = table["none"]
    for row in table.values():
        row["times_less_vibration"] = none["vibration_m_s2"] / row["vibration_m_s2"]
        row["times_less_error"] = none["tracking_rms_mdeg"] / row["tracking_rms_mdeg"]
    return table


def sweeps(machine: Machine, axis: str, speed_deg_s: float) -> dict[str, dict[str, float]]:
    """One sweep at the nominal pose with every shaper, all on the raw reference that the most demanding one leaves room for."""
    designs = designs_of(machine, axis, sweep(), np.zeros((1, len(machine.axes))))
    scan = Scan(axis, -1.0, 1.0, speed=np.radians(speed_deg_s), dwell_s=1.5)
    files = {name: file_of(designs[name], machine, axis) for name in NAMES}
    shares = {name: _share(Shaped(scan, file).plans(machine)[0]) for name, file in files.items()}
    share = min(shares.values())
    gentle = replace(
        machine, limits=tuple(replace(each, acceleration=share * each.acceleration, jerk=share * each.jerk) for each in machine.limits)
    )
    plan = scan.plans(gentle)[0]
    everything = slice(0, None)
    table = {"none": measured(machine, plan, axis, everything)}
    table |= {name: measured(machine, shape_plan(plan, file, machine), axis, everything) for name, file in files.items()}
    table["none at full limits"] = measured(machine, scan.plans(machine)[0], axis, everything)
    return with_factors(table) | {"raw_limits_used": {"share": share}}


def _share(plan: Plan) -> float:
    """Share of the limits that a shaped plan's raw reference was planned with, from its note."""
    note = next((note for note in plan.notes if note.startswith("raw reference planned")), "with 100%")
    return float(note.split("with ")[1].split("%")[0]) / 100.0


def raster(machine: Machine, axis: str, pose: np.ndarray) -> Plan:
    """Constant speed both ways, turns at three quarters of the acceleration limit, jerk unlimited."""
    amplitude, period_s = RASTERS[axis]
    index, rate = machine.axis_index(axis), machine.sample_rate_Hz
    acceleration, half = TURN_SHARE * machine.limits[index].acceleration, period_s / 2.0
    ramp = (half - np.sqrt(half**2 - 8.0 * amplitude / acceleration)) / 2.0
    times = np.arange(round(half * rate)) / rate
    way = np.where(
        times < ramp,
        0.5 * acceleration * times**2,
        np.where(
            times < half - ramp,
            0.5 * acceleration * ramp**2 + acceleration * ramp * (times - ramp),
            2.0 * amplitude - 0.5 * acceleration * (half - times) ** 2,
        ),
    )
    one = np.concatenate([way, 2.0 * amplitude - way]) - amplitude
    reference = np.tile(pose, (len(one) * ALL, 1))
    reference[:, index] = pose[index] + np.tile(one, ALL)
    start = reference[0].copy()
    metadata = experiment_metadata("scan", period_samples=len(one), settle_periods=SETTLE_PERIODS, periods=PERIODS + LAST, start_pose=start)
    return Plan(machine.axes, reference, reference.copy(), np.zeros_like(reference), None, start, metadata)


def jerk_limited(machine: Machine, axis: str) -> dict[str, dict[str, float]]:
    """The same amplitude at half the machine's limits of acceleration and jerk, back and forth without a pause: room for the shaper."""
    amplitude, _ = RASTERS[axis]
    limit = machine.limits[machine.axis_index(axis)]
    half = (replace(each, acceleration=0.5 * each.acceleration, jerk=0.5 * each.jerk) for each in machine.limits)
    gentle = replace(machine, limits=tuple(half))
    speed = 0.8 * np.sqrt(amplitude * 0.5 * limit.acceleration)
    plan = Scan(axis, -amplitude, amplitude, speed, {}, 0.0, 2 * ALL).plans(gentle)[0]
    aim = periodic(int(plan.metadata["period_samples"]) / machine.sample_rate_Hz, HARMONICS)
    designs = designs_of(machine, axis, aim, np.zeros((1, len(machine.axes))))
    return periodic_scan(machine, plan, axis, {"hTDF quiet": file_of(designs["hTDF quiet"], machine, axis)})


def keeps_limits(machine: Machine, plan: Plan, file: ShaperFile) -> bool:
    """Whether the shaped plan keeps every limit of the machine file, jerk included."""
    try:
        shape_plan(plan, file, machine)
    except ExperimentError:
        return False
    return True


def periodic_scan(machine: Machine, plan: Plan, axis: str, files: dict[str, ShaperFile]) -> dict[str, dict[str, float]]:
    """Every shaper on one periodic scan, over whole periods."""
    period = int(plan.metadata["period_samples"])
    rows = slice(SETTLE_PERIODS * period, (SETTLE_PERIODS + PERIODS) * period)
    table = {"none": measured(machine, plan, axis, rows)}
    for name, file in files.items():
        try:
            table[name] = measured(machine, shape_plan(plan, file, machine), axis, rows)
        except ExperimentError as error:  # a shaper whose shaped reference breaks a limit has no factor
            print(f"{axis}, {name}: {error}", file=sys.stderr)
    return with_factors(table)


def main() -> None:
    """Everything, as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, default=None)
    parser.add_argument("--machine", default="carm")
    arguments = parser.parse_args()
    machine = load_machine(arguments.machine)
    lifted = replace(machine, limits=tuple(replace(each, jerk=LIFTED_JERK_rad_s3) for each in machine.limits))
    nominal = np.zeros((1, len(machine.axes)))
    document: dict = {"sweeps": {}, "rasters": {}, "jerk_limited_rasters": {}, "raster_over_poses": {}}
    for axis in machine.axes:
        for speed in (30.0, 55.0):
            document["sweeps"][f"{axis} {speed:g} deg/s"] = sweeps(machine, axis, speed)
    for axis in machine.axes:
        amplitude, period_s = RASTERS[axis]
        aim = periodic(period_s, HARMONICS)
        designs = designs_of(machine, axis, aim, nominal)
        files = {name: file_of(designs[name], machine, axis) for name in NAMES}
        title = f"{axis} ±{np.degrees(amplitude):g} deg, period {period_s:g} s, harmonics {HARMONICS} tracked"
        plan = raster(lifted, axis, nominal[0])
        table = periodic_scan(lifted, plan, axis, files)
        for name in set(table) & set(files):
            table[name]["keeps_the_machines_own_limits"] = keeps_limits(machine, plan, files[name])
        document["rasters"][title] = table
        document["jerk_limited_rasters"][axis] = jerk_limited(machine, axis)
        document["raster_over_poses"][axis] = over_poses(lifted, axis, aim)
    text = json.dumps(document, indent=2)
    if arguments.json is not None:
        arguments.json.write_text(text + "\n")
    print(text)


def over_poses(machine: Machine, axis: str, aim: Aim) -> dict[str, dict[str, float]]:
    """The raster at poses of the other axis, with one shaper scheduled over it."""
    other = next(name for name in machine.axes if name != axis)
    limit = machine.limits[machine.axis_index(other)]
    poses = scheduled_poses(machine, np.zeros(len(machine.axes)), other)
    file = file_of(designs_of(machine, axis, aim, poses)["hTDF quiet"], machine, axis, poses[:, machine.axis_index(other)], other)
    found = {}
    for value in np.linspace(0.9 * limit.lower, 0.9 * limit.upper, 6):
        pose = np.zeros(len(machine.axes))
        pose[machine.axis_index(other)] = value
        row = periodic_scan(machine, raster(machine, axis, pose), axis, {"hTDF quiet, scheduled": file})
        found[f"{other} {np.degrees(value):.0f} deg"] = row["hTDF quiet, scheduled"] | {"none_m_s2": row["none"]["vibration_m_s2"]}
    return found


if __name__ == "__main__":
    main()
