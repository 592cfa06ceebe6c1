"""What the observer publishes against the truth: true error, stated deviation, their ratio, NIS and alarms, of both C-arms.

    python benchmarks/observer_variances.py --json -
    python benchmarks/observer_variances.py --machine carm-real --design carm-real=FILE --spread 30 --json -

Per machine an observer is designed on its emulation and tuned on two scans, as a user's is; then it is judged on others. With `--own-model`
it is not identified: masses, springs, dampers and sensors' noise are the file's own, and disturbances those of the shaken scans, so that
what is false is what the effects do, and nothing else. Each seed draws the noise of the sensors, the shaking, and what scatters from run to
run; `--spread` scatters every strength of every effect by so many per cent instead: each seed is another machine than the design's.

The truth is that of the nine geometric parameters: focal spot and isocentre in the detector's frame, and the detector's orientation. The
error is the root mean square over the rows of all seeds after the first second, of three components together; the stated deviation
likewise, from the published variances. A ratio of stated to true of 1 is true, 0.1 says ten times too little. Encoders state nothing.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np
from observer_scan import (
    OWN_MODES,
    SKIPPED_S,
    TRAINING_SEED,
    BAND_Hz,
    OWN_DRIVES_Nm,
    SHAKEN_Nm,
    ShakenScan,
    nominal_pose,
    shaken_scan,
    without,
)
from observer_truth import GRID, true_model
from scipy.spatial.transform import Rotation

from controllers.models.modal import ModalModel
from controllers.observers.consistency import share_in_band
from controllers.observers.settings import ObserverNoise
from hil.experiments import Plan, Scan
from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, emulated_design, observe, read_design, tune, write_design
from hil.observing.geometry import observed_chain
from hil.observing.noise import LATTICE, encoder_steps, starting_noise
from hil.observing.unmodelled import with_unmodelled
from hil.recording import Recording
from hil.terminal.output import Answer

FIRST_SEED = 7000
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
        "roll 55 deg/s, quiet": (Scan("roll", *roll, fast).plans(machine)[0], 0.0),
        "propeller 30 deg/s, reversed, quiet": (Scan("propeller", *propeller, slow, sweeps=2).plans(machine)[0], 0.0),
    }


def nine(position: np.ndarray, rotation: np.ndarray, source: np.ndarray, isocenter: np.ndarray) -> np.ndarray:
    """Return the nine parameters (N, 9) of detectors (N, 3), (N, 3, 3) and focal spots (N, 3)."""
    inside = [np.einsum("nji,nj->ni", rotation, point - position) for point in (source, isocenter)]
    return np.hstack([*inside, Rotation.from_matrix(rotation).as_euler("xyz")])


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


class Sums:
    """Sums over rows and seeds of what one method says of one scan."""

    def __init__(self) -> None:
        self.rows, self.errors, self.variances = 0, np.zeros(9), np.zeros(9)
        self.nis, self.measured, self.in_band, self.alarms, self.begun, self.seconds = 0.0, 0.0, 0.0, 0.0, 0, 0.0

    def add(self, error: np.ndarray, variance: np.ndarray | None) -> None:
        error[:, 6:] = (error[:, 6:] + np.pi) % (2.0 * np.pi) - np.pi
        self.rows += len(error)
        self.errors += np.sum(error**2, axis=0)
        if variance is not None:
            self.variances += np.sum(variance, axis=0)

    def add_consistency(self, nis: np.ndarray, measured: np.ndarray, alarm: np.ndarray, seconds: float) -> None:
        self.nis += float(nis.sum())
        self.measured += float(measured.sum())
        self.in_band += len(nis) * share_in_band(nis, measured)
        self.alarms += float(alarm.sum())
        self.begun += int(np.sum(np.diff(alarm, prepend=0.0) > 0.5))
        self.seconds += seconds

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
                "nis_per_measurement": self.nis / self.measured,
                "share_in_band": self.in_band / self.rows,
                "alarm_share": self.alarms / self.rows,
                "alarms_in_ten_minutes": 600.0 * self.begun / self.seconds,
            }
        return found


def take(sums: dict[str, Sums], machine: Machine, design: ObserverDesign, scan: ShakenScan, untold: ObserverDesign | None) -> None:
    """Add one scan as every method sees it; `untold`: the same observer, whose noise counts no effect."""
    first = round(SKIPPED_S * machine.sample_rate_Hz)
    recording = scan.recording
    assert machine.geometry is not None
    truth = nine(scan.position, scan.rotation, scan.source, machine.geometry.isocenter_m)[first:]
    for name, prefix in (("motor encoders", "position"), ("link encoders", "link_position")):
        sums.setdefault(name, Sums()).add(by_encoders(machine, recording, prefix)[first:] - truth, None)
    blind = without(recording, ("link_position", "imu_", "gyro_"))
    no_link = without(recording, ("link_position",))
    ways = {"model only": (blind, "ekf"), "ukf without link encoders": (no_link, "ukf"), "kf": (recording, "kf"), "ekf": (recording, "ekf")}
    ways |= {"ukf": (recording, "ukf")} | ({} if untold is None else {UNTOLD: (recording, "ukf")})
    for name, (seen, kind) in ways.items():
        used = untold if untold is not None and name == UNTOLD else design
        estimate = observe(seen, used.observer(kind))  # type: ignore[arg-type]
        found = np.column_stack([estimate[f"estimate_{channel}"] for channel in NINE])[first:]
        variance = np.column_stack([estimate[f"estimate_{channel}_variance"] for channel in NINE])[first:]
        of = sums.setdefault(name, Sums())
        of.add(found - truth, variance)
        said = [estimate[f"estimate_{channel}"][first:] for channel in ("nis", "measured", "alarm")]
        of.add_consistency(*said, seconds=len(truth) / machine.sample_rate_Hz)


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
        disturbance=np.concatenate((np.full(len(machine.axes), OWN_DRIVES_Nm), list(SHAKEN_Nm.values()))),
        disturbance_Hz=np.concatenate((np.zeros(len(machine.axes)), np.full(len(SHAKEN_Nm), BAND_Hz[0]))),
        low_pass=np.zeros(0, dtype=bool),
        measurement=np.concatenate((steps * LATTICE, *noises)),
    )


def own_design(machine: Machine, counts: tuple[int, ...] = GRID, *, told: bool = False) -> ObserverDesign:
    """Return the observer whose model has the file's numbers, and knows of no effect but the bias that it would find at rest.

    `told`: its noise counts the effects that the file states.
    """
    plain = dataclasses.replace(machine, plant=dataclasses.replace(machine.plant, effects=()))
    chain, sensors, source, isocenter = observed_chain(machine)
    n, axes = len(machine.axes), machine.axes
    rows = OWN_MODES * (2 + 3 * n + 6 * len(sensors)) + n * (n + 1) + n + OWN_MODES + 6
    empty = ModalModel(
        axes=axes, chain=chain, sensors=sensors, source_end_m=source, harmonics=(0,) * n, coefficients=np.zeros((rows, 1)),
        sample_rate_Hz=machine.sample_rate_Hz, effort_limit=np.array([drive.limit for drive in machine.plant.drives]),
        effort_step=np.array([drive.resolution for drive in machine.plant.drives]),
        position_unit=tuple(units.position for units in machine.units),
    )  # fmt: skip
    model = true_model(plain, empty, OWN_MODES, tuple(SHAKEN_Nm), counts)
    noise = own_noise(machine, model)
    if told:
        noise = with_unmodelled(noise, model, machine, np.ones(n))  # `true_model` has its drives in Nm
    return ObserverDesign(model, noise, isocenter, machine.name, machine.hash, ("the file's own numbers",))


def spread_over(machine: Machine, percent: float) -> Machine:
    """Return the machine whose effects scatter by so much, not by what its file says of two runs."""
    effects = tuple(dataclasses.replace(effect, scatter=0.01 * percent) for effect in machine.plant.effects)
    return dataclasses.replace(machine, plant=dataclasses.replace(machine.plant, effects=effects))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", action="append", help="carm, carm-real (both unless given)")
    parser.add_argument("--design", action="append", default=[], metavar="MACHINE=FILE", help="untuned design; made unless given")
    parser.add_argument("--own-model", action="store_true", help="the file's own numbers in place of identified and tuned ones")
    parser.add_argument("--save-design", metavar="FOLDER", type=Path, help="keep the tuned designs there")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--spread", type=float, metavar="PERCENT", help="by which effects differ from the design's machine, per seed")
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    options = parser.parse_args()
    to = Answer(options.json)
    given = dict(each.split("=", 1) for each in options.design)
    rows: dict[str, dict[str, object]] = {}
    for name in options.machine or ["carm", "carm-real"]:
        machine = load_machine(name)
        judged = scans(machine)
        untold = None
        if options.own_model:
            design = own_design(machine, told=True)
            untold = dataclasses.replace(design, noise=own_noise(machine, design.model)) if machine.own_effects else None
        else:
            design = read_design(Path(given[name])) if name in given else emulated_design(machine)
            plans = [judged["roll 30 deg/s, shaken"][0], judged["propeller 30 deg/s, reversed, quiet"][0]]
            training = [shaken_scan(machine, plan, TRAINING_SEED + i).recording for i, plan in enumerate(plans)]
            design = dataclasses.replace(design, noise=tune(design.model, design.noise, training).noise)
        if options.save_design:
            write_design(design, options.save_design / f"{name}.observer.npz")
        drawn = machine if options.spread is None else spread_over(machine, options.spread)
        for scan, (plan, loudness) in judged.items():
            sums: dict[str, Sums] = {}
            for seed in range(FIRST_SEED, FIRST_SEED + options.seeds):
                take(sums, machine, design, shaken_scan(drawn, plan, seed, loudness), untold)
                print(f"{name}, {scan}, seed {seed}", file=sys.stderr, flush=True)
            rows |= {f"{name}, {scan}: {method}": found.table() for method, found in sums.items()}
    to.write(
        {
            "model": "own" if options.own_model else "identified",
            "seeds": options.seeds,
            "spread_percent": options.spread,
            "rows": rows,
        }
    )


if __name__ == "__main__":
    main()
