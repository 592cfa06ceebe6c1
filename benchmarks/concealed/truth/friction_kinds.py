"""Friction: sliding levels on Prandtl elements (Maxwell slip), drag, and lubricant that warms."""

from __future__ import annotations

import numpy as np

from concealed.truth import joint_physics as physics
from concealed.truth.kinds import Kind, Shape, axes, effort, heavy_axes, inertia, no_shape, number, paired_axes
from concealed.truth.plant import STEP_S, Machine, Setup

STIFF, SOFT = 4, 8
"""Elements of friction that breaks away at once, and of friction whose presliding shows."""


def _travel(machine: Machine, axis: str, level: float, wanted: float) -> float:
    """Break-away travel: at least what the plant's step can follow."""
    return max(wanted, 10.0 * abs(level) * STEP_S**2 / machine.inertias[machine.joint_of[axis]])


def _stiff(machine: Machine, axis: str, level: float) -> float:
    count = machine.counts[machine.axes.index(axis)]
    return _travel(machine, axis, level, 0.5 * count)


def _row(setup: Setup, machine: Machine, axis: str, law: int, level: float, parameters: list[float], other: str = "") -> None:
    if level != 0.0:
        travel = _stiff(machine, axis, level)
        setup.joints.append((physics.FRICTION, machine.joint_of[axis], other, [float(law), travel, float(STIFF), *parameters]))


def _coulomb(setup: Setup, machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    _row(setup, machine, axis, physics.CONSTANT_LEVEL, s, [s])


def _asymmetric_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"ratio": float(rng.choice([0.3, 0.45, 2.2, 3.0]))}


