"""Baseline of a Stäubli TX40: torques of six joints that move at once, from their recorded motion.

The model is inverse dynamics: rigid bodies, and at every joint Coulomb and viscous friction, the inertia of the rotor and an offset. The
motor of joint 6 turns with the sum of the speeds of joints 5 and 6, and its friction and inertia act on both: the wrist's coupling.
Everything but the smoothing of Coulomb friction is linear in its parameters, so one weighed least squares fits all joints together.

The masses, centres and inertias of the bodies cannot all be seen. They are drawn to their nominal values: a mass by a fraction of
itself, a first moment and an inertia by that fraction of the mass at a distance of 0.1 m and its square. The fraction and the
smoothing of Coulomb friction are chosen within the training part, one third of which is left out for that.

The error is that of each joint's torque. Model and measurement pass the same zero-phase low-pass filter of 20 Hz, four times the
bandwidth of the motion: above it lies the ripple of gears and drives. Errors at 10 Hz and without a filter are given as well.
"""

from __future__ import annotations

import itertools
import time
import tomllib
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import data_folder, nrmse, run
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

JOINTS = 6
RECORDED_Hz = 5000.0
KEPT = 5  # every fifth row after filtering: 1 kHz, far above what the filters pass
FILTER_ORDER = 4
MOTION_Hz = 20.0  # low-pass of the angles before they are differentiated: they move below 5 Hz, in steps of 0.03 mrad
TORQUE_Hz = (20.0, 10.0)  # low-pass of torques, the first for fitting
MARGIN_s = 0.1  # left out of the training part where it meets the held-out part: two time constants of the filters
MOTION_END_s = 7.8  # the robot stands from here on
BODY_SIZE_m = 0.1  # lever of a body's mass in the allowance of its inertia
ALLOWANCES = (0.05, 0.1, 0.2, 0.3)  # of the nominal masses; 0.3 is what a drawing may be wrong by
SLIP_SPEEDS_rad_s = (0.005, 0.02, 0.05)  # within which Coulomb friction is smooth: 0.1 % to 1 % of the largest speeds
ROWS_PER_INDEPENDENT = 50  # filtered to 20 Hz and read at 1 kHz: one row in fifty is new, the weight of data against the nominal values
WEIGHING_ROUNDS = 4  # until the weights of the joints, their residuals, stand still

TORQUE_GEAR = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
TORQUE_GEAR[4, 5] = 32.0
POSITION_GEAR = TORQUE_GEAR.T
ZERO_rad = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])

# What the source of the recording documents, joint by joint; the inertia of joint 1's rotor is not separable from its body's
DOCUMENTED: dict[str, tuple[str, tuple[float | None, ...]]] = {
    "coulomb": ("Nm", (7.14, 8.26, 6.34, 2.48, 3.03, 0.282)),
    "viscous": ("Nm s/rad", (8.05, 5.53, 1.97, 1.11, 1.86, 0.65)),
    "rotor_inertia": ("kg m2", (None, 0.362, 0.0988, 0.0313, 0.0468, 0.0105)),
    "offset": ("Nm", (0.392, 1.37, 0.326, -0.102, -0.0288, 0.127)),
}
WRIST = {"wrist_inertia": ("kg m2", 0.00964), "wrist_viscous": ("Nm s/rad", 0.616), "wrist_coulomb": ("Nm", 1.95)}
DRIVE_PARAMETERS = len(DOCUMENTED) * JOINTS + len(WRIST)


@dataclass(frozen=True)
class Body:
    """A link: its frame relative to the one before, and its ten inertial parameters, which the torques are linear in."""

    rotation: np.ndarray
    position_m: np.ndarray
    mass_kg: float
    inertial: np.ndarray  # mass, first moment (3), inertia about the frame's origin (xx, xy, xz, yy, yz, zz)

    @property
    def allowance(self) -> np.ndarray:
        """Return what the inertial parameters may change by, for an allowance of all of the mass."""
        lever = self.mass_kg * BODY_SIZE_m
        return np.array([self.mass_kg] + [lever] * 3 + [lever * BODY_SIZE_m] * 6)


