"""Efforts, springs and inertia: what acts on a joint besides friction, in the catalogue and off it."""

from __future__ import annotations

import math

import numpy as np

from concealed.truth import joint_physics as physics
from concealed.truth.kinds import Kind, Shape, axes, effort, inertia, no_shape, number, other_axis, paired_axes, sprung_axes, turning_axes
from concealed.truth.plant import Machine, Setup


def _uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _phase(rng: np.random.Generator) -> float:
    return _uniform(rng, -math.pi, math.pi)


def _at(setup: Setup, machine: Machine, axis: str, kind: int, parameters: list[float], other: str = "") -> None:
    setup.joints.append((kind, machine.joint_of[axis], other, parameters))


def _behind(setup: Setup, machine: Machine, axis: str, kind: int, parameters: list[float]) -> None:
    setup.joints.append((kind, machine.spring_behind(axis), machine.joint_of[axis], parameters))


def _spring(setup: Setup, machine: Machine, axis: str) -> float:
    """Stiffness of the spring behind an axis, as the case has it."""
    joint = machine.spring_behind(axis)
    return machine.stiffness(joint) * setup.factors.get(f"stiffness:{joint}", 1.0)


def _imbalance_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"phi": _phase(rng), "third": _uniform(rng, -0.02, 0.02)}


