"""The parts of an emulated machine, as frozen values in SI units. The bench builds them from a machine file.

Frames, symbols and signs: docs/explanation/notation.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from virtual_bus.idle_time import SILENCE_S


@dataclass(frozen=True)
class Joint:
    """One degree of freedom between a body and its parent, at the origin of the body's frame."""

    name: str
    kind: str  # "revolute" or "prismatic"
    axis: np.ndarray  # (3,) unit vector in the body's frame
    stiffness: float = 0.0  # Nm/rad or N/m, towards rest_position
    damping: float = 0.0  # Nm s/rad or N s/m
    rest_position: float = 0.0  # rad or m
    armature: float = 0.0  # kg m^2 or kg: rotor inertia times ratio squared, added to the joint's own inertia
    brake_effort: float = 0.0  # Nm or N: what the joint's brake holds when it is closed; 0 means no brake


@dataclass(frozen=True)
class Body:
    """One rigid body. At joint position zero its frame has position_m and orientation in the parent's frame."""

    name: str
    parent: str  # a body listed before, or "world"
    position_m: np.ndarray  # (3,)
    orientation: np.ndarray  # (3, 3) rotation, body to parent, at joint position zero
    mass_kg: float
    center_of_mass_m: np.ndarray  # (3,) in the body's frame
    inertia_kg_m2: np.ndarray  # (3, 3) about the centre of mass, in the body's frame
    joint: Joint | None = None  # None: welded to the parent


@dataclass(frozen=True)
class Tree:
    """The plant: a tree of rigid bodies under gravity. Joint order is body order."""

    bodies: tuple[Body, ...]
    gravity_m_s2: np.ndarray  # (3,)

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The joints, in body order."""
        return tuple(body.joint for body in self.bodies if body.joint is not None)

    def joint_index(self, name: str) -> int:
        """Return the number of a joint."""
        return [joint.name for joint in self.joints].index(name)


@dataclass(frozen=True)
class Drive:
    """Turns a command in the drive's unit into effort on one joint: effort_on_joint = constant * ratio * command."""

    axis: str
    joint: str
    unit: str  # "A", "V", "Nm" or "N"
    constant: float  # motor effort per unit, at the motor's shaft (Nm/A, N/V, ...)
    ratio: float  # motor turns per joint turn (1 for direct drive); never negative
    limit: float  # |command| at which the loop saturates, in unit
    resolution: float  # smallest step of the target in unit; 0 means none
    rated: float  # rated current (or effort) in unit: per mille values on the wire refer to it


@dataclass(frozen=True)
class Encoder:
    """Position of the sum of one or more joints, quantised to resolution: floor(y / resolution + 1/2) * resolution."""

    channel: str  # "position_<axis>" or "link_position_<axis>"
    joints: tuple[str, ...]
    resolution: float  # rad or m at the joint; 0 means none
    absolute: bool


@dataclass(frozen=True)
class SpeedSensor:
    """Speed of the sum of one or more joints, quantised to resolution."""

    channel: str  # "speed_<axis>"
    joints: tuple[str, ...]
    resolution: float  # rad/s or m/s at the joint; 0 means none


@dataclass(frozen=True)
class CurrentSensor:
    """The drive's measured current (or effort), with white noise and quantisation."""

    channel: str  # "current_<axis>" or "effort_<axis>"
    axis: str
    resolution: float
    noise_rms: float


@dataclass(frozen=True)
class Imu:
    """Specific force and angular rate of a point of a body, in the sensor's own frame."""

    name: str  # "imu": channels imu_x, imu_y, imu_z, gyro_x, gyro_y, gyro_z
    body: str
    position_m: np.ndarray  # (3,) in the body's frame
    orientation: np.ndarray  # (3, 3) rotation, sensor to body
    accelerometer_noise_rms_m_s2: np.ndarray  # (3,) per sample
    accelerometer_bias_m_s2: np.ndarray  # (3,)
    accelerometer_bandwidth_Hz: float  # first-order low pass; 0 means none
    accelerometer_resolution_m_s2: float
    gyro_noise_rms_rad_s: np.ndarray  # (3,)
    gyro_bias_rad_s: np.ndarray  # (3,)
    gyro_bandwidth_Hz: float
    gyro_resolution_rad_s: float


@dataclass(frozen=True)
class Thermometer:
    """Winding temperature: ambient plus a first-order response to the copper loss."""

    channel: str  # "temperature_<axis>"
    axis: str
    ambient_degC: float
    rise_K_per_unit2: float  # steady rise per squared command unit
    time_constant_s: float
    resolution_K: float