def _asymmetric(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    plus, minus = (s, s * shape["ratio"]) if shape["ratio"] < 1.0 else (s / shape["ratio"], s)
    _row(setup, machine, axis, physics.BY_DIRECTION, s, [plus, 0.0, minus, 0.0])


def _asymmetric_values(shape: Shape, s: float) -> dict[str, float]:
    plus, minus = (s, s * shape["ratio"]) if shape["ratio"] < 1.0 else (s / shape["ratio"], s)
    return {"Fc_plus": plus, "Fc_minus": minus}


def _stribeck_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    return {"speed": float(rng.uniform(0.06, 0.15)) * machine.reach(axis), "skew": float(rng.uniform(0.9, 1.1))}


def _stribeck(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _row(setup, machine, axis, physics.ARCTANGENT, s, [s, shape["speed"], shape["skew"]])


def _by_load(setup: Setup, machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    _row(setup, machine, axis, physics.BY_LOAD, s * 10.0 * machine.effort_scale(axis), [s, 0.003 * machine.effort_scale(axis)])


def _position_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    periods = rng.uniform(0.8, 2.5)  # over the whole range
    return {
        "cycles": float(periods * np.pi / machine.reach(axis)),
        "phi": float(rng.uniform(-np.pi, np.pi)),
        "third": float(rng.uniform(-0.05, 0.05)),
    }


def _by_position(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _row(setup, machine, axis, physics.BY_POSITION, s, [s, shape["cycles"], shape["phi"], shape["third"]])


def _presliding_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    return {"travel": float(rng.uniform(0.01, 0.03)) * machine.reach(axis)}


def _presliding(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    if s:
        travel = _travel(machine, axis, s, shape["travel"])
        setup.joints.append((physics.FRICTION, machine.joint_of[axis], "", [float(physics.CONSTANT_LEVEL), travel, float(SOFT), s]))


def _viscous(setup: Setup, machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    setup.joints.append((physics.VISCOUS, machine.joint_of[axis], "", [s, 0.02 / (2.0 * machine.reach(axis))]))


def _drag_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"power": float(rng.uniform(1.9, 2.1))}


def _drag(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    setup.joints.append((physics.DRAG, machine.joint_of[axis], "", [s, shape["power"]]))


def _warming_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {
        "fluidity": float(rng.uniform(0.03, 0.06)),
        "film_s": float(rng.uniform(4.0, 8.0)),
        "housing_s": 60.0,
        "rise": float(rng.uniform(20.0, 40.0)),
    }


def _warming(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    """Friction s at the start; it warms by `rise` kelvin at the power it would make at a typical speed."""
    if s:
        speed = 0.5 * machine.reach(axis)
        row = [s, shape["fluidity"], shape["rise"] / (s * speed**2), shape["film_s"], 0.2, shape["housing_s"]]
        setup.joints.append((physics.WARMING, machine.joint_of[axis], "", row))


def per_speed(share: float):  # type: ignore[no-untyped-def]
    """A share of a tenth of the drive's effort at a speed that crosses the range's half in a second."""
    return lambda machine, axis: share * machine.effort_scale(axis) / machine.reach(axis)


def per_speed_squared(share: float):  # type: ignore[no-untyped-def]
    """The same for a drag that grows with the square."""
    return lambda machine, axis: share * machine.effort_scale(axis) / machine.reach(axis) ** 2


KINDS = (
    Kind(
        "coulomb_friction", ("coulomb_friction",), axes, no_shape, _coulomb, effort(0.1), effort(4.0),
        ("viscous_friction", "load_dependent_friction", "asymmetric_friction", "stribeck_friction", "presliding_hysteresis"),
        compare=lambda _shape, s: {"Fc": s},
    ),
    Kind(
        "asymmetric_friction", ("asymmetric_friction",), axes, _asymmetric_shape, _asymmetric, effort(0.15), effort(4.0),
        ("coulomb_friction", "constant_load", "gravity_imbalance"), ("ratio",), compare=_asymmetric_values,
    ),
    Kind(
        "viscous_friction", ("viscous_friction",), axes, no_shape, _viscous, per_speed(0.2), per_speed(6.0),
        ("coulomb_friction", "quadratic_friction"), tuned=True,
    ),
    Kind(
        "quadratic_friction", ("quadratic_friction",), axes, _drag_shape, _drag, per_speed_squared(0.2), per_speed_squared(8.0),
        ("viscous_friction", "coulomb_friction"), ("power",),
    ),
    Kind(
        "stribeck_friction", ("stribeck_friction",), axes, _stribeck_shape, _stribeck, effort(0.15), effort(4.0),
        ("coulomb_friction", "presliding_hysteresis"), ("speed",),
    ),
    Kind(
        "load_dependent_friction", ("load_dependent_friction",), heavy_axes, no_shape, _by_load, number(0.02), number(0.4),
        ("coulomb_friction", "position_dependent_friction"),
    ),
    Kind(
        "position_dependent_friction", ("position_dependent_friction",), axes, _position_shape, _by_position, effort(0.2), effort(4.0),
        ("coulomb_friction", "load_dependent_friction"), ("cycles", "phi"),
    ),
    Kind(
        "temperature_dependent_friction", ("temperature_dependent_friction",), axes, _warming_shape, _warming, per_speed(0.5),
        per_speed(8.0), ("viscous_friction", "quadratic_friction"), ("fluidity", "film_s"),
    ),
    Kind(
        "presliding_hysteresis", ("presliding_hysteresis", "bouc_wen_hysteresis"), axes, _presliding_shape, _presliding, effort(0.15),
        effort(4.0), ("coulomb_friction", "backlash", "stribeck_friction"), ("travel",),
    ),
)  # fmt: skip


# ---- friction that the catalogue does not have ------------------------------------------------------


def _wear_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    return {"distance": float(rng.uniform(3.0, 6.0)) * machine.reach(axis)}


def _wear(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _row(setup, machine, axis, physics.WEAR, s, [s, shape["distance"]])


def _window_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    start = rng.uniform(1.5, 5.0)
    return {"from_s": float(start), "to_s": float(start + rng.uniform(1.0, 2.5))}


def _window(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _row(setup, machine, axis, physics.WINDOW, s, [s, shape["from_s"], shape["to_s"]])


def _cross(setup: Setup, machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    other = machine.joint_of[machine.axes[1 - machine.axes.index(axis)]]
    _row(setup, machine, axis, physics.BY_OTHER_SPEED, s * machine.reach(axis), [s], other)


def _accelerated(setup: Setup, machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    level = s * machine.reach(axis) * 2.0
    _row(setup, machine, axis, physics.BY_ACCELERATION, level, [s, 0.02])


OUTSIDE = (
    Kind("friction_growing_with_travel", (), axes, _wear_shape, _wear, effort(0.3), effort(4.0)),
    Kind("stick_event", (), axes, _window_shape, _window, effort(0.3), effort(4.0)),
    Kind("friction_by_other_axis_speed", (), paired_axes, no_shape, _cross, per_speed(0.3), per_speed(8.0)),
    Kind("friction_by_acceleration", (), axes, no_shape, _accelerated, inertia(0.05), inertia(0.4)),
)
