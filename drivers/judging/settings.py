"""Settings of the judgement: what is allowed of each sensor, frozen. The bench builds them from a machine file."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal

from drivers.judging.motion_means import Expects

Follows = Literal["stop", "mark"]
"""What follows a finding: the motors are stopped, or the run goes on and its rows are marked."""


ENCODERS_WINDOW_S = 0.5
"""Time over which the difference of both encoders is averaged: vibrations of the structure, above 4 Hz, leave nothing in it."""


@dataclass(frozen=True)
class ImuJudging:
    """What is allowed of an IMU."""

    sensor: str
    follows: Follows
    period_s: float  # between ticks
    rate_Hz: float  # of its packets
    age_s: float  # of the newest packet
    rate_tolerance: float  # share of the rate by which a second's packets may depart from it
    full_scale: tuple[float, ...]  # (6,) m/s^2 and rad/s; infinite where it is not known
    frozen_packets: tuple[int, ...]  # (6,) packets in a row with one value that noise makes impossible; 0: not judged
    damaged_per_s: int  # damaged messages in a second
    triggered: bool = False  # by SYNC: lost ticks, which have none, lack no packet
    force_tolerance: float = inf  # m/s^2 between mean specific force and what the machine file says of the motion
    turn_tolerance: float = inf  # rad/s between mean angular rate and the same


@dataclass(frozen=True)
class EncoderJudging:
    """What is allowed of an axis's encoders. The link is expected ahead of the motor side by what its spring carries.

    windup = compliance * (inertia * acceleration + damping * speed - effort_scale * effort), all of the motor side.
    """

    sensor: str
    axis: int
    unit: str  # "rad" or "m"
    follows: Follows
    period_s: float
    motor_resolution: float  # rad or m a count
    motor_acceleration: float  # rad/s^2 or m/s^2 that no effort exceeds
    link_resolution: float = 0.0  # 0: no link encoder
    link_acceleration: float = inf
    stale_ticks: int = 0  # ticks in a row without a link position that are bridged
    tolerance: float = inf  # rad or m between link and motor side beyond the windup
    drift: float = inf  # rad or m by which their difference may have grown while it still grows
    growth: float = 0.0  # rad or m a window: growth that noise and counts do not make
    compliance: float = 0.0  # rad/Nm or m/N of the spring between both encoders; 0: rigid
    inertia: float = 0.0  # kg m^2 or kg
    damping: float = 0.0  # Nm s/rad or N s/m
    effort_scale: float = 0.0  # Nm or N at the joint per unit of effort


@dataclass(frozen=True)
class TemperatureJudging:
    """What is allowed of an axis's thermometer."""

    sensor: str
    axis: int
    follows: Follows
    period_s: float
    limit_degC: float
    rate_K_s: float  # fastest change that a winding can make
    step_K: float  # resolution
    io_stale_s: float  # age of the I/O's state at which it says nothing


@dataclass(frozen=True)
class DriveJudging:
    """What is allowed of an axis's drive, and what follows its warning bit."""

    sensor: str
    axis: int
    unit: str  # of the effort
    follows: Follows
    tolerance: float  # drive's unit, between the effort that it measures and those that it was sent
    settling_ticks: int  # within which its effort follows a command
    bridged_ticks: int  # ticks in a row for which it may be off: a command may be lost on its way
    load_tolerance: float = inf  # drive's unit, between the effort that a motion takes and what the machine file says of it
    stop_tolerance: float = inf  # drive's unit, beyond which an effort that is off stops the motors whatever follows otherwise


@dataclass(frozen=True)
class JudgingSettings:
    """All that is judged on a machine; nothing where it is empty."""

    imu: ImuJudging | None = None
    encoders: tuple[EncoderJudging, ...] = ()
    temperatures: tuple[TemperatureJudging, ...] = ()
    drives: tuple[DriveJudging, ...] = ()
    expects: Expects | None = None  # what the machine file makes of a motion; None: nothing is compared with it