def read_bodies() -> tuple[list[Body], np.ndarray]:
    """Return the links and gravity [m/s²] of nominal.toml."""
    nominal = tomllib.loads((data_folder() / "tx40" / "nominal.toml").read_text())
    bodies = []
    for link in nominal["link"]:
        mass, centre, about = link["mass_kg"], np.array(link["centre_m"]), link["inertia_kg_m2"]
        turned = Rotation.from_euler("z", link["inertia_yaw_rad"]).as_matrix()
        rows = [[about["xx"], about["xy"], about["xz"]], [about["xy"], about["yy"], about["yz"]], [about["xz"], about["yz"], about["zz"]]]
        inertia = turned @ np.array(rows) @ turned.T + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        inertial = np.concatenate([[mass], mass * centre, inertia[np.triu_indices(3)]])
        bodies.append(Body(Rotation.from_euler("xyz", link["rpy"]).as_matrix(), np.array(link["xyz"]), mass, inertial))
    return bodies, np.array(nominal["gravity_m_s2"])


@dataclass(frozen=True)
class Motion:
    """Time [s] and the joints' angles, speeds and accelerations (rows, joints), at 1 kHz."""

    time_s: np.ndarray
    angle: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """Return the matrices (rows, 3, 3) that multiply like the cross product with `vector` (rows, 3)."""
    x, y, z = vector.T
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), 2, 0)


def inertia_matrix(vector: np.ndarray) -> np.ndarray:
    """Return the matrices (rows, 3, 6) that turn six inertias into the product of inertia and `vector` (rows, 3)."""
    x, y, z = vector.T
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[x, y, z, zero, zero, zero], [zero, x, zero, y, z, zero], [zero, zero, x, zero, y, z]]), 2, 0)


def body_regressor(motion: Motion, bodies: list[Body], gravity: np.ndarray) -> np.ndarray:
    """Return what the inertial parameters are multiplied by in the joint torques (rows, joints, bodies × 10).

    Newton's and Euler's equations, recursively: speeds and accelerations from the base outwards, forces from each body inwards
    (Khalil and Dombre, Modeling, Identification and Control of Robots, chapter 9).
    """
    rows = len(motion.angle)
    axis = np.array([0.0, 0.0, 1.0])
    omega, omega_rate = np.zeros((rows, 3)), np.zeros((rows, 3))
    acceleration = np.tile(-gravity, (rows, 1))
    regressor = np.zeros((rows, JOINTS, 10 * JOINTS))
    rotations: list[np.ndarray] = []
    for i, body in enumerate(bodies):
        rotation = body.rotation @ Rotation.from_rotvec(motion.angle[:, i, None] * axis).as_matrix()
        rotations.append(rotation)
        inwards = rotation.transpose(0, 2, 1)
        carried = acceleration + np.cross(omega_rate, body.position_m) + np.cross(omega, np.cross(omega, body.position_m))
        acceleration = np.einsum("nij,nj->ni", inwards, carried)
        omega, omega_rate = np.einsum("nij,nj->ni", inwards, omega), np.einsum("nij,nj->ni", inwards, omega_rate)
        spin = motion.speed[:, i, None] * axis
        omega_rate = omega_rate + np.cross(omega, spin) + motion.acceleration[:, i, None] * axis
        omega = omega + spin

        turning = cross_matrix(omega)
        force, moment = np.zeros((rows, 3, 10)), np.zeros((rows, 3, 10))
        force[:, :, 0] = acceleration
        force[:, :, 1:4] = cross_matrix(omega_rate) + turning @ turning
        moment[:, :, 1:4] = -cross_matrix(acceleration)
        moment[:, :, 4:] = inertia_matrix(omega_rate) + turning @ inertia_matrix(omega)
        for j in range(i, -1, -1):
            regressor[:, j, 10 * i : 10 * i + 10] = moment[:, 2]
            force, moment = rotations[j] @ force, rotations[j] @ moment
            moment = moment + cross_matrix(np.tile(bodies[j].position_m, (rows, 1))) @ force
    return regressor


def drive_regressor(motion: Motion, slip_speed: float) -> np.ndarray:
    """Return what the parameters of friction, rotors, offsets and the wrist are multiplied by (rows, joints, parameters)."""
    speed, acceleration = motion.speed, motion.acceleration
    regressor = np.zeros((*speed.shape, DRIVE_PARAMETERS))
    for j in range(JOINTS):
        terms = (np.tanh(speed[:, j] / slip_speed), speed[:, j], acceleration[:, j], np.ones(len(speed)))
        for kind, term in enumerate(terms):
            regressor[:, j, kind * JOINTS + j] = term
    wrist = np.tanh((speed[:, 4] + speed[:, 5]) / slip_speed)
    for joint, other in ((4, 5), (5, 4)):  # a joint's own speed is in its own viscous friction and rotor inertia
        regressor[:, joint, -3:] = np.stack([acceleration[:, other], speed[:, other], wrist], axis=1)
    return regressor


