"""What the observer publishes against the truth: true error, stated deviation, their ratio, NIS and alarms, of both C-arms.

    python benchmarks/observer_variances.py --json -
    python benchmarks/observer_variances.py --machine carm-real --design carm-real=FILE --json -

Per machine an observer is designed on its emulation and tuned on two scans, as a user's is; then it is judged on others. With `--own-model`
it is not identified: masses, springs, dampers and sensors' noise are the file's own, and disturbances those of the shaken scans, so that
what is false is what the effects do, and nothing else. Each seed draws the noise of the sensors, the shaking, and the machine: every effect
that its file states lies somewhere in its range (`hil.machine.drawn`), of which the design knows the root mean square alone. What is
measured of a scan is kept in `--kept` and not measured again.

The truth is that of the nine geometric parameters: focal spot and isocentre in the detector's frame, and the detector's orientation. The
error is the root mean square over the rows of all seeds after the first second, of three components together; the stated deviation
likewise, from the published variances. A ratio of stated to true of 1 is true, 0.1 says ten times too little. Encoders state nothing.

The true error passes what is stated where the error of focal spot, isocentre or orientation begins to be more than twice its stated
deviation, after half a second in which it was not. An alarm is in time when it is raised within a second of that; it is false when no such
error is within a second of its beginning.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from observer_scan import (
    OWN_GRID,
    OWN_MODES,
    SKIPPED_S,
    TRAINING_SEED,
    BAND_Hz,
    OWN_DRIVES_Nm,
    SHAKEN_Nm,
    shaken_scan,
    without,
)
from on_engine import add_scheduler, each

from controllers.models.modal import ModalModel
from controllers.observers.consistency import share_in_band
from controllers.observers.settings import ObserverNoise
from hil.experiments import Plan, Scan
from hil.machine import Machine, load_machine
from hil.machine.drawn import drawn, typical
from hil.observing import Estimate, ObserverDesign, observe, read_design, tune, write_design
from hil.observing.geometry import observed_chain
from hil.observing.noise import LATTICE, START_TIME_s, effort_gain, encoder_steps, starting_noise
from hil.observing.own_model import own_model
from hil.observing.true_scan import TrueScan, nine, nominal_pose
from hil.observing.unmodelled import with_unmodelled
from hil.recording import Recording
from hil.terminal.output import Answer
from hil.verbs.observe import design_observer

FIRST_SEED = 7000
BETWEEN_rad = np.radians(37.0)
"""Propeller's position between those of the design: neighbours are 23 and 51 degrees."""

BAND_TIME_s = 1.0 / (np.pi * (BAND_Hz[1] - BAND_Hz[0]))
"""Of a disturbance s / (s^2 + 2 s / time + centre^2), which has half its power density at both ends of the shaking's band."""

APART_s, IN_TIME_s = 0.5, 1.0
SUMMED = ("rows", "errors", "variances", "nis", "measured", "in_band", "alarms", "false", "passed", "in_time", "seconds")
UNTOLD = "ukf, effects not in its noise"
GROUPS = {"isocentre": slice(3, 6), "focal_spot": slice(0, 3), "orientation": slice(6, 9)}
NINE = [*(f"source_{axis}" for axis in "xyz"), *(f"isocenter_{axis}" for axis in "xyz"), *(f"orientation_{axis}" for axis in "xyz")]


def scans(machine: Machine) -> dict[str, tuple[Plan, float]]:
    """Return plan and loudness of the shaking of each scan judged."""
    roll, propeller = (np.radians(-80.0), np.radians(80.0)), (np.radians(-60.0), np.radians(60.0))
    slow, fast = np.radians(30.0), np.radians(55.0)
    return {
        "roll 30 deg/s, quiet": (Scan("roll", *roll, slow).plans(machine)[0], 0.0),
        "roll 30 deg/s, shaken": (Scan("roll", *roll, slow).plans(machine)[0], 1.0),
        "roll 30 deg/s, propeller at 37 deg, shaken": (Scan("roll", *roll, slow, {"propeller": BETWEEN_rad}).plans(machine)[0], 1.0),
        "roll 55 deg/s, quiet": (Scan("roll", *roll, fast).plans(machine)[0], 0.0),
        "propeller 30 deg/s, reversed, quiet": (Scan("propeller", *propeller, slow, sweeps=2).plans(machine)[0], 0.0),
    }


