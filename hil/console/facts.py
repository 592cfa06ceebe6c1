"""What the page knows of the machine: plain values, so that the server needs neither its model nor a compiler."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.settings import BusSettings
from hil.machine import Machine

PRESENT_POSITION = (35, 37)
"""Homing methods by which the present position becomes home (CiA 402); the older number and the newer."""


@dataclass(frozen=True)
class AxisFacts:
    """One axis. Positions in the unit of the page's forms: degrees, or millimetres where it is prismatic."""

    name: str
    unit: str  # "rad" or "m", of its channels
    edge_unit: str  # "deg" or "mm"
    effort_unit: str
    lower: float
    upper: float
    speed: float  # limit, per second
    command_limit: float  # in the effort's unit
    homing: str  # what homing does with it, in words

    def to_edge(self, position: float) -> float:
        """Return a position or speed [rad or m, per second] in the unit of the forms."""
        return position * (180.0 / math.pi if self.unit == "rad" else 1e3)

    def from_edge(self, position: float) -> float:
        """Return a position or speed in the unit of the forms in rad or m (per second)."""
        return position / (180.0 / math.pi if self.unit == "rad" else 1e3)


@dataclass(frozen=True)
class BodyFacts:
    """A body of the machine file, as the page draws it."""

    name: str
    parent: str  # a body before, or "world"
    position_m: list[float]  # in the parent's frame
    orientation: list[list[float]]  # body to parent, at joint position zero
    center_of_mass_m: list[float]  # in the body's frame
    mass_kg: float
    kind: str  # of its joint: revolute, prismatic, or ""
    along: list[float]  # the joint's axis in the body's frame
    rest: float  # where an undriven joint stands [rad or m]
    axis: str  # the axis that drives it, or ""


@dataclass(frozen=True)
class Facts:
    """A machine and where it is."""

    name: str  # as the command line takes it
    title: str
    description: str
    bus: str
    imu: str  # option --imu, "" unless given
    io: str
    rate_Hz: float
    axes: tuple[AxisFacts, ...]
    bodies: tuple[BodyFacts, ...]
    settings: BusSettings
    is_lockstep: bool
    real_time: bool  # whether runs ask for real-time scheduling
    live: bool  # whether the machine is watched between runs

    def axis(self, name: str) -> AxisFacts:
        """Return the facts of an axis."""
        return next(axis for axis in self.axes if axis.name == name)


def facts_of(name: str, machine: Machine, bus: str, imu: str = "", io: str = "", real_time: bool = True, live: bool = False) -> Facts:
    """Gather the facts of a machine that has a bus.

    Parameters
    ----------
    name : str
        Of the machine as the command line takes it, a path made absolute.
    machine : Machine
    bus, imu, io : str
        Options of the command line.
    real_time : bool
        Whether runs ask for real-time scheduling.
    live : bool
        Whether the machine is watched between runs.
    """
    settings = machine.bus
    assert settings is not None
    axes = []
    for units, limit, scaling, homing in zip(machine.units, machine.limits, settings.scalings, settings.homings, strict=True):
        edge, scale = ("deg", 180.0 / math.pi) if units.position == "rad" else ("mm", 1e3)
        push = homing.direction_check_effort * (
            2.0 if any(each.between for each in machine.own_effects) else 1.0
        )  # of load, as of friction
        words = (
            f"{units.axis}: beside what holds it, a push of at most {push:g} {units.effort} "
            f"(limit {scaling.limit:g} {units.effort}) until it has moved {homing.direction_check_travel * scale:.2g} {edge} "
            f"the right way; then homing method {homing.method}"
        )
        words += (
            ", by which it stays where it is" if homing.method in PRESENT_POSITION else f" within {homing.travel_limit * scale:.3g} {edge}"
        )
        lower, upper, speed = limit.lower * scale, limit.upper * scale, limit.speed * scale
        axes.append(AxisFacts(units.axis, units.position, edge, units.effort, lower, upper, speed, scaling.limit, words))
    lockstep, rate_Hz = bus.startswith("lockstep:"), machine.sample_rate_Hz
    return Facts(
        name, machine.name, machine.description, bus, imu, io, rate_Hz, tuple(axes), _bodies(machine), settings, lockstep, real_time, live
    )


def _bodies(machine: Machine) -> tuple[BodyFacts, ...]:
    axis_of = {drive.joint: drive.axis for drive in machine.plant.drives}
    found = []
    for body in machine.plant.tree.bodies:
        joint = body.joint
        place = (body.position_m.tolist(), body.orientation.tolist(), body.center_of_mass_m.tolist(), body.mass_kg)
        moves = ("", [0.0, 0.0, 0.0], 0.0, "")
        if joint is not None:
            moves = (joint.kind, joint.axis.tolist(), joint.rest_position, axis_of.get(joint.name, ""))
        found.append(BodyFacts(body.name, body.parent, *place, *moves))
    return tuple(found)