def low_pass(signal: np.ndarray, cutoff_Hz: float | None, rate_Hz: float) -> np.ndarray:
    """Return the signal (rows, ...) through a Butterworth filter, forwards and backwards; unchanged with no cutoff."""
    if cutoff_Hz is None:
        return signal
    sections = butter(FILTER_ORDER, cutoff_Hz, fs=rate_Hz, output="sos")
    return np.asarray(sosfiltfilt(sections, signal, axis=0))


def read_recording() -> tuple[Motion, np.ndarray]:
    """Return the motion of the joints at 1 kHz and their torques [Nm] (rows, joints) at the recorded 5 kHz."""
    rows = np.genfromtxt(data_folder() / "tx40" / "tx40.csv.gz", delimiter=",", skip_header=1)
    angle = low_pass(rows[:, 1:7] @ np.linalg.inv(POSITION_GEAR).T + ZERO_rad, MOTION_Hz, RECORDED_Hz)
    speed = np.gradient(angle, 1 / RECORDED_Hz, axis=0)
    acceleration = np.gradient(speed, 1 / RECORDED_Hz, axis=0)
    motion = Motion(rows[::KEPT, 0], angle[::KEPT], speed[::KEPT], acceleration[::KEPT])
    return motion, rows[:, 7:] @ TORQUE_GEAR.T


class Model:
    """The regressors of the recorded motion, filtered as the torques are, and the measured torques."""

    def __init__(self) -> None:
        """Read the recording and build the bodies' regressor."""
        self.motion, self._recorded = read_recording()
        self.bodies, gravity = read_bodies()
        self._bodies = body_regressor(self.motion, self.bodies, gravity)
        self._filtered: dict[tuple[float | None, float], np.ndarray] = {}
        self.nominal = np.concatenate([body.inertial for body in self.bodies] + [np.zeros(DRIVE_PARAMETERS)])
        documented = [0.0 if value is None else value for _, values in DOCUMENTED.values() for value in values]
        self.documented = self.nominal.copy()
        self.documented[-DRIVE_PARAMETERS:] = documented + [value for _, value in WRIST.values()]

    def measured(self, cutoff_Hz: float | None) -> np.ndarray:
        """Return the measured torques (rows, joints) at 1 kHz."""
        return low_pass(self._recorded, cutoff_Hz, RECORDED_Hz)[::KEPT]

    def regressor(self, cutoff_Hz: float | None, slip_speed: float) -> np.ndarray:
        """Return what all parameters are multiplied by (rows, joints, parameters)."""
        key = (cutoff_Hz, slip_speed)
        if key not in self._filtered:
            whole = np.concatenate([self._bodies, drive_regressor(self.motion, slip_speed)], axis=2)
            self._filtered[key] = low_pass(whole, cutoff_Hz, RECORDED_Hz / KEPT)
        return self._filtered[key]

    def fit(self, rows: np.ndarray, allowance: float, slip_speed: float) -> np.ndarray:
        """Return all parameters, fitted to the torques of `rows`; with no allowance the bodies stay nominal."""
        kept = self.regressor(TORQUE_Hz[0], slip_speed)[rows]
        left = self.measured(TORQUE_Hz[0])[rows] - kept @ self.nominal
        free = np.arange(len(self.nominal)) >= (0 if allowance else 10 * JOINTS)
        sigma = np.concatenate([allowance * body.allowance for body in self.bodies] + [np.full(DRIVE_PARAMETERS, np.inf)])[free]
        kept = kept[:, :, free]
        weight = np.ones(JOINTS)
        change = np.zeros(free.sum())
        for _ in range(WEIGHING_ROUNDS):
            weighed = (kept / weight[:, None]).reshape(-1, free.sum())
            normal = weighed.T @ weighed / ROWS_PER_INDEPENDENT + np.diag(sigma**-2.0)
            change = np.linalg.solve(normal, weighed.T @ (left / weight).ravel() / ROWS_PER_INDEPENDENT)
            weight = (left - kept @ change).std(axis=0)
        parameters = self.nominal.copy()
        parameters[free] += change
        return parameters

    def errors(self, parameters: np.ndarray, slip_speed: float, rows: np.ndarray, cutoff_Hz: float | None) -> list[float]:
        """Return the NRMSE of the six torques."""
        torque = self.regressor(cutoff_Hz, slip_speed)[rows] @ parameters
        measured = self.measured(cutoff_Hz)[rows]
        return [nrmse(torque[:, j], measured[:, j]) for j in range(JOINTS)]

    def choose(self, kept: np.ndarray, left_out: np.ndarray) -> tuple[float, float]:
        """Return the allowance and the slip speed that predict best what is left out of the training part."""
        tried = {
            (allowance, slip): float(np.mean(self.errors(self.fit(kept, allowance, slip), slip, left_out, TORQUE_Hz[0])))
            for allowance, slip in itertools.product(ALLOWANCES, SLIP_SPEEDS_rad_s)
        }
        return min(tried, key=lambda pair: tried[pair])


