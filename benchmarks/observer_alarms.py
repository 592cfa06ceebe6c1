"""Faults that make the observer's estimate worse than it states, and whether its alarm tells within a second.

    python benchmarks/observer_alarms.py --json benchmarks/results/observer_alarms.json

The design of `observer_variances --own-model` and its machines, on roll scans at 30 deg/s. A sensor's fault begins three seconds after the
scan's beginning; it is added to the recording. What is wrong with the structure is so from the beginning. How often the true error passes
twice what is stated counts from the fault on, how often the alarm is in time and how often false as in `observer_variances`.

Then the design of `hil.design_observer(MACHINE)`, whose alarm knows what is usual of sound machines: each effect of a list is drawn over a
range, on a machine that is drawn, too, in a quiet, fast or reversed scan of either axis. The same machine without it makes the same scan;
where its error passes as well, that is none of the effect's. Sound machines make scans besides. "before" is the alarm by corrections alone,
in the same replay. What is drawn is kept in `--kept` and not measured again. `--part` measures one of both tables and `--machine`
one machine; the rest of the file stays as it is.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from observer_scan import SKIPPED_S, shaken_scan
from observer_variances import FIRST_SEED, GROUPS, IN_TIME_s, Told, begun, errors_and_variances, own_design, scans, told
from on_engine import add_scheduler, answers, each

import hil
from controllers.observers.consistency import CorrectionMonitor
from controllers.observers.modal_observer import ModalObserver
from hil.experiments.plan import Plan
from hil.machine import Machine, load_machine
from hil.machine.drawn import drawn, typical
from hil.observing import ObserverDesign, observe, read_design, write_design
from hil.observing.held_to_truth import KINDS, plan_of
from hil.observing.held_to_truth import errors_and_variances as all_errors
from hil.observing.true_scan import TrueScan, nine, true_scan
from hil.recording import Recording
from hil.terminal.output import Answer
from virtual_bus.settings import EffectSetting

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


DRAWN_SEED, SOUND_SEED = 9500, 9000
"""Of machines with something wrong and of sound ones: others than those to which the design is held."""

DRAWN = {
    "load at the detector": (2.0, 20.0, "kg"),
    "stiffness of the detector's mount": (0.35, 0.9, "of the file's"),
    "friction of an axis": (20.0, 120.0, "Nm"),
    "bias of the detector's IMU": (0.03, 0.5, "m/s^2"),
    "scale of the detector's IMU": (0.005, 0.05, ""),
    "delay of a drive": (0.002, 0.012, "s"),
}
"""Drawn evenly over the logarithm between these."""

GYRO_SHARE = 0.06
"""Bias of the gyros [rad/s] per m/s^2 of the accelerometers': 0.2 mrad/s to 3 mm/s^2, as in the file of `carm-real`."""


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


def with_effect(machine: Machine, effect: EffectSetting) -> Machine:
    """Return the machine with an effect more."""
    return machine.with_effects((*machine.added_effects, effect))


def with_drawn(machine: Machine, fault: str, random: np.random.Generator) -> tuple[Machine, dict[str, tuple[float, float]], float, float]:
    """Return the machine with a fault of a drawn size, gain and offset of sensors' channels, from when on, and the size."""
    low, high, _ = DRAWN[fault]
    size, at_s = float(low * (high / low) ** random.random()), float(random.choice((0.0, AT_s)))
    axis = machine.axes[random.integers(len(machine.axes))]
    readings: dict[str, tuple[float, float]] = {}
    if fault == "load at the detector":
        machine = with_effect(machine, EffectSetting("payload", "detector", {"dm": size}))
    elif fault == "stiffness of the detector's mount":
        machine = changed(machine, size, 1.0)
    elif fault == "friction of an axis":
        machine = with_effect(machine, EffectSetting("coulomb_friction", axis, {"Fc": size}))
    elif fault == "delay of a drive":
        machine = with_effect(machine, EffectSetting("delay", axis, {"Td": size}))
    else:
        for name, share in (("imu", 1.0), ("gyro", GYRO_SHARE)):
            way = random.standard_normal(3)
            for letter, part in zip("xyz", way / np.linalg.norm(way), strict=True):
                is_bias = fault.startswith("bias")
                readings[f"{name}_{letter}"] = (1.0, size * share * part) if is_bias else (1.0 + size * np.sign(part), 0.0)
    return machine, readings, at_s if readings else 0.0, size


