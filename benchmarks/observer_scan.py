"""Where the detector really is during scans that something shakes: errors of encoders, model, KF, EKF, UKF and an oracle against the truth.

    python benchmarks/observer_scan.py --json -

The observer's model is identified from multisines on the undisturbed emulated C-arm, its disturbances are tuned on shaken scans and it is
judged on others, three of each. It knows nothing of the shaking but what that tuning found. The oracle is an extended Kalman filter on the
emulated machine's own equations with the true noise, the true spectrum of the shaking and the true places where it acts. A second oracle is
not told the places: it takes every joint for shaken, in the true spectrum.

`--own-model` reads "oracle" as the observer's own filter instead: the same modal form with all parameters the emulator's, the true noise of
sensors, and disturbances at the true places with their true strengths in the form that the filter has (`hil.observing.own_model`).
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np
from scipy import signal
from scipy.spatial.transform import Rotation

from controllers.observers.consistency import share_in_band
from controllers.observers.settings import ObserverNoise
from hil.experiments import Plan, Scan
from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, observe, read_design, tune, write_design
from hil.observing.noise import effort_gain, encoder_steps
from hil.observing.own_model import own_model
from hil.observing.true_scan import SETTLE_s, TrueScan, nominal_pose, true_scan
from hil.recording import Recording
from hil.terminal.output import Answer
from hil.verbs.observe import design_observer
from virtual_bus.physics import Physics
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import Drive, PlantSettings

SHAKEN_Nm = {"mount_sway": 40.0, "propeller_gear": 15.0, "roll_gear": 15.0, "detector_mount": 2.0}
"""Rms torque at joints that no drive turns: people and ceiling at the mount, cables at the arc, hands at the detector."""

UNTOLD_Nm = 15.0
"""What the oracle that is not told the places believes of every other joint: as much as shakes the gears."""

BAND_Hz = (1.0, 12.0)
SKIPPED_S = 1.0  # of every scan, in which the filters find their biases
OWN_MODES = 5
OWN_GRID = (9, 13)
"""Poses per axis."""
OWN_EVALUATIONS = 150  # it starts near
OWN_DRIVES_Nm = 0.1
"""What the tuning of the observer's own oracle starts from at the drives, which nothing disturbs: what its linear form leaves."""

JUDGED_SEEDS = (7, 1007, 2007)
TRAINING_SEED = 100


def shaken_plant(machine: Machine, shaken_Nm: dict[str, float]) -> PlantSettings:
    """The machine with a shaker, a drive of one Nm per unit, on every shaken joint."""
    shakers = tuple(Drive(f"shaker_{joint}", joint, "Nm", 1.0, 1.0, 1e9, 0.0, 1.0) for joint in shaken_Nm)
    return dataclasses.replace(machine.plant, drives=(*machine.plant.drives, *shakers))


def shaking_sections(machine: Machine) -> np.ndarray:
    """Band pass that colours the shaking."""
    return signal.butter(2, BAND_Hz, "bandpass", fs=machine.sample_rate_Hz, output="sos")


def shaking(machine: Machine, rows: int, seed: int) -> np.ndarray:
    """(rows, shakers) Nm."""
    generator = np.random.default_rng(seed)
    white = generator.standard_normal((rows + 1024, len(SHAKEN_Nm))) * white_std(machine, SHAKEN_Nm)
    return signal.sosfilt(shaking_sections(machine), white, axis=0)[1024:]


def white_std(machine: Machine, shaken_Nm: dict[str, float]) -> np.ndarray:
    """Of the white noise (shakers,) that the band pass turns into the shaking."""
    answer = signal.sosfilt(shaking_sections(machine), np.eye(1, 8192)[0])
    return np.array(list(shaken_Nm.values())) / np.sqrt(np.sum(answer**2))


