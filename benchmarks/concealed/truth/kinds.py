"""What a kind of hidden physics is: where it may act, how it is drawn, what it adds, and which names are right for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from concealed.truth.plant import Machine, Setup

Shape = dict[str, float]


@dataclass(frozen=True)
class Kind:
    """One kind of physics.

    Attributes
    ----------
    name : str
        The catalogue's name, or the benchmark's own for physics off the catalogue.
    accepted : tuple of str
        Catalogue names that are right for this physics; none off the catalogue.
    places : callable
        Machine -> where it may act (axes, bodies, channels).
    draw : callable
        (rng, machine, place) -> shape: everything but the strength.
    add : callable
        (setup, machine, place, shape, strength): strength 0 adds nothing.
    typical : callable
        (machine, place) -> a strength to start the search for the detection limit from.
    largest : callable
        (machine, place) -> strength beyond which the machine cannot be run or the physics changes its kind.
    neighbours : tuple of str
        Kinds it may be mistaken for.
    refit : tuple of str
        Shape entries that a fit of the true structure would adjust.
    compare : callable
        (shape, strength) -> catalogue parameters that mean the same in both equations, for interval coverage.
    tuned : bool
        A parameter of the machine file is what changed: the verdict `retuned` is right, too.
    fixed : bool
        Is there or not: always at its largest strength.
    local : bool
        Acts at some positions only.
    sensor : bool
        Acts in a sensor alone.
    lattice : bool
        Rounds what a loop reads.
    least : float
        Strength near none of what does not vanish with it. What it does is no part of what a detection limit counts.
    """

    name: str
    accepted: tuple[str, ...]
    places: Callable[[Machine], list[str]]
    draw: Callable[[np.random.Generator, Machine, str], Shape]
    add: Callable[[Setup, Machine, str, Shape, float], None]
    typical: Callable[[Machine, str], float]
    largest: Callable[[Machine, str], float]
    neighbours: tuple[str, ...] = ()
    refit: tuple[str, ...] = ()
    compare: Callable[[Shape, float], dict[str, float]] = lambda _shape, _strength: {}
    tuned: bool = False
    fixed: bool = False
    local: bool = False
    sensor: bool = False
    lattice: bool = False
    least: float = 0.0


def axes(machine: Machine) -> list[str]:
    """Every driven axis."""
    return list(machine.axes)


def turning_axes(machine: Machine) -> list[str]:
    """Axes of revolute joints."""
    return [axis for axis, length in zip(machine.axes, machine.length, strict=True) if not length]


def heavy_axes(machine: Machine) -> list[str]:
    """Axes that gravity loads."""
    return [axis for axis in turning_axes(machine) if axis != "pan"]


def sprung_axes(machine: Machine) -> list[str]:
    """Axes with a spring behind the motor side."""
    return [axis for axis in machine.axes if machine.spring_behind(axis)]


def paired_axes(machine: Machine) -> list[str]:
    """Axes that have a neighbour."""
    return list(machine.axes) if len(machine.axes) > 1 else []


def closed_axes(machine: Machine) -> list[str]:
    """Axes in a loop."""
    return list(machine.axes) if machine.closed else []


def other_axis(machine: Machine, axis: str) -> str:
    """The next axis, the first one after the last."""
    return machine.axes[(machine.axes.index(axis) + 1) % len(machine.axes)]


def no_shape(_rng: np.random.Generator, _machine: Machine, _place: str) -> Shape:
    """Nothing but a strength."""
    return {}


def effort(share: float) -> Callable[[Machine, str], float]:
    """A share of a tenth of the drive's effort."""
    return lambda machine, axis: share * machine.effort_scale(axis)


def number(value: float) -> Callable[[Machine, str], float]:
    """The same everywhere."""
    return lambda _machine, _place: value


def inertia(share: float) -> Callable[[Machine, str], float]:
    """A share of the inertia that a joint alone accelerates."""
    return lambda machine, axis: share * machine.inertias[machine.joint_of[axis]]