def replayed(machine: Machine, design: ObserverDesign, scan: TrueScan) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the largest error (N,) over what is stated of a scan, and rows (N,) with the alarm and with the one before."""
    alarms: list[tuple[float, bool]] = []
    before = CorrectionMonitor()

    def note(observer: ModalObserver) -> None:
        alarms.append((observer.estimate[-1], before.step(observer.memory.corrected[0], observer.memory.corrected[1])))

    error, variance, _ = all_errors(machine, scan, design.observer(), note)
    error, variance = error[:, -9:], variance[:, -9:]
    ratio = np.max([np.sqrt(np.sum(error[:, at] ** 2, axis=1) / np.sum(variance[:, at], axis=1)) for at in GROUPS.values()], axis=0)
    now, then = np.array(alarms, float)[-len(ratio) :].T
    return ratio, now > 0.5, then > 0.5


def drawn_scan(name: str, fault: str, number: int, draws: int, designs: str) -> dict[str, object]:
    """Return what the alarms tell of one scan of a drawn machine with a drawn fault, "" for a sound one."""
    machine, design = made(name, designs)
    seed, rate_Hz = DRAWN_SEED if fault else SOUND_SEED, machine.sample_rate_Hz
    random = np.random.default_rng([seed, number, len(fault)])
    one, axis, how = drawn(machine, number, draws, seed), number % len(machine.axes), list(KINDS)[number // len(machine.axes) % len(KINDS)]
    plan = plan_of(one, axis, how, random if number % 2 else None)
    sound, *alarms = replayed(one, design, true_scan(one, plan, seed + number))
    ratio, at_s, size = sound, 0.0, 0.0
    if fault:
        wrong, readings, at_s, size = with_drawn(one, fault, random)
        scan = true_scan(wrong, plan, seed + number)
        channels, late = dict(scan.recording.channels), scan.recording["time"] >= at_s
        for channel, (gain, offset) in readings.items():
            values = channels[channel].values
            channels[channel] = dataclasses.replace(channels[channel], values=np.where(late, gain * values + offset, values))
        scan = dataclasses.replace(scan, recording=Recording(channels, scan.recording.metadata))
        ratio, *alarms = replayed(wrong, design, scan)
    first, within = max(round((at_s - SKIPPED_S) * rate_Hz), 0), round(IN_TIME_s * rate_Hz)
    passings = [row for row in begun(ratio > 2.0, rate_Hz) if row >= first]
    if fault:
        passings = [row for row in passings if not (sound[max(row - within, 0) : row + within] > 2.0).any()]
    found: dict[str, object] = {"size": size, "seconds": len(ratio) / rate_Hz, "ratio": float(ratio[first:].max()), "passed": len(passings)}
    for which, on in zip(("", "_before"), alarms, strict=True):
        late_s = [float(np.argmax(on[row:])) / rate_Hz if on[row:].any() else None for row in passings]
        false = [not (ratio[max(row - within, 0) : row + within] > 2.0).any() for row in begun(on, rate_Hz)]
        found |= {f"late_s{which}": late_s, f"false{which}": sum(false), f"alarmed{which}": bool(on[first:].any())}
    return found


def drawn_row(found: list[dict[str, Any]]) -> dict[str, object]:
    """Return a table's row of many scans."""
    minutes = sum(one["seconds"] for one in found) / 60.0
    wrong = [one for one in found if one["passed"]]
    row: dict[str, object] = {
        "scans": len(found),
        "minutes": minutes,
        "median_ratio": float(np.median([one["ratio"] for one in found])),
        "passed_twice": sum(one["passed"] for one in found),
        "scans_that_passed": len(wrong),
    }
    for which in ("", "_before"):
        late = [late_s for one in found for late_s in one[f"late_s{which}"]]
        row[f"in_time{which}"] = sum(late_s is not None and late_s <= IN_TIME_s for late_s in late)
        row[f"alarmed_that_passed{which}"] = sum(one[f"alarmed{which}"] for one in wrong)
        row[f"false_alarms_in_ten_minutes{which}"] = 10.0 * sum(one[f"false{which}"] for one in found) / minutes
    return row