@dataclass(frozen=True)
class EffectSetting:
    """One effect of an effects file, bound to a place of this machine."""

    name: str
    """Of the catalogue."""
    at: str
    """Where it acts."""
    parameters: dict[str, float]
    """In SI, in the effect's own order."""
    scatter: float = field(default=0.0, metadata={"json": False})
    """Share by which its strengths differ from one start of the emulated machine to the next, standard deviation."""
    between: dict[str, tuple[float, float]] = field(default_factory=dict, metadata={"json": False})
    """Where parameters lie on one machine or another of this kind, in SI; those that are not here are known."""


@dataclass(frozen=True)
class PlantSettings:
    """Everything the emulated physics needs."""

    tree: Tree
    drives: tuple[Drive, ...]  # in axis order
    encoders: tuple[Encoder, ...]
    currents: tuple[CurrentSensor, ...]
    imus: tuple[Imu, ...]
    thermometers: tuple[Thermometer, ...]
    sample_period_s: float
    substeps: int  # plant steps per sample
    watched_bodies: tuple[str, ...] = ()  # whose pose the truth file holds
    speeds: tuple[SpeedSensor, ...] = ()

    @property
    def joint_sensors(self) -> tuple[Encoder | SpeedSensor, ...]:
        """Encoders, then speed sensors."""
        return (*self.encoders, *self.speeds)

    effects: tuple[EffectSetting, ...] = field(default=())
    strokes: tuple[tuple[str, float], ...] = ()  # of axes by name: how far their positions may lie apart [rad or m], where it is known
    tolerances: tuple[tuple[str, float], ...] = ()  # of numbers by name (`arm.center_of_mass_y_m`), in their units


@dataclass(frozen=True)
class EmulatedDrive:
    """A CiA 402 drive of the emulated machine: its data sheet, its scaling, and what is wired to it."""

    name: str
    axis: str
    node_id: int
    eds: Path
    rated: float  # rated current (or effort) in the drive's unit: per mille on the wire refer to it
    rated_current_mA: int  # object 6075h
    rated_torque_mNm: int  # object 6076h
    limit: float  # in the drive's unit: objects 6072h and 6073h when it leaves the factory
    position_resolution: float  # rad or m at the joint, per count
    counts_per_turn: int  # encoder counts from one index pulse to the next
    velocity_gain: float  # the drive's own loop for homing and stopping: drive's unit per rad/s (or m/s) at the joint
    velocity_integral_gain: float  # drive's unit per rad (or m)
    negative_switch: float | None = None  # joint position of the limit switches; None: not wired
    positive_switch: float | None = None
    sign: int = 1  # -1: wired so that a positive target and rising counts mean the negative direction of the joint
    position_gain: float = 0.0
    """Speed demand per position lag [1/s]. 0: velocity_integral_gain / velocity_gain, the corner of the velocity loop's integral action.

    With a velocity loop of bandwidth w [rad/s] and integral corner w/4 on a rigid mass this is w/4: the closed loop has poles at -0.18 w
    and, with damping 0.69, at 0.60 w; a step of the target does not overshoot. At w/2 the damping would fall to 0.51.
    """

    speed_filter: float = 0.25
    """Share of the newest difference of positions in the measured speed: the encoder's counts are coarse at slow speed."""
    torque_sections: tuple[tuple[float, ...], ...] = ()
    """Filter of the velocity loop's torque: second-order sections (b0, b1, b2, 1, a1, a2) at the sample rate, static gain 1."""
    velocity_unit: str = ""
    """Unit of a device whose objects say none, as in `DECLARED` and `COUNTS` of `drivers.canopen.units`; so is `acceleration_unit`."""
    acceleration_unit: str = ""

    @property
    def counts_per_motor_turn(self) -> float:
        """Counts of the position actual value per turn of the motor."""
        return float(self.counts_per_turn)

    def __post_init__(self) -> None:
        """Derive the position gain where none is given."""
        if not self.position_gain and self.velocity_gain:
            object.__setattr__(self, "position_gain", self.velocity_integral_gain / self.velocity_gain)


@dataclass(frozen=True)
class EmulatedEncoder:
    """A CiA 406 link encoder of the emulated machine."""

    name: str
    axis: str
    node_id: int
    eds: Path
    counts_per_turn: int
    zero_counts: int  # raw count at joint position zero
    sign: int = 1


@dataclass(frozen=True)
class EmulatedCanImu:
    """An IMU of the emulated machine that is a node of the bus."""

    name: str
    node_id: int
    eds: Path
    number: int  # of the IMU among the machine's


@dataclass(frozen=True)
class EmulatedBus:
    """The devices on the emulated machine's CAN bus."""

    sync_cob_id: int
    drives: tuple[EmulatedDrive, ...]
    encoders: tuple[EmulatedEncoder, ...]
    produces_sync: bool = False  # a device beside these sends SYNC at the sample rate, and the master none
    silence_s: float = SILENCE_S  # after this much waiting since the last SYNC the machine's time goes on without one
    by_the_wall: bool = False  # then all of it, also while somebody speaks
    imus: tuple[EmulatedCanImu, ...] = ()
