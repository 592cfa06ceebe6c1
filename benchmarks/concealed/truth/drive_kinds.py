"""Drives and their gain, in the catalogue and off it."""

from __future__ import annotations

import math

import numpy as np

from concealed.truth import joint_physics as physics
from concealed.truth.kinds import Kind, Shape, axes, closed_axes, no_shape, number, sprung_axes
from concealed.truth.plant import Machine, Setup


def _gain(setup: Setup, _machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    setup.drives[axis, "gain"] = setup.drives.get((axis, "gain"), 1.0) * (1.0 + s)


def _limit(setup: Setup, machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    """Strength s cuts at limit / s: soft, over the last tenth."""
    if s:
        setup.drives[axis, "limit"] = float(machine.limits[machine.axes.index(axis)]) / s


def _poles_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"ratio": float(rng.uniform(1.2, 2.5))}


def _poles(setup: Setup, _machine: Machine, axis: str, shape: Shape, s: float) -> None:
    """Strength s is the lag of both poles together [s]."""
    if s:
        setup.drives[axis, "pole1_Hz"] = (1.0 + 1.0 / shape["ratio"]) / (2.0 * math.pi * s)
        setup.drives[axis, "pole2_Hz"] = setup.drives[axis, "pole1_Hz"] * shape["ratio"]


def _delay(setup: Setup, machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    setup.drives[axis, "delay"] = s * machine.rate_Hz


def _ripple_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    per_turn = float(rng.integers(6, 25)) * math.pi / machine.reach(axis)
    phases = rng.uniform(-math.pi, math.pi, 2)
    return {"Np": per_turn, "phi1": float(phases[0]), "second": float(rng.uniform(0.2, 0.5)), "phi2": float(phases[1])}


def _ripple(setup: Setup, _machine: Machine, axis: str, shape: Shape, s: float) -> None:
    values = {"Np": shape["Np"], "A1": s, "phi1": shape["phi1"], "A2": s * shape["second"], "phi2": shape["phi2"]}
    setup.drives |= {(axis, column): value for column, value in values.items()}


def _geared(machine: Machine) -> list[str]:
    return [axis for axis in machine.axes if machine.link_counts[machine.axes.index(axis)] > 0.0 or machine.imu]


def _ratio(setup: Setup, _machine: Machine, axis: str, _shape: Shape, s: float) -> None:
    setup.encoders[axis, "beta"] = s


KINDS = (
    Kind(
        "torque_constant", ("torque_constant",), axes, no_shape, _gain, number(0.1), number(0.4), ("payload", "viscous_friction"),
        tuned=True,
    ),
    Kind(
        "current_saturation", ("current_saturation",), axes, no_shape, _limit, number(3.0), number(12.0),
        ("torque_constant", "drive_bandwidth"),
    ),
    Kind(
        "drive_bandwidth", ("drive_bandwidth",), axes, _poles_shape, _poles, number(0.004), number(0.03),
        ("delay", "structural_mode", "clock_offset:own_current"), ("ratio",), least=1e-6,
    ),
    Kind(
        "delay", ("delay",), axes, no_shape, _delay, number(0.003), number(0.02), ("drive_bandwidth",),
        compare=lambda _shape, s: {"Td": s},
    ),
    Kind(
        "torque_ripple", ("torque_ripple",), axes, _ripple_shape, _ripple, number(0.05), number(0.35), ("cogging",),
        ("phi1", "second", "phi2"), compare=lambda _shape, s: {"A1": s},
    ),
    Kind(
        "gear_ratio", ("gear_ratio",), _geared, no_shape, _ratio, number(0.005), number(0.08),
        ("encoder_eccentricity", "torque_constant"), compare=lambda _shape, s: {"beta": s},
    ),
)  # fmt: skip


# ---- off the catalogue ------------------------------------------------------------------------------


def _time_gain_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    return {"period_s": float(rng.uniform(2.5, 9.0))}


def _time_gain(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    setup.joints.append((physics.TIME_GAIN, machine.joint_of[axis], "", [s, shape["period_s"]]))


def _magnetic_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    return {"width": float(rng.uniform(0.3, 0.8)) * machine.effort_scale(axis)}


def _magnetic(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    setup.joints.append((physics.MAGNETIC, machine.joint_of[axis], "", [s, shape["width"]]))


def _foldback_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    return {"above": float(rng.uniform(1.0, 2.0)) * machine.effort_scale(axis), "lasts_s": float(rng.uniform(0.3, 1.0))}


def _foldback(setup: Setup, machine: Machine, axis: str, shape: Shape, s: float) -> None:
    setup.joints.append((physics.FOLDBACK, machine.joint_of[axis], "", [s, shape["above"], shape["lasts_s"]]))


def _lost_shape(rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    return {"mark": float(rng.uniform(-0.2, 0.2)) * machine.reach(axis)}


def _lost(setup: Setup, _machine: Machine, axis: str, shape: Shape, s: float) -> None:
    setup.encoders[axis, "lost"], setup.encoders[axis, "mark"] = s, shape["mark"]


def _of_reach(share: float):  # type: ignore[no-untyped-def]
    return lambda machine, axis: share * machine.reach(axis)


OUTSIDE = (
    Kind("gain_varying_in_time", (), axes, _time_gain_shape, _time_gain, number(0.1), number(0.6), refit=("period_s",)),
    Kind("magnetic_hysteresis", (), axes, _magnetic_shape, _magnetic, number(0.2), number(0.7), refit=("width",)),
    Kind("drive_foldback", (), axes, _foldback_shape, _foldback, number(0.2), number(0.6), refit=("above", "lasts_s")),
    Kind("lost_counts", (), lambda m: closed_axes(m) and sprung_axes(m), _lost_shape, _lost, _of_reach(0.0005), _of_reach(0.02)),
)