@functools.cache
def made(name: str, designs: str) -> tuple[Machine, ObserverDesign]:
    """Return a machine and the design that one command makes of it, from the folder of designs where it is there."""
    machine, path = load_machine(name), Path(designs) / f"{name}.observer.npz"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_design(hil.design_observer(machine), path)
    return machine, read_design(path)


def drawn_rows(options: argparse.Namespace, names: list[str]) -> dict[str, dict[str, object]]:
    """Return the table of drawn faults and sound machines, largest draws and what its alarm does not see beside it."""
    kept: dict[str, dict[str, Any]] = {}
    for line in options.kept.read_text().splitlines() if options.kept and options.kept.exists() else []:
        kept |= json.loads(line)
    rows = {}
    for name in names:
        made(name, options.designs)
        for fault, draws in ({"": options.sound} | dict.fromkeys(DRAWN, options.draws)).items():
            jobs = [{"name": name, "fault": fault, "number": k, "draws": draws, "designs": options.designs} for k in range(draws)]
            for job, found in each(drawn_scan, [job for job in jobs if key_of(job) not in kept], options.scheduler, named=key_of):
                kept[key_of(job)] = found
                if options.kept:
                    with options.kept.open("a") as file:
                        file.write(json.dumps({key_of(job): found}) + "\n")
                print(key_of(job), file=sys.stderr, flush=True)
            rows[f"{name}: {fault or 'nothing'}"] = drawn_row([kept[key_of(job)] for job in jobs])
    return rows


def key_of(job: dict[str, Any]) -> str:
    """Return what a drawn scan is called where it is kept."""
    return f"{job['name']}, {job['fault'] or 'nothing'}, {job['number']} of {job['draws']}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", action="append", help="carm, carm-real (both unless given)")
    parser.add_argument("--seeds", type=int, default=20, help="and machines, per fault")
    parser.add_argument("--part", choices=("fixed", "drawn"), help="of the answer; both unless given")
    parser.add_argument("--draws", type=int, default=12, help="and machines, per effect of the drawn list")
    parser.add_argument("--sound", type=int, default=84, help="sound machines beside them")
    parser.add_argument("--designs", metavar="FOLDER", default="designs", help="of `hil.design_observer`, made there unless they are there")
    parser.add_argument("--kept", metavar="FILE", type=Path, help="where what is drawn is kept, a line per scan")
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    add_scheduler(parser)
    options = parser.parse_args()
    to = Answer(options.json)
    names = options.machine or ["carm", "carm-real"]
    file, is_part = Path(options.json), options.part or options.machine
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if is_part and file.is_file() else {}
    if options.part != "fixed":
        of_list = drawn_rows(options, names)
        seen = {name: [dataclasses.asdict(one) for one in made(name, options.designs)[1].unseen] for name in names}
        found |= {"drawn": found.get("drawn", {}) | of_list, "unseen": found.get("unseen", {}) | seen}
    if options.part != "drawn":
        found |= {"seeds": options.seeds, "rows": found.get("rows", {}) | fixed_rows(options, names)}
    to.write(found)


def fixed_rows(options: argparse.Namespace, names: list[str]) -> dict[str, dict[str, float | None]]:
    """Return the table of faults of one size each."""
    rows: dict[str, dict[str, float | None]] = {}
    for name in names:
        draws = [{"name": name, "number": number, "seeds": options.seeds} for number in range(options.seeds)]
        found: dict[str, list[Told]] = {}
        for of_machine in answers(told_of, draws, options.scheduler):
            for fault, values in of_machine.items():
                found.setdefault(fault, []).append(Told(*values))
        rows |= {f"{name}: {fault}": row(scans_of, load_machine(name).sample_rate_Hz) for fault, scans_of in found.items()}
    return rows


if __name__ == "__main__":
    main()