def named(parameters: np.ndarray) -> dict[str, Any]:
    """Return the parameters of friction, rotors, offsets and wrist with units and documented values."""
    values = iter(parameters[-DRIVE_PARAMETERS:])
    entries = [(f"{kind}_{j + 1}", unit, value) for kind, (unit, found) in DOCUMENTED.items() for j, value in enumerate(found)]
    entries += [(name, unit, value) for name, (unit, value) in WRIST.items()]
    return {name: {"value": float(f"{next(values):.4g}"), "unit": unit, "documented": value} for name, unit, value in entries}


def split(model: Model, train_s: tuple[float, float], held_out_s: tuple[float, float], left_out_s: float, official: bool) -> dict[str, Any]:
    """Fit one part of the recording and measure both; `left_out_s` parts the training part for the choices, the part far from it first."""
    began = time.perf_counter()
    seconds = model.motion.time_s
    train, held_out = ((seconds >= part[0]) & (seconds < part[1]) for part in (train_s, held_out_s))
    fitted_rows = train & (seconds >= held_out_s[1] + MARGIN_s if held_out_s[0] < train_s[0] else seconds < held_out_s[0] - MARGIN_s)
    if held_out_s[0] < train_s[0]:
        kept, left_out = fitted_rows & (seconds >= left_out_s + MARGIN_s), fitted_rows & (seconds < left_out_s)
    else:
        kept, left_out = fitted_rows & (seconds < left_out_s - MARGIN_s), fitted_rows & (seconds >= left_out_s)
    allowance, slip = model.choose(kept, left_out)
    stages = {
        "nominal": model.nominal,
        "documented": model.documented,
        "nominal_bodies": model.fit(fitted_rows, 0.0, slip),
        "fitted": model.fit(fitted_rows, allowance, slip),
    }

    def table(cutoff_Hz: float | None, names: list[str]) -> dict[str, Any]:
        found = {name: [model.errors(stages[name], slip, rows, cutoff_Hz) for rows in (train, held_out)] for name in names}
        return {
            f"torque_{j + 1}": {name: {"train": round(a[j], 4), "held_out": round(b[j], 4)} for name, (a, b) in found.items()}
            for j in range(JOINTS)
        }

    bodies = 10 * JOINTS
    change = (stages["fitted"] - stages["nominal"])[:bodies] / np.concatenate([body.allowance for body in model.bodies])
    return {
        "train": [f"{train_s[0]} to {train_s[1]} s, less {MARGIN_s} s beside the held-out part in the fit"],
        "held_out": [f"{held_out_s[0]} to {held_out_s[1]} s"],
        "metric": "NRMSE of each joint's torque by inverse dynamics, all rows at 1 kHz. Motion: motor angles at 5 kHz through the gears, "
        "zero-phase low-pass (Butterworth of order 4, forwards and backwards) of 20 Hz, differentiated twice by central differences. "
        "Model torque at 1 kHz and measured torque at 5 kHz pass the same zero-phase low-pass of 20 Hz. No initial state.",
        "official": official,
        "nominal_is": "nominal bodies, no friction, rotor inertia or offset, nothing fitted; 'documented' adds the documented numbers, "
        "unfitted (rotor inertia of joint 1: none); 'nominal_bodies' fits these but leaves the bodies nominal",
        "chosen_on_training": {
            "allowance": allowance,
            "slip_speed_rad_s": slip,
            "largest_body_change": round(float(np.abs(change).max()), 3),
        },
        "parameters": named(stages["fitted"]),
        "channels": table(TORQUE_Hz[0], list(stages)),
        "other_metrics": {"low-pass of 10 Hz": table(TORQUE_Hz[1], ["fitted"]), "no filter of torques": table(None, ["fitted"])},
        "seconds": round(time.perf_counter() - began, 1),
    }


def splits() -> dict[str, Any]:
    """Return both splits."""
    model = Model()
    return {
        "readme": split(model, (0.0, 4.6), (4.6, MOTION_END_s), left_out_s=3.1, official=True),
        "reversed": split(model, (3.2, MOTION_END_s), (0.0, 3.2), left_out_s=4.7, official=False),
    }


if __name__ == "__main__":
    run("tx40", __doc__, splits)
