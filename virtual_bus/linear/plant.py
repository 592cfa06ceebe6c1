"""A plant, its drives and its sensors as one linear system about rest at a pose.

With joint positions q, speeds v, memories m of effects and currents i of drives that lag,

    M v' = -K q - D v + E m + g (f_i i + f_v v + f_q q),   m' = R m + S (q, v, v'),   i'' = w^2 (u - i) - 2 zeta w i',

where K is the gradient of all static efforts, D that of all efforts with speed, g f the drives' efforts on their joints, u the target of
a drive, `delay_s` after it was applied. Without a lag i is u. Sensors read y = G (C x + D u), `age_s` late.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from virtual_bus.effects.places import imu_channel_names, joint_at
from virtual_bus.effects.registry import module_of
from virtual_bus.effects.table import values_of
from virtual_bus.linear.drives import drive_slopes, friction_slopes
from virtual_bus.linear.left_out import LeftOut, left_out, linear_parts
from virtual_bus.linear.sensors import reading_gains
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.linearise import imu_gradients, inertia_matrix
from virtual_bus.plant.statics import DIFFERENCE, equilibrium, static_effort, static_stiffness
from virtual_bus.settings import EffectSetting

if TYPE_CHECKING:
    import control


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """x' = A x + B u, y = C x + D u, and the names of u, y and x.

    Attributes
    ----------
    A, B, C, D : arrays (n, n), (n, axes), (k, n), (k, axes)
    input_labels : `command_<axis>`: targets of the drives, in their units
    output_labels : channels as in recordings: every encoder and speed sensor, then specific forces and angular rates of every IMU
    state_labels : joint positions, then joint speeds, then memories of effects, drives that lag, and the IMUs' low passes
    delay_s : (axes,) how much later than its target a drive acts [s]
    age_s : (k,) how old a channel's reading is [s]
    moving : number of states before the IMUs' low passes, on which no motion depends
    left_out : effects of the machine that are not in it
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    input_labels: tuple[str, ...]
    output_labels: tuple[str, ...]
    state_labels: tuple[str, ...]
    delay_s: np.ndarray
    age_s: np.ndarray
    moving: int
    left_out: tuple[LeftOut, ...] = ()

    @property
    def poles(self) -> np.ndarray:
        """Poles of the motion (moving,) complex [rad/s]."""
        poles: np.ndarray = np.linalg.eigvals(self.A[: self.moving, : self.moving])
        return poles

    def state_space(self) -> control.StateSpace:
        """Return the same system for python-control, without delays and ages, which a finite continuous state cannot have.

        python-control is imported here because it takes as long to load as everything else together.
        """
        import control

        return control.ss(
            self.A, self.B, self.C, self.D,
            inputs=list(self.input_labels), outputs=list(self.output_labels), states=list(self.state_labels), name="plant",
        )  # fmt: skip