def by_encoders(machine: Machine, recording: Recording, prefix: str) -> np.ndarray:
    """Return the nine parameters (N, 9) of the rigid C-arm at its encoders."""
    geometry = machine.geometry
    assert geometry is not None
    position, rotation = nominal_pose(machine, recording.matrix([f"{prefix}_{axis}" for axis in machine.axes]))
    still, turned = nominal_pose(machine, np.zeros((1, len(machine.axes))))
    tube = machine.plant.tree
    frame: dict[str, np.ndarray] = {"world": np.zeros(3)}
    for body in tube.bodies:  # every frame of a C-arm at zero is parallel to the world's
        frame[body.name] = frame[body.parent] + body.position_m
    source = turned[0].T @ (frame[geometry.source_body] + geometry.source_position_m - still[0])
    return nine(position, rotation, position + rotation @ source, geometry.isocenter_m)


@dataclasses.dataclass(frozen=True)
class Told:
    """What the alarms of one scan tell: rows in alarm, of how many; false ones; how often the error passed, and was told in time."""

    rows: int
    of: int
    false: int
    passed: int
    in_time: int


def told(error: np.ndarray, variance: np.ndarray, alarm: np.ndarray, rate_Hz: float, first: int = 0) -> Told:
    """Return what alarms (N,) tell of errors (N, 9) with stated variances (N, 9), of passings from row `first` on."""
    wrong = np.any([np.sum(error[:, at] ** 2, axis=1) > 4.0 * np.sum(variance[:, at], axis=1) for at in GROUPS.values()], axis=0)
    on, within = alarm > 0.5, round(IN_TIME_s * rate_Hz)
    passings = [row for row in begun(wrong, rate_Hz) if row >= first]
    in_time = [bool(on[row : row + within].any()) for row in passings]
    false = [not wrong[max(row - within, 0) : row + within].any() for row in begun(on, rate_Hz)]
    return Told(int(on.sum()), len(on), sum(false), len(passings), sum(in_time))


def begun(is_so: np.ndarray, rate_Hz: float) -> list[int]:
    """Return the rows at which something begins to be so, after a while in which it was not."""
    rows = np.flatnonzero(np.diff(is_so.astype(int), prepend=0) > 0)
    return [int(row) for row in rows if not is_so[max(row - round(APART_s * rate_Hz), 0) : row].any()]