def shaken_scan(machine: Machine, plan: Plan, seed: int, loudness: float = 1.0) -> TrueScan:
    """Run a plan in closed loop on the shaken machine; `loudness` scales the shaking, 0 leaves sensors' noise alone."""
    push = loudness * shaking(machine, round(SETTLE_s * machine.sample_rate_Hz) + plan.rows, seed)
    return true_scan(machine, plan, seed, dict(zip(SHAKEN_Nm, push.T, strict=True)))


def errors(scan: TrueScan, position: np.ndarray, rotation: np.ndarray, first: int) -> dict[str, float]:
    """Rms of the error of a pose from row `first` on, in the detector's frame: shift [um] and turn [urad], with their components."""
    shift = np.einsum("nji,nj->ni", scan.rotation, position - scan.position)[first:] * 1e6
    turn = (Rotation.from_matrix(scan.rotation).inv() * Rotation.from_matrix(rotation)).as_rotvec()[first:] * 1e6
    each = {f"shift_{axis}_um": float(np.sqrt(np.mean(shift[:, i] ** 2))) for i, axis in enumerate("xyz")}
    each |= {f"turn_{axis}_urad": float(np.sqrt(np.mean(turn[:, i] ** 2))) for i, axis in enumerate("xyz")}
    total = {"shift_um": float(np.sqrt(np.mean(np.sum(shift**2, axis=1)))), "turn_urad": float(np.sqrt(np.mean(np.sum(turn**2, axis=1))))}
    return total | each


def estimated_pose(machine: Machine, estimate) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Detector pose from an observer's estimate."""
    axes = np.column_stack([estimate[f"estimate_position_{axis}"] for axis in machine.axes])
    position, rotation = nominal_pose(machine, axes)
    shift = np.column_stack([estimate[f"estimate_detector_{axis}"] for axis in "xyz"])
    turn = np.column_stack([estimate[f"estimate_detector_r{axis}"] for axis in "xyz"])
    return position + np.einsum("nij,nj->ni", rotation, shift), rotation @ Rotation.from_rotvec(turn).as_matrix()


def without(recording: Recording, prefixes: tuple[str, ...]) -> Recording:
    """The recording without some channels."""
    return Recording({name: channel for name, channel in recording.channels.items() if not name.startswith(prefixes)}, recording.metadata)