def _imbalance(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _at(setup, machine, axis, physics.IMBALANCE, [s, shape["phi"], shape["third"]])


def _hose_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    reach = machine.reach(axis)
    return {"bend": _uniform(rng, 0.35, 0.7) * reach, "at": _uniform(rng, -0.3, 0.3) * reach, "side": 0.0}


def _hose(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _at(setup, machine, axis, physics.HOSE, [s, shape["bend"], shape["at"], shape["side"]])


def _load(setup: Setup, machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    _at(setup, machine, axis, physics.LOAD, [s, 0.01])


def _shake_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"f": _uniform(rng, 2.0, 14.0), "phi": _phase(rng), "second": _uniform(rng, 0.02, 0.06)}


def _shake(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _at(setup, machine, axis, physics.SHAKE, [s, shape["f"], shape["phi"], shape["second"]])


def _cogging_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    per_turn = float(rng.integers(6, 25)) * math.pi / machine.reach(axis)
    return {"Np": per_turn, "phi1": _phase(rng), "second": _uniform(rng, 0.2, 0.5), "phi2": _phase(rng), "third": _uniform(rng, 0.0, 0.08)}


def _cogging(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    row = [shape["Np"], s, shape["phi1"], s * shape["second"], shape["phi2"], s * shape["third"]]
    _at(setup, machine, axis, physics.COGGING, row)


def _gap_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"loss": _uniform(rng, 0.05, 0.4)}


def _gap(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    if s:
        _behind(setup, machine, axis, physics.CONTACT_GAP, [_spring(setup, machine, axis), 0.0, s, shape["loss"], 0.0])


def _hardening_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    deflection = 1.5 * machine.effort_scale(axis) / machine.stiffness(machine.spring_behind(axis))
    return {"corner": _uniform(rng, 0.3, 0.6) * deflection}


def _hardening(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _behind(setup, machine, axis, physics.PIECEWISE_SPRING, [s * _spring(setup, machine, axis), shape["corner"], 0.0])


def _compliance(setup: Setup, machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    stiffness = machine.stiffness(machine.spring_behind(axis))
    setup.springs[machine.spring_behind(axis)] = (s / stiffness, 0.0)


def _iwan_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    deflection = 1.5 * machine.effort_scale(axis) / machine.stiffness(machine.spring_behind(axis))
    return {"travel": _uniform(rng, 0.15, 0.4) * deflection}


def _iwan(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    if s:
        _behind(setup, machine, axis, physics.FRICTION, [float(physics.CONSTANT_LEVEL), shape["travel"], 8.0, s])


def _mode_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"f": _uniform(rng, 4.0, 14.0), "zeta": _uniform(rng, 0.01, 0.05)}


def _mode(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    if s:
        w = 2.0 * math.pi * shape["f"]
        _at(setup, machine, axis, physics.ADDED_MODE, [s, s * w * w, 2.0 * shape["zeta"] * w * s])


def _stop_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    side = float(rng.choice([-1.0, 1.0]))
    return {"side": side, "at": side * _uniform(rng, 0.3, 0.5) * machine.reach(axis), "loss": _uniform(rng, 0.1, 0.5)}


def _stop(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _at(setup, machine, axis, physics.STOP, [shape["at"], s, shape["loss"], shape["side"]])


def _coupling_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"phi": _phase(rng), "second": _uniform(rng, 0.0, 0.05)}


def _coupling(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    other = machine.joint_of[other_axis(machine, axis)]
    _at(setup, machine, axis, physics.COUPLING, [s, shape["phi"], shape["second"]], other)


def _pose_inertia(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    other = machine.joint_of[other_axis(machine, axis)]
    _at(setup, machine, axis, physics.POSE_INERTIA, [s, shape["phi"], shape["second"]], other)


def _transmission_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    per_turn = float(rng.integers(3, 12)) * math.pi / machine.reach(axis)
    return {"k": per_turn, "phi1": _phase(rng), "second": _uniform(rng, 0.2, 0.5), "phi2": _phase(rng)}


def _transmission(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    stiffness = _spring(setup, machine, axis)
    _behind(setup, machine, axis, physics.TRANSMISSION, [stiffness, 0.0, shape["k"], s, shape["phi1"], s * shape["second"], shape["phi2"]])


def _heavy_bodies(machine: Machine) -> list[str]:
    return [
        body["name"]
        for body in machine.table["body"]
        if body.get("mass_kg", 0.0) >= 2.0 and body["name"] not in ("ceiling_mount", "support_arm")
    ]


def _payload_shape(rng: np.random.Generator, _machine: Machine, _body: str) -> Shape:
    return {"distance": _uniform(rng, 0.0, 0.05)}


def _payload(setup: Setup, _machine: Machine, body: str, shape: Shape, s: float) -> None:
    setup.masses.append((body, s, shape["distance"]))


def _body_mass(share: float):  # type: ignore[no-untyped-def]
    return lambda machine, body: share * float(next(b["mass_kg"] for b in machine.table["body"] if b["name"] == body))


def deflection(share: float):  # type: ignore[no-untyped-def]
    """A share of what the spring gives under a tenth of the drive's effort."""
    return lambda machine, axis: share * machine.effort_scale(axis) / machine.stiffness(machine.spring_behind(axis))


def spring_rate(share: float):  # type: ignore[no-untyped-def]
    """A tenth of the drive's effort over half the range, times `share`."""
    return lambda machine, axis: share * machine.effort_scale(axis) / machine.reach(axis)


KINDS = (
    Kind(
        "gravity_imbalance", ("gravity_imbalance",), turning_axes, _imbalance_shape, _imbalance, effort(0.2), effort(3.0),
        ("constant_load", "cable_spring"), ("phi",), compare=lambda _shape, s: {"mgr": s},
    ),
    Kind(
        "cable_spring", ("cable_spring",), axes, _hose_shape, _hose, spring_rate(0.1), spring_rate(2.5),
        ("gravity_imbalance", "constant_load"), ("bend", "at"),
        local=True,
    ),
    Kind(
        "constant_load", ("constant_load",), axes, no_shape, _load, effort(0.1), effort(3.0),
        ("gravity_imbalance", "asymmetric_friction"), compare=lambda _shape, s: {"tau0": s},
    ),
    Kind(
        "base_motion", ("base_motion",), axes, _shake_shape, _shake, effort(0.1), effort(2.0), ("structural_mode",), ("f", "phi"),
        compare=lambda shape, s: {"A": s, "f": shape["f"]},
    ),
    Kind(
        "cogging", ("cogging",), axes, _cogging_shape, _cogging, effort(0.1), effort(3.0),
        ("torque_ripple", "transmission_error", "encoder_eccentricity"), ("phi1", "second", "phi2"),
        compare=lambda _shape, s: {"A1": s},
    ),
    Kind(
        "backlash", ("backlash",), sprung_axes, _gap_shape, _gap, deflection(0.1), deflection(1.0),
        ("presliding_hysteresis", "joint_compliance", "nonlinear_stiffness"), compare=lambda _shape, s: {"b": s},
    ),
    Kind(
        "nonlinear_stiffness", ("nonlinear_stiffness",), sprung_axes, _hardening_shape, _hardening, number(0.4), number(4.0),
        ("joint_compliance", "backlash"), ("corner",),
    ),
    Kind(
        "joint_compliance", ("joint_compliance",), sprung_axes, no_shape, _compliance, number(0.2), number(1.5),
        ("nonlinear_stiffness", "payload"), tuned=True,
    ),
    Kind(
        "bouc_wen_hysteresis", ("bouc_wen_hysteresis", "presliding_hysteresis"), sprung_axes, _iwan_shape, _iwan, effort(0.1), effort(2.0),
        ("backlash", "nonlinear_stiffness", "joint_compliance"), ("travel",),
    ),
    Kind(
        "structural_mode", ("structural_mode",), axes, _mode_shape, _mode, inertia(0.05), inertia(0.5),
        ("base_motion", "joint_compliance", "drive_bandwidth"), ("f", "zeta"), compare=lambda shape, _s: {"f": shape["f"]},
    ),
    Kind(
        "end_stop", ("end_stop",), axes, _stop_shape, _stop, spring_rate(3.0), spring_rate(60.0), ("cable_spring",), ("at",),
        compare=lambda shape, _s: {"at_position": shape["at"]}, local=True,
    ),
    Kind(
        "axis_coupling", ("axis_coupling",), paired_axes, _coupling_shape, _coupling, inertia(0.05), inertia(0.3),
        ("pose_dependent_dynamics",), ("phi",),
    ),
    Kind(
        "pose_dependent_dynamics", ("pose_dependent_dynamics",), paired_axes, _coupling_shape, _pose_inertia, inertia(0.1), inertia(1.0),
        ("axis_coupling", "payload"), ("phi",),
    ),
    Kind(
        "transmission_error", ("transmission_error",), sprung_axes, _transmission_shape, _transmission, deflection(0.05), deflection(0.6),
        ("cogging",), ("phi1", "second", "phi2"), compare=lambda _shape, s: {"e1": s},
    ),
    Kind(
        "payload", ("payload",), _heavy_bodies, _payload_shape, _payload, _body_mass(0.15), _body_mass(1.0),
        ("torque_constant", "gravity_imbalance"), tuned=True,
    ),
)  # fmt: skip


# ---- off the catalogue ------------------------------------------------------------------------------


def _slosh_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    swing = _uniform(rng, 0.02, 0.06) * machine.reach(axis)
    return {"w": 2.0 * math.pi * _uniform(rng, 0.7, 1.8), "swing": swing, "drag": _uniform(rng, 0.5, 1.5) / swing}


def _slosh(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    if s:
        _at(setup, machine, axis, physics.SLOSH, [s, shape["w"], shape["swing"], shape["drag"]])


def _pulse_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    return {"at": _uniform(rng, -0.25, 0.25) * machine.reach(axis), "decay_s": _uniform(rng, 0.08, 0.3)}


def _pulse(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _at(setup, machine, axis, physics.PULSE, [shape["at"], s, shape["decay_s"]])


def _relaxation_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"tau_s": _uniform(rng, 0.5, 2.0)}


def _relaxation(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _at(setup, machine, axis, physics.RELAXATION, [s, shape["tau_s"]])


def _parametric_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"f": _uniform(rng, 0.15, 1.2)}


def _parametric(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    _behind(setup, machine, axis, physics.PARAMETRIC, [s * _spring(setup, machine, axis), shape["f"]])


OUTSIDE = (
    Kind("sloshing_mass", (), axes, _slosh_shape, _slosh, inertia(0.1), inertia(0.7), refit=("w", "swing", "drag")),
    Kind("position_triggered_pulse", (), axes, _pulse_shape, _pulse, effort(0.5), effort(4.0), refit=("at", "decay_s")),
    Kind("relaxing_spring", (), axes, _relaxation_shape, _relaxation, spring_rate(0.3), spring_rate(4.0), refit=("tau_s",)),
    Kind("stiffness_varying_in_time", (), sprung_axes, _parametric_shape, _parametric, number(0.2), number(0.7), refit=("f",)),
)
