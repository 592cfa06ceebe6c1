"""Faults that make the observer's estimate worse than it states, and whether its alarm tells within a second.

    python benchmarks/observer_alarms.py --json benchmarks/results/observer_alarms.json

The design of `observer_variances --own-model` and its machines, on roll scans at 30 deg/s. A sensor's fault begins three seconds after the
scan's beginning; it is added to the recording. What is wrong with the structure is so from the beginning. How often the true error passes
twice what is stated counts from the fault on, how often the alarm is in time and how often false as in `observer_variances`.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys

from observer_scan import SKIPPED_S, shaken_scan
from observer_variances import FIRST_SEED, Told, errors_and_variances, own_design, scans, told
from on_engine import add_scheduler, answers

from hil.experiments.plan import Plan
from hil.machine import Machine, load_machine
from hil.machine.drawn import drawn, typical
from hil.observing import ObserverDesign, observe
from hil.observing.true_scan import TrueScan, nine
from hil.recording import Recording
from hil.terminal.output import Answer

AT_s = 3.0
SENSORS: dict[str, dict[str, float]] = {
    "accelerometers of the detector, 0.3 m/s^2 in x and y": {"imu_x": 0.3, "imu_y": 0.3},
    "gyro of the detector, 0.02 rad/s": {"gyro_y": 0.02},
    "accelerometer at the source, 0.5 m/s^2": {"imu_source_x": 0.5},
    "link encoder of roll slips 1 mrad": {"link_position_roll": 1e-3},
    "link encoder of propeller slips 1 mrad": {"link_position_propeller": 1e-3},
    "motor encoder of roll slips 1 mrad": {"position_roll": 1e-3},
}
"""Added to channels."""

STRUCTURE = {
    "shaken five times as much": (5.0, 1.0, 1.0),
    "detector's mount a third as stiff, shaken": (1.0, 1.0 / 3.0, 1.0),
    "detector's mount a third as stiff, quiet": (0.0, 1.0 / 3.0, 1.0),
    "detector half as heavy again, quiet": (0.0, 1.0, 1.5),
}
"""Loudness of the shaking, stiffness of the detector's mount and its mass over the design's."""


def changed(machine: Machine, stiffness: float, mass: float) -> Machine:
    """Return the machine with another stiffness of its detector's mount, and another mass of the detector."""
    bodies = []
    for body in machine.plant.tree.bodies:
        if body.name == "detector" and body.joint is not None:
            joint = dataclasses.replace(body.joint, stiffness=stiffness * body.joint.stiffness)
            body = dataclasses.replace(body, joint=joint, mass_kg=mass * body.mass_kg)
        bodies.append(body)
    tree = dataclasses.replace(machine.plant.tree, bodies=tuple(bodies))
    return dataclasses.replace(machine, plant=dataclasses.replace(machine.plant, tree=tree))


def spoilt(recording: Recording, added: dict[str, float], at_s: float = AT_s) -> Recording:
    """Return the recording with something added to channels from a time on."""
    channels, late = dict(recording.channels), recording["time"] >= at_s
    for name, size in added.items():
        channels[name] = dataclasses.replace(channels[name], values=channels[name].values + size * late)
    return Recording(channels, recording.metadata)


def judged(machine: Machine, design: ObserverDesign, scan: TrueScan, recording: Recording, from_s: float) -> Told:
    """Return what the alarm tells of a recording of a scan."""
    first, rate_Hz = round(SKIPPED_S * machine.sample_rate_Hz), machine.sample_rate_Hz
    assert machine.geometry is not None
    truth = nine(scan.position, scan.rotation, scan.source, machine.geometry.isocenter_m)[first:]
    estimate = observe(recording, design.observer())
    error, variance = errors_and_variances(estimate, truth, first)
    return told(error, variance, estimate["estimate_alarm"][first:], rate_Hz, max(round(from_s * rate_Hz) - first, 0))


def row(found: list[Told], rate_Hz: float) -> dict[str, float | None]:
    """Return a table's row of many scans."""
    passed, in_time = sum(each.passed for each in found), sum(each.in_time for each in found)
    return {
        "scans": len(found),
        "passed_twice": passed,
        "in_time": in_time,
        "in_time_share": in_time / passed if passed else None,
        "false_alarms_in_ten_minutes": 600.0 * rate_Hz * sum(each.false for each in found) / sum(each.of for each in found),
        "alarm_share": sum(each.rows for each in found) / sum(each.of for each in found),
    }


@functools.cache
def designed(name: str) -> tuple[Machine, ObserverDesign, Plan]:
    """Return a machine, its own design and the scan."""
    machine = load_machine(name)
    return machine, own_design(typical(machine), told=True), scans(machine)["roll 30 deg/s, quiet"][0]


def told_of(name: str, number: int, seeds: int) -> dict[str, tuple[int, ...]]:
    """Return what the alarm tells of every fault of one drawn machine."""
    machine, design, plan = designed(name)
    each, seed = drawn(machine, number, seeds), FIRST_SEED + number
    found: dict[str, Told] = {}
    for loudness, kind in ((0.0, "quiet"), (1.0, "shaken")):
        scan = shaken_scan(each, plan, seed, loudness)
        found[f"nothing, {kind}"] = judged(machine, design, scan, scan.recording, 0.0)
        for fault, added in SENSORS.items():
            if all(channel in scan.recording for channel in added):
                found[f"{fault}, {kind}"] = judged(machine, design, scan, spoilt(scan.recording, added), AT_s)
    for fault, (loudness, stiffness, mass) in STRUCTURE.items():
        scan = shaken_scan(changed(each, stiffness, mass), plan, seed, loudness)
        found[fault] = judged(machine, design, scan, scan.recording, 0.0)
    print(f"{name}, {number} of {seeds}", file=sys.stderr, flush=True)
    return {fault: dataclasses.astuple(one) for fault, one in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", action="append", help="carm, carm-real (both unless given)")
    parser.add_argument("--seeds", type=int, default=20, help="and machines, per fault")
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    add_scheduler(parser)
    options = parser.parse_args()
    to = Answer(options.json)
    rows: dict[str, dict[str, float | None]] = {}
    for name in options.machine or ["carm", "carm-real"]:
        draws = [{"name": name, "number": number, "seeds": options.seeds} for number in range(options.seeds)]
        found: dict[str, list[Told]] = {}
        for of_machine in answers(told_of, draws, options.scheduler):
            for fault, values in of_machine.items():
                found.setdefault(fault, []).append(Told(*values))
        rows |= {f"{name}: {fault}": row(scans_of, load_machine(name).sample_rate_Hz) for fault, scans_of in found.items()}
    to.write({"seeds": options.seeds, "rows": rows})


if __name__ == "__main__":
    main()
