"""Errors of the sensors: in the loop (encoders) or in the reading alone."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from concealed.truth.kinds import Kind, Shape, axes, no_shape, number, turning_axes
from concealed.truth.plant import IMU_CHANNELS, Machine, Setup


def _with_imu(machine: Machine) -> list[str]:
    return ["imu"] if machine.imu else []


def _quiet_channels(machine: Machine) -> list[str]:
    """Channels that the loop does not use."""
    position = [] if not machine.closed else [f"position_{axis}" for axis in machine.axes]
    return [name for name in machine.channels() if name not in position]


def _signed_channels(machine: Machine) -> list[str]:
    return [name for name in _quiet_channels(machine) if not name.startswith("imu")]


def _eccentric_shape(rng: np.random.Generator, _machine: Machine, _axis: str) -> Shape:
    phases = rng.uniform(-math.pi, math.pi, 2)
    return {"phi": float(phases[0]), "second": float(rng.uniform(0.05, 0.15)), "psi": float(phases[1])}


def _eccentric(setup: Setup, _machine: Machine, axis: str, shape: Shape, s: float) -> None:
    values = {"a": s, "phi": shape["phi"], "b": s * shape["second"], "psi": shape["psi"]}
    setup.encoders |= {(axis, column): value for column, value in values.items()}


def _coarse_shape(_rng: np.random.Generator, machine: Machine, axis: str) -> Shape:
    return {"least": 2.0 * float(machine.counts[machine.axes.index(axis)])}


def _coarse(setup: Setup, _machine: Machine, axis: str, shape: Shape, s: float) -> None:
    """Two of the encoder's own counts or more: a finer lattice would vanish in the encoder's, which the oracle runs without."""
    if s:
        setup.encoders[axis, "lattice"] = max(s, shape["least"])


def _count(share: float):  # type: ignore[no-untyped-def]
    return lambda machine, axis: share * float(machine.counts[machine.axes.index(axis)])


def _reading(kind: str, channels: tuple[str, ...] | None = None):  # type: ignore[no-untyped-def]
    def add(setup: Setup, _machine: Machine, place: str, shape: Shape, s: float) -> None:
        if s:
            setup.readings.append((kind, channels or (IMU_CHANNELS if place == "imu" else (place,)), {**shape, "s": s}))

    return add


def _direction(rng: np.random.Generator, _machine: Machine, _place: str) -> Shape:
    x, y, z = rng.normal(size=3)
    length = math.sqrt(x * x + y * y + z * z)
    return {"x": float(x / length), "y": float(y / length), "z": float(z / length)}


def _scale_shape(rng: np.random.Generator, _machine: Machine, _place: str) -> Shape:
    kind = rng.integers(0, 3)  # scale, bias, both
    shape = {name: float(value) for name, value in zip(("sx", "sy", "sz"), rng.uniform(-1.0, 1.0, 3) * (kind != 1), strict=True)}
    return shape | {name: float(value) for name, value in zip(("bx", "by", "bz"), rng.uniform(-2.0, 2.0, 3) * (kind != 0), strict=True)}


def _scale_values(shape: Shape, s: float) -> dict[str, float]:
    return {name: value * s for name, value in shape.items() if value}


def _low_pass(setup: Setup, _machine: Machine, _place: str, _shape: Shape, s: float) -> None:
    """Strength s is the lag [s] of a second pole behind the machine file's own."""
    if s:
        setup.imu_pole_Hz = 1.0 / (2.0 * math.pi * s)


def _late_shape(rng: np.random.Generator, _machine: Machine, _place: str) -> Shape:
    return {"drift": float(rng.choice([0.0, 0.05, 0.1]))}