def linearised(plant: CompiledPlant, axis_positions: np.ndarray) -> LinearPlant:
    """Return the machine for small motions about rest at these axis positions (axes,), held there by its drives.

    Actuated joints are free and brakes open. Effects are in it as far as they have a linear part; the rest is listed in `left_out`.
    """
    settings, n = plant.settings, plant.joints
    chosen = linear_parts(settings.effects)
    model = plant.model(effects=chosen)
    q = equilibrium(plant, model, axis_positions)
    axes = len(settings.drives)
    driven = plant.driven_joints
    slopes = drive_slopes(plant, model, q, static_effort(plant, model, q)[driven])
    stiffness, damping = static_stiffness(plant, model, q), _damping(plant, model, q) + friction_slopes(plant, model)
    stiffness[driven, driven] -= slopes.by_position
    damping[driven, driven] -= slopes.by_speed

    axis_of = {drive.axis: axis for axis, drive in enumerate(settings.drives)}
    following = {axis_of[each.at]: module_of(each.name).error_system(*values_of(each)) for each in chosen if _may_lag(each)}
    lagging = {axis: system for axis, system in following.items() if system.size}
    memories = [_Memory(setting, plant) for setting in chosen if hasattr(module_of(setting.name), "slopes")]
    first_memory = 2 * n
    first_lag = first_memory + sum(each.size for each in memories)
    size = first_lag + 2 * len(lagging)
    speeding = np.zeros((n, size))  # M v'
    speeding[:, :n], speeding[:, n : 2 * n] = -stiffness, -damping
    driving = np.zeros((n, axes))
    driving[driven, np.arange(axes)] = slopes.by_current
    a, b = np.zeros((size, size)), np.zeros((size, axes))
    start = first_memory
    for each in memories:
        own = slice(start, start + each.size)
        speeding[each.joint, own] += each.slopes.effort_of_memory
        speeding[each.joint, each.joint] += each.slopes.effort_of_motion[0]
        speeding[each.joint, n + each.joint] += each.slopes.effort_of_motion[1]
        a[own, own] = each.slopes.memory
        start += each.size
    for number, (axis, system) in enumerate(lagging.items()):
        own = slice(first_lag + 2 * number, first_lag + 2 * number + 2)
        speeding[:, own.start] = driving[:, axis]
        driving[:, axis] = 0.0
        a[own, own] = system
        b[own, axis] = -system[:, 0]
    inverse = np.linalg.inv(inertia_matrix(plant, model, q))
    acceleration, at_once = inverse @ speeding, inverse @ driving
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n], b[n : 2 * n] = acceleration, at_once
    start = first_memory
    for each in memories:
        own = slice(start, start + each.size)
        by_position, by_speed, by_acceleration = each.slopes.motion.T
        a[own, each.joint] += by_position
        a[own, n + each.joint] += by_speed
        a[own] += np.outer(by_acceleration, acceleration[each.joint])
        b[own] += np.outer(by_acceleration, at_once[each.joint])
        start += each.size

    encoders = np.zeros((len(settings.joint_sensors), size))
    for row, sensor in zip(encoders, settings.joint_sensors, strict=True):
        for joint in sensor.joints:
            row[settings.tree.joint_index(joint) + (n if sensor in settings.speeds else 0)] += 1.0
    of_position, of_speed, of_acceleration = imu_gradients(plant, model, q)
    imu = of_acceleration @ acceleration
    imu[:, :n] += of_position
    imu[:, n : 2 * n] += of_speed
    a, b, imu, imu_direct, filtered = _through_low_passes(model, a, b, imu, of_acceleration @ at_once)
    c = np.vstack([np.hstack([encoders, np.zeros((len(encoders), len(a) - size))]), imu])
    d = np.vstack([np.zeros((len(encoders), axes)), imu_direct])

    channels = imu_channel_names(settings)
    outputs = [*(sensor.channel for sensor in settings.joint_sensors), *channels]
    gains, ages = reading_gains(settings, chosen, outputs, q)
    joints = [joint.name for joint in settings.tree.joints]
    states = joints + [f"{joint}_speed" for joint in joints]
    states += [f"{each.name}_{k + 1}" for each in memories for k in range(each.size)]
    states += [f"{what}_{settings.drives[axis].axis}" for axis in lagging for what in ("current", "current_rate")]
    states += [f"{channels[k]}_filter{rate}" for k, rate in filtered]
    return LinearPlant(
        a, b, gains @ c, gains @ d,
        tuple(f"command_{drive.axis}" for drive in settings.drives), tuple(outputs), tuple(states),
        model["delay_samples"][0, :axes] * settings.sample_period_s, ages, size, left_out(settings.effects),
    )  # fmt: skip


def _may_lag(setting: EffectSetting) -> bool:
    return hasattr(module_of(setting.name), "error_system")


class _Memory:
    """An effect with a memory, and the joint that it acts on."""

    def __init__(self, setting: EffectSetting, plant: CompiledPlant) -> None:
        self.slopes = module_of(setting.name).slopes(*values_of(setting))
        self.name = f"{setting.name}_{setting.at}"
        self.joint = plant.settings.tree.joint_index(joint_at(setting.at, plant.settings))
        self.size = len(self.slopes.memory)


def _damping(plant: CompiledPlant, model: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the gradient (n, n) of all efforts against motion with the joint speeds, at rest."""
    n = plant.joints
    shifts = DIFFERENCE * np.vstack([np.eye(n), -np.eye(n)])
    _, bias = plant.inertia_and_bias(model, np.tile(q, (2 * n, 1)), shifts)
    gradient: np.ndarray = (bias[:n] - bias[n:]).T / (2.0 * DIFFERENCE)
    return gradient + np.diag(model["damping"][0])


def _through_low_passes(
    model: np.ndarray, a: np.ndarray, b: np.ndarray, imu: np.ndarray, direct: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, list[tuple[int, str]]]:
    """Return the system with the IMUs' low passes, its IMU rows, and channel and kind of every state of theirs."""
    is_filtered = model["is_filtered"][0, : len(imu)] > 0
    filtered = np.flatnonzero(is_filtered)
    lags, squares = model["filter_lag"][0, filtered].T
    second = np.flatnonzero(squares > 0.0)  # of the filtered ones: their rates of change are states too
    pull = 1.0 / np.where(squares > 0.0, squares, lags)  # of the input on the last derivative
    many, more, before = len(filtered), len(second), len(a)
    to_rate = np.eye(many)[second]
    is_first = np.where(squares > 0.0, 0.0, 1.0)
    low_passes = np.block([
        [-np.diag(is_first * pull), to_rate.T],
        [-pull[second, None] * to_rate, -np.diag((lags * pull)[second])],
    ])  # fmt: skip
    driven = np.vstack([np.diag(is_first * pull), pull[second, None] * to_rate])
    a = np.block([[a, np.zeros((before, many + more))], [driven @ imu[filtered], low_passes]])
    b = np.vstack([b, driven @ direct[filtered]])
    from_filter = np.zeros((len(imu), many + more))
    from_filter[filtered, np.arange(many)] = 1.0
    rows = np.hstack([np.where(is_filtered[:, None], 0.0, imu), from_filter])
    kinds = [(int(k), "") for k in filtered] + [(int(k), "_rate") for k in filtered[second]]
    return a, b, rows, np.where(is_filtered[:, None], 0.0, direct), kinds