def errors_and_variances(estimate: Estimate, truth: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (N, 9) against the truth of rows from `first` on, and stated variances (N, 9)."""
    error = np.column_stack([estimate[f"estimate_{channel}"] for channel in NINE])[first:] - truth
    return wrapped(error), np.column_stack([estimate[f"estimate_{channel}_variance"] for channel in NINE])[first:]


def wrapped(error: np.ndarray) -> np.ndarray:
    """Return errors (N, 9) with angles within half a turn."""
    error[:, 6:] = (error[:, 6:] + np.pi) % (2.0 * np.pi) - np.pi
    return error


class Sums:
    """Sums over rows and seeds of what one method says of one scan."""

    def __init__(self) -> None:
        self.rows, self.errors, self.variances = 0, np.zeros(9), np.zeros(9)
        self.nis, self.measured, self.in_band, self.alarms, self.seconds = 0.0, 0.0, 0.0, 0.0, 0.0
        self.false, self.passed, self.in_time = 0, 0, 0

    def add(self, error: np.ndarray, variance: np.ndarray | None) -> None:
        self.rows += len(error)
        self.errors += np.sum(error**2, axis=0)
        if variance is not None:
            self.variances += np.sum(variance, axis=0)

    def add_consistency(self, nis: np.ndarray, measured: np.ndarray) -> None:
        self.nis += float(nis.sum())
        self.measured += float(measured.sum())
        self.in_band += len(nis) * share_in_band(nis, measured)

    def add_alarms(self, told: Told, rate_Hz: float) -> None:
        self.alarms += told.rows
        self.seconds += told.of / rate_Hz
        self.false += told.false
        self.passed += told.passed
        self.in_time += told.in_time

    def kept(self) -> dict[str, object]:
        return {name: np.asarray(getattr(self, name)).tolist() for name in SUMMED}

    def add_kept(self, kept: dict[str, object]) -> None:
        for name in SUMMED:
            setattr(self, name, getattr(self, name) + np.asarray(kept[name]))

    def table(self) -> dict[str, float]:
        found: dict[str, float] = {}
        for name, place in GROUPS.items():
            unit = "urad" if name == "orientation" else "um"
            true = 1e6 * float(np.sqrt(self.errors[place].sum() / self.rows))
            found[f"{name}_true_{unit}"] = true
            if self.variances.any():
                stated = 1e6 * float(np.sqrt(self.variances[place].sum() / self.rows))
                found |= {f"{name}_stated_{unit}": stated, f"{name}_ratio": stated / true}
        if self.seconds:
            found |= {
                "nis_per_measurement": float(self.nis / self.measured),
                "share_in_band": float(self.in_band / self.rows),
                "alarm_share": float(self.alarms / self.rows),
                "false_alarms_in_ten_minutes": float(600.0 * self.false / self.seconds),
                "passed_twice": float(self.passed),
                "in_time": float(self.in_time),
            }
        return found


def take(sums: dict[str, Sums], machine: Machine, design: ObserverDesign, scan: TrueScan, untold: ObserverDesign | None) -> None:
    """Add one scan as every method sees it; `untold`: the same observer, whose noise counts no effect."""
    first = round(SKIPPED_S * machine.sample_rate_Hz)
    recording = scan.recording
    assert machine.geometry is not None
    truth = nine(scan.position, scan.rotation, scan.source, machine.geometry.isocenter_m)[first:]
    for name, prefix in (("motor encoders", "position"), ("link encoders", "link_position")):
        sums.setdefault(name, Sums()).add(wrapped(by_encoders(machine, recording, prefix)[first:] - truth), None)
    blind = without(recording, ("link_position", "imu_", "gyro_"))
    no_link = without(recording, ("link_position",))
    ways = {"model only": (blind, "ekf"), "ukf without link encoders": (no_link, "ukf"), "kf": (recording, "kf"), "ekf": (recording, "ekf")}
    ways |= {"ukf": (recording, "ukf")} | ({} if untold is None else {UNTOLD: (recording, "ukf")})
    for name, (seen, kind) in ways.items():
        used = untold if untold is not None and name == UNTOLD else design
        estimate = observe(seen, used.observer(kind))  # type: ignore[arg-type]
        error, variance = errors_and_variances(estimate, truth, first)
        of = sums.setdefault(name, Sums())
        of.add(error, variance)
        of.add_consistency(estimate["estimate_nis"][first:], estimate["estimate_measured"][first:])
        of.add_alarms(told(error, variance, estimate["estimate_alarm"][first:], machine.sample_rate_Hz), machine.sample_rate_Hz)


def own_noise(machine: Machine, model: ModalModel) -> ObserverNoise:
    """Return the noise of the file's sensors and of the shaken scans."""
    bias, noises = [], []
    for imu in sorted(machine.plant.imus, key=lambda imu: imu.body != machine.geometry.detector_body):  # type: ignore[union-attr]
        bias += [imu.accelerometer_bias_m_s2, imu.gyro_bias_rad_s]
        noises += [imu.accelerometer_noise_rms_m_s2, imu.gyro_noise_rms_rad_s]
    biases = np.concatenate(bias), np.zeros(6 * len(model.sensors))
    steps = encoder_steps(model, machine)
    return dataclasses.replace(
        starting_noise(model, machine, (), (), biases),
        disturbance=np.concatenate((OWN_DRIVES_Nm / effort_gain(machine), list(SHAKEN_Nm.values()))),
        disturbance_time_s=np.concatenate((np.full(len(machine.axes), START_TIME_s), np.full(len(SHAKEN_Nm), BAND_TIME_s))),
        disturbance_Hz=np.concatenate((np.zeros(len(machine.axes)), np.full(len(SHAKEN_Nm), np.sqrt(np.prod(BAND_Hz))))),
        low_pass=np.zeros(0, dtype=bool),
        measurement=np.concatenate((steps * LATTICE, *noises)),
    )


def own_design(machine: Machine, counts: tuple[int, ...] = OWN_GRID, *, told: bool = False) -> ObserverDesign:
    """Return the observer whose model has the file's numbers, and knows of no effect but the bias that it would find at rest.

    `told`: its noise counts the effects that the file states.
    """
    plain = dataclasses.replace(machine, plant=dataclasses.replace(machine.plant, effects=()))
    *_, isocenter = observed_chain(machine)
    model = own_model(plain, OWN_MODES, counts, tuple(SHAKEN_Nm))
    noise = own_noise(machine, model)
    if told:
        noise = with_unmodelled(noise, model, machine)
    return ObserverDesign(model, noise, isocenter, machine.name, machine.hash, ("the file's own numbers",))


@functools.cache
def designed(name: str, tuned: str | None) -> tuple[Machine, ObserverDesign, ObserverDesign | None]:
    """Return a machine, its observer by a file or by the machine's own numbers, and that with noise of nothing but its own."""
    machine = load_machine(name)
    if tuned is not None:
        return machine, read_design(Path(tuned)), None
    design = own_design(typical(machine), told=True)
    return machine, design, dataclasses.replace(design, noise=own_noise(machine, design.model)) if machine.own_effects else None


def key_of(name: str, scan: str, number: int, seeds: int, tuned: str | None = None) -> str:
    """Return what a scan of a drawn machine is called where it is kept."""
    return f"{name}, {scan}, {number} of {seeds}"


def measured(name: str, scan: str, number: int, seeds: int, tuned: str | None) -> dict[str, dict[str, object]]:
    """Return the sums of every method over one scan of a drawn machine."""
    machine, design, untold = designed(name, tuned)
    plan, loudness = scans(machine)[scan]
    of_scan: dict[str, Sums] = {}
    take(of_scan, machine, design, shaken_scan(drawn(machine, number, seeds), plan, FIRST_SEED + number, loudness), untold)
    return {method: found.kept() for method, found in of_scan.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", action="append", help="carm, carm-real (both unless given)")
    parser.add_argument("--design", action="append", default=[], metavar="MACHINE=FILE", help="untuned design; made unless given")
    parser.add_argument("--own-model", action="store_true", help="the file's own numbers in place of identified and tuned ones")
    parser.add_argument("--save-design", metavar="FOLDER", type=Path, help="keep the tuned designs there")
    parser.add_argument("--seeds", type=int, default=20, help="and machines, per scan")
    parser.add_argument("--kept", metavar="FILE", type=Path, help="where what is measured is kept, a line per scan")
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    add_scheduler(parser)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measure(options, options.save_design or Path(folder))


def measure(options: argparse.Namespace, folder: Path) -> None:
    """Draw, measure, write; designs go into the folder."""
    to = Answer(options.json)
    given = dict(each.split("=", 1) for each in options.design)
    rows: dict[str, dict[str, object]] = {}
    before: dict[str, dict[str, dict[str, object]]] = {}
    for line in options.kept.read_text().splitlines() if options.kept and options.kept.exists() else []:
        before |= json.loads(line)
    for name in options.machine or ["carm", "carm-real"]:
        machine = load_machine(name)
        judged = scans(machine)
        tuned = None
        if not options.own_model:
            design = read_design(Path(given[name])) if name in given else design_observer(typical(machine))
            plans = [judged["roll 30 deg/s, shaken"][0], judged["propeller 30 deg/s, reversed, quiet"][0]]
            training = [shaken_scan(typical(machine), plan, TRAINING_SEED + i).recording for i, plan in enumerate(plans)]
            design = dataclasses.replace(design, noise=tune(design.model, design.noise, training).noise)
            tuned = str(Path(folder).absolute() / f"{name}.observer.npz")
            write_design(design, Path(tuned))
        draws = [{"name": name, "scan": scan, "number": k, "seeds": options.seeds} for scan in judged for k in range(options.seeds)]
        missing = [draw | {"tuned": tuned} for draw in draws if key_of(**draw) not in before]
        for draw, found in each(measured, missing, options.scheduler, named=lambda draw: key_of(**draw)):
            before[key_of(**draw)] = found
            if options.kept:
                with options.kept.open("a") as file:
                    file.write(json.dumps({key_of(**draw): found}) + "\n")
            print(key_of(**draw), file=sys.stderr, flush=True)
        for scan in judged:
            sums: dict[str, Sums] = {}
            for number in range(options.seeds):
                for method, kept in before[key_of(name, scan, number, options.seeds)].items():
                    sums.setdefault(method, Sums()).add_kept(kept)
            rows |= {f"{name}, {scan}: {method}": found.table() for method, found in sums.items()}
    to.write(
        {
            "model": "own" if options.own_model else "identified",
            "seeds": options.seeds,
            "rows": rows,
        }
    )


if __name__ == "__main__":
    main()