KINDS = (
    Kind(
        "encoder_eccentricity", ("encoder_eccentricity",), turning_axes, _eccentric_shape, _eccentric, number(0.002), number(0.05),
        ("gravity_imbalance", "gear_ratio", "cable_spring"), ("phi", "second"), compare=lambda _shape, s: {"a": s}, sensor=True,
    ),
    Kind(
        "encoder_quantization", ("encoder_quantization",), axes, _coarse_shape, _coarse, _count(10.0), _count(400.0),
        compare=lambda shape, s: {"q": max(s, shape["least"])}, sensor=True, lattice=True,
    ),
    Kind(
        "imu_misalignment", ("imu_misalignment",), _with_imu, _direction, _reading("turned", IMU_CHANNELS), number(0.01), number(0.3),
        ("imu_scale_bias",), sensor=True,
    ),
    Kind(
        "imu_scale_bias", ("imu_scale_bias",), _with_imu, _scale_shape, _reading("scaled", IMU_CHANNELS[:3]), number(0.01), number(0.15),
        ("imu_misalignment",), compare=_scale_values, sensor=True,
    ),
    Kind(
        "imu_bandwidth", ("imu_bandwidth",), _with_imu, no_shape, _low_pass, number(0.003), number(0.03), ("clock_offset:imu",),
        sensor=True,
    ),
    Kind(
        "clock_offset", ("clock_offset",), _quiet_channels, _late_shape, _reading("late"), number(0.003), number(0.05), ("delay",),
        compare=lambda _shape, s: {"t0": s}, sensor=True,
    ),
    Kind(
        "sample_dropout", ("sample_dropout",), _quiet_channels, no_shape, _reading("held"), number(0.03), number(0.4), sensor=True,
    ),
    Kind(
        "rectified_sensor", ("rectified_sensor",), _signed_channels, no_shape, _reading("rectified"), number(1.0), number(1.0),
        fixed=True, sensor=True,
    ),
)  # fmt: skip


def loses(setup: Setup) -> bool:
    """Whether the case's recordings lose samples, each at its own times."""
    return any(kind == "held" for kind, _, _ in setup.readings)


def with_losses(setup: Setup, channels: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Channels as they arrive: in place of a lost reading the last one, its noise in it."""
    channels = dict(channels)
    for kind, names, p in setup.readings:
        if kind == "held":
            for name in names:
                channels[name] = _held(channels[name], p["s"], rng)
    return channels


def read(setup: Setup, channels: dict[str, np.ndarray], rate_Hz: float) -> dict[str, np.ndarray]:
    """Channels as erring sensors read them, none of them lost."""
    channels = dict(channels)
    for kind, names, p in setup.readings:
        s = p["s"]
        if kind == "turned":
            turn = Rotation.from_euler("xyz", [s * p["x"], s * p["y"], s * p["z"]]).as_matrix()
            for group in (IMU_CHANNELS[:3], IMU_CHANNELS[3:]):
                channels |= dict(zip(group, turn @ np.array([channels[name] for name in group]), strict=True))
        elif kind == "scaled":
            for axis, name in zip("xyz", names, strict=True):
                channels[name] = channels[name] * (1.0 + s * p[f"s{axis}"]) + s * p[f"b{axis}"]
        elif kind == "late":
            for name in names:
                channels[name] = _late(channels[name], s, p["drift"] * s, rate_Hz)
        elif kind == "rectified":
            for name in names:
                y = channels[name]
                channels[name] = y + s * (np.abs(y) - y)
    return channels


def _late(y: np.ndarray, offset_s: float, drift: float, rate_Hz: float) -> np.ndarray:
    """y(t (1 - drift) - offset), by cubic interpolation; before the start it stood still."""
    t = np.arange(len(y)) / rate_Hz
    return np.asarray(CubicSpline(t, y)(np.maximum(t * (1.0 - drift) - offset_s, 0.0)))


def _held(y: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Gilbert's two states: bursts of a mean of three samples in which the last good one repeats."""
    leave = 1.0 / 3.0
    enter = leave * share / (1.0 - share)
    chance, bad, last, out = rng.random(len(y)), False, y[0], y.copy()
    for k in range(1, len(y)):
        bad = chance[k] > leave if bad else chance[k] < enter
        if bad:
            out[k] = last
        else:
            last = y[k]
    return out