class Oracle:
    """Extended Kalman filter on the emulator's own equations, shakers' true spectrum and true noise included."""

    def __init__(self, machine: Machine, noise: ObserverNoise, shaken_Nm: dict[str, float]) -> None:
        settings = shaken_plant(machine, shaken_Nm)
        self.bias, self.bias_deviation = noise.bias, noise.initial_bias  # from the same standing records as the observer's
        self.plant = compile_plant(settings)
        self.model, self.work = self.plant.model(), self.plant.new_work()
        self.n, self.axes = self.plant.joints, len(machine.axes)
        self.brakes = np.zeros(len(settings.drives))
        self.machine = machine
        a, b, c, d = signal.tf2ss(*signal.sos2tf(shaking_sections(machine)))
        self.colour = a, b[:, 0], c[0], float(d[0, 0])
        self.m = len(shaken_Nm)
        self.core = 2 * self.n + 6
        self.states = self.core + self.m * len(a) + 6
        encoders = {encoder.channel: encoder for encoder in settings.encoders}
        self.rows = np.zeros((2 * self.axes, self.n))
        names = [f"position_{axis}" for axis in machine.axes] + [f"link_position_{axis}" for axis in machine.axes]
        for row, name in zip(self.rows, names, strict=True):
            for joint in encoders[name].joints:
                row[settings.tree.joint_index(joint)] = 1.0
        imu = settings.imus[0]
        lattice = [encoders[name].resolution / np.sqrt(12.0) for name in names]
        self.noise = np.concatenate((lattice, imu.accelerometer_noise_rms_m_s2, imu.gyro_noise_rms_rad_s))
        self.white = white_std(machine, shaken_Nm)

    def _state(self, x: np.ndarray) -> np.ndarray:
        state = np.zeros(self.plant.state_size)
        state[: 2 * self.n] = x[: 2 * self.n]
        state[4 * self.n : 4 * self.n + 6] = x[2 * self.n : self.core]
        return state

    def _advance(self, x: np.ndarray, effort: np.ndarray) -> np.ndarray:
        state = self._state(x)
        self.plant.advance(state, effort, self.brakes, self.model, self.work)
        return np.concatenate((state[: 2 * self.n], state[4 * self.n : 4 * self.n + 6]))

    def run(self, scan: TrueScan, start_state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Detector poses (N, 3), (N, 3, 3)."""
        recording, machine, core = scan.recording, self.machine, self.core
        a, b, c, d = self.colour
        order = len(a)
        x = np.zeros(self.states)
        x[:core] = start_state
        deviation = np.concatenate((np.full(self.n, 1e-4), np.full(self.n, 1e-2), np.full(3, 0.1), np.full(3, 0.01)))
        P = np.zeros((self.states, self.states))
        P[:core, :core] = np.diag(deviation**2)
        steady = solve_steady(a, b)
        for j in range(self.m):
            place = slice(core + j * order, core + (j + 1) * order)
            P[place, place] = steady * self.white[j] ** 2
        P[-6:, -6:] = np.diag(self.bias_deviation**2)
        x[-6:] = self.bias
        channels = [f"position_{axis}" for axis in machine.axes] + [f"link_position_{axis}" for axis in machine.axes]
        measured = recording.matrix([*channels, "imu_x", "imu_y", "imu_z", "gyro_x", "gyro_y", "gyro_z"])
        commands = recording.matrix([f"command_{axis}" for axis in machine.axes])
        step = np.array([drive.resolution for drive in machine.plant.drives])
        H = np.zeros((len(measured[0]), self.states))
        H[: len(self.rows), : self.n] = self.rows
        H[len(self.rows) :, 2 * self.n : core] = np.eye(6)
        H[len(self.rows) :, -6:] = np.eye(6)
        R = np.diag(self.noise**2)
        sizes = np.concatenate((np.full(2 * self.n, 1e-6), np.full(6, 1e-4)))
        positions, rotations = np.zeros((len(measured), 3)), np.zeros((len(measured), 3, 3))
        detector = [body for body in machine.plant.watched_bodies].index(machine.geometry.detector_body)  # type: ignore[union-attr]
        effort = np.zeros(self.axes + self.m)
        for k, z in enumerate(measured):
            if k:
                effort[: self.axes] = step * np.round(commands[max(k - 2, 0)] / step)
                shakes = np.array([c @ x[core + j * order : core + (j + 1) * order] for j in range(self.m)])
                effort[self.axes :] = shakes
                F, G = np.zeros((self.states, self.states)), np.zeros((self.states, self.m))
                for i in range(core):
                    shift = np.zeros(core)
                    shift[i] = sizes[i]
                    F[:core, i] = (self._advance(x[:core] + shift, effort) - self._advance(x[:core] - shift, effort)) / (2.0 * sizes[i])
                for j in range(self.m):
                    more, less = effort.copy(), effort.copy()
                    more[self.axes + j] += 1.0
                    less[self.axes + j] -= 1.0
                    by_shake = (self._advance(x[:core], more) - self._advance(x[:core], less)) / 2.0
                    place = slice(core + j * order, core + (j + 1) * order)
                    F[:core, place] = np.outer(by_shake, c)
                    F[place, place] = a
                    G[:core, j], G[place, j] = by_shake * d * self.white[j], b * self.white[j]
                F[-6:, -6:] = np.eye(6)
                x[:core] = self._advance(x[:core], effort)
                for j in range(self.m):
                    place = slice(core + j * order, core + (j + 1) * order)
                    x[place] = a @ x[place]
                P = F @ P @ F.T + G @ G.T
            S = H @ P @ H.T + R
            K = np.linalg.solve(S, H @ P).T
            x = x + K @ (z - H @ x)
            rest = np.eye(self.states) - K @ H
            P = rest @ P @ rest.T + K @ R @ K.T
            pose = self.plant.body_poses(self.model, x[: self.n])[detector]
            positions[k], rotations[k] = pose[:3], pose[3:].reshape(3, 3)
        return positions, rotations


def solve_steady(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Covariance of x = a x + b w in steady state."""
    from scipy.linalg import solve_discrete_lyapunov

    return solve_discrete_lyapunov(a, np.outer(b, b))


def start_of(machine: Machine, pose: np.ndarray, oracle: Oracle) -> np.ndarray:
    """The oracle's start: rest at a pose, low passes filled."""
    still = Physics(machine.plant, noise=False)
    still.place(pose)
    q = still.truth()["joint_position"]
    reading = oracle.plant.imu_motion(oracle.model, q, np.zeros(oracle.n), np.zeros(oracle.n))
    return np.concatenate((q, np.zeros(oracle.n), reading))


def scans(machine: Machine) -> dict[str, Plan]:
    """The scans judged."""
    return {
        "roll 30 deg/s": Scan("roll", np.radians(-80.0), np.radians(80.0), np.radians(30.0)).plans(machine)[0],
        "roll 55 deg/s": Scan("roll", np.radians(-80.0), np.radians(80.0), np.radians(55.0)).plans(machine)[0],
        "propeller 30 deg/s": Scan("propeller", np.radians(-60.0), np.radians(60.0), np.radians(30.0)).plans(machine)[0],
    }


def own_design(machine: Machine, design: ObserverDesign, training: list[Recording]) -> ObserverDesign:
    """The observer with the emulator's parameters: five modes, the true places; strengths and times in the filter's form as tuned.

    Tuning starts at the true strengths; the sensors' noise is the true one, and the command's is its rounding, which the filter knows.
    """
    model = own_model(machine, OWN_MODES, OWN_GRID, tuple(SHAKEN_Nm))
    imu, gain = machine.plant.imus[0], effort_gain(machine)
    axes = len(gain)
    steps = encoder_steps(model, machine)
    start = dataclasses.replace(
        design.noise,
        command=np.array([drive.resolution for drive in machine.plant.drives]) / np.sqrt(12.0),
        disturbance=np.concatenate((OWN_DRIVES_Nm / gain, list(SHAKEN_Nm.values()))),
        disturbance_time_s=np.full(axes + len(SHAKEN_Nm), 0.1),
        disturbance_Hz=np.concatenate((np.zeros(axes), np.full(len(SHAKEN_Nm), BAND_Hz[0]))),
        low_pass=np.zeros(0, dtype=bool),
        measurement=np.concatenate((steps / np.sqrt(12.0), imu.accelerometer_noise_rms_m_s2, imu.gyro_noise_rms_rad_s)),
    )
    return dataclasses.replace(design, model=model, noise=tune(model, start, training, evaluations=OWN_EVALUATIONS).noise)


def judged(machine: Machine, design: ObserverDesign, plan: Plan, seed: int, with_oracle: bool, own: ObserverDesign | None) -> dict:
    """Errors of everything over one shaken scan."""
    scan = shaken_scan(machine, plan, seed)
    first = round(SKIPPED_S * machine.sample_rate_Hz)
    recording = scan.recording
    table: dict = {}
    for name, prefix in (("motor encoders", "position"), ("link encoders", "link_position")):
        axes = recording.matrix([f"{prefix}_{axis}" for axis in machine.axes])
        table[name] = errors(scan, *nominal_pose(machine, axes), first)
    blind = without(recording, ("link_position", "imu_", "gyro_"))
    table["model only"] = errors(scan, *estimated_pose(machine, observe(blind, design.observer("ekf"))), first)
    table["ukf without link encoders"] = errors(
        scan, *estimated_pose(machine, observe(without(recording, ("link_position",)), design.observer("ukf"))), first
    )
    for kind in ("kf", "ekf", "ukf"):
        estimate = observe(recording, design.observer(kind))  # type: ignore[arg-type]
        nis, measured = estimate["estimate_nis"][first:], estimate["estimate_measured"][first:]
        table[kind] = errors(scan, *estimated_pose(machine, estimate), first) | {
            "nis_per_measurement": float(nis.sum() / measured.sum()),
            "share_in_band": share_in_band(nis, measured),
            "alarm_share": float(estimate["estimate_alarm"][first:].mean()),
        }
    if own:
        table["oracle in the observer's form"] = errors(scan, *estimated_pose(machine, observe(recording, own.observer("ukf"))), first)
    if with_oracle:
        everywhere = {joint.name: SHAKEN_Nm.get(joint.name, UNTOLD_Nm) for joint in machine.plant.tree.joints}
        for name, places in (("oracle", SHAKEN_Nm), ("oracle not told the places", everywhere)):
            oracle = Oracle(machine, design.noise, places)
            table[name] = errors(scan, *oracle.run(scan, start_of(machine, plan.start_pose, oracle)), first)
    return table | factors(table)


def factors(table: dict) -> dict:
    """How many times larger errors are than others."""
    return {
        f"factor_{quantity}": {
            "motor encoders over ukf": table["motor encoders"][quantity] / table["ukf"][quantity],
            "link encoders over ukf": table["link encoders"][quantity] / table["ukf"][quantity],
            **{f"ukf over {name}": table["ukf"][quantity] / table[name][quantity] for name in table if name.startswith("oracle")},
        }
        for quantity in ("shift_um", "turn_urad")
    }


def together(tables: dict[int, dict]) -> dict:
    """Several seeds of one scan: rms of errors, means of all else, and the factors of the rms; beside them the factors of every seed."""
    first = next(iter(tables.values()))
    table: dict = {}
    for name in (name for name in first if not name.startswith("factor")):
        each = {key: np.array([one[name][key] for one in tables.values()]) for key in first[name]}
        table[name] = {
            key: float(np.sqrt(np.mean(found**2)) if key.endswith(("_um", "_urad")) else found.mean()) for key, found in each.items()
        }
    seeds = {
        str(seed): {"ukf": {key: one["ukf"][key] for key in ("shift_um", "turn_urad")}} | {key: one[key] for key in factors(one)}
        for seed, one in tables.items()
    }
    return table | factors(table) | {"by_seed": seeds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    parser.add_argument("--design", metavar="FILE", type=Path, help="untuned design to start from; identified unless given")
    parser.add_argument("--tuned", action="store_true", help="that design is tuned already")
    parser.add_argument("--save-design", metavar="FILE", type=Path, help="write the tuned design")
    parser.add_argument("--no-oracle", action="store_true", help="leave the oracle out")
    parser.add_argument("--own-model", action="store_true", help="judge the observer's own filter with all parameters true, too")
    parser.add_argument(
        "--machine", default="carm", help="carm or carm-real; of carm-real there is no oracle: it would need the friction's states"
    )
    options = parser.parse_args()
    if options.machine != "carm" and not (options.no_oracle and not options.own_model):
        parser.error("of another machine than carm there is no oracle: add --no-oracle, without --own-model")
    if options.tuned and options.design is None:
        parser.error("--tuned says that --design is tuned: give --design")
    to = Answer(options.json)
    machine = load_machine(options.machine)
    began = time.perf_counter()
    design = read_design(options.design) if options.design else design_observer(machine)
    plans = scans(machine)
    training = [
        shaken_scan(machine, plans[name], TRAINING_SEED + i).recording for i, name in enumerate(("roll 30 deg/s", "propeller 30 deg/s"))
    ]
    if not options.tuned:
        design = dataclasses.replace(design, noise=tune(design.model, design.noise, training).noise)
    if options.save_design:
        write_design(design, options.save_design)
    seconds = time.perf_counter() - began
    own = own_design(machine, design, training) if options.own_model else None
    answer = {
        "seconds_to_design": seconds,
        "scans": {
            name: together({seed + i: judged(machine, design, plan, seed + i, not options.no_oracle, own) for seed in JUDGED_SEEDS})
            for i, (name, plan) in enumerate(plans.items())
        },
    }
    to.write(answer)


if __name__ == "__main__":
    main()
