"""Plant and feedback fused into one compiled kernel: a whole recording in one call. Timing: docs/notation.md.

At row k the drives apply the target they hold (command k-1), sensors latch, the controller makes command k of that row, and the plant moves on
to k+1 under what the drives apply. Noise is off, quantisation is on.
"""

from __future__ import annotations

import inspect
from types import ModuleType
from typing import NamedTuple

import numpy as np

import controllers.feedback
import controllers.sections
from virtual_bus.plant.compiled import CompiledPlant


class Encoders(NamedTuple):
    """Encoders as arrays: encoder e sums the joints `joints[first[e]:first[e + 1]]`."""

    first: np.ndarray  # (encoders + 1,) int64
    joints: np.ndarray  # int64
    resolution: np.ndarray  # (encoders,) 0: none
    zero: np.ndarray  # (encoders,) where a count edge lies: an incremental encoder counts from its place at power-on
    of_axis: np.ndarray  # (axes,) int64: which encoder the controller of an axis reads


class Efforts(NamedTuple):
    """How efforts are rounded, per axis; 0: not at all."""

    target_resolution: np.ndarray  # (axes,) of the drive's target
    sensor_resolution: np.ndarray  # (axes,) of what the drive reports


class Loop(NamedTuple):
    """The controllers' arrays as `controllers.feedback.feedback_step` takes them. `state` and `held` are advanced in place."""

    sections: np.ndarray
    state: np.ndarray
    rows: np.ndarray
    limit: np.ndarray
    held: np.ndarray


class Rows(NamedTuple):
    """One recording, N rows of n axes: what goes in and what comes out."""

    reference: np.ndarray  # (N, n)
    excitation: np.ndarray  # (N, n)
    feedforward: np.ndarray  # (N, n)
    command: np.ndarray  # (N, n): computed in closed loop, given in open loop
    effort: np.ndarray  # (N, n) what the drives report
    encoders: np.ndarray  # (N, encoders)
    imu: np.ndarray  # (N, 6 imus)


KERNEL = '''"""Generated: closed loop of one plant; do not edit."""

from math import floor

import numpy as np
from PLANT import AXIS_JOINTS, JOINTS, friction_level, imu, mass_and_bias

from controllers.feedback import feedback_step
from virtual_bus.plant import integrator, readings
from virtual_bus.plant.jit import compiled, compiled_and_cached


@compiled
def rounded(value, resolution):
    return floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value


@compiled_and_cached
def run(closed, state, target, brakes, model, work, encoders, efforts, loop, rows):
    """All rows, in place. `target` (n,) is what the drives hold before row 0. Returns the first row with a value that is not finite, or -1."""
    axes = target.shape[0]
    position = np.zeros(axes)
    effort = np.zeros(axes)
    command = np.zeros(axes)
    for k in range(rows.reference.shape[0]):
        for i in range(axes):
            effort[i] = rounded(target[i], efforts.target_resolution[i])
            rows.effort[k, i] = rounded(effort[i], efforts.sensor_resolution[i])
        for e in range(encoders.resolution.shape[0]):
            total = -encoders.zero[e]
            for j in range(encoders.first[e], encoders.first[e + 1]):
                total += state[encoders.joints[j]]
            rows.encoders[k, e] = rounded(total, encoders.resolution[e]) + encoders.zero[e]
        if rows.imu.shape[1] > 0:
            readings.imu_reading(
                JOINTS, AXIS_JOINTS, mass_and_bias, friction_level, imu, state, effort, brakes, model, work, rows.imu[k]
            )
        if closed:
            for i in range(axes):
                position[i] = rows.encoders[k, encoders.of_axis[i]]
            missing = feedback_step(
                loop.sections, loop.state, loop.rows, loop.limit, loop.held,
                rows.reference[k], position, rows.excitation[k], rows.feedforward[k], command,
            )
            if missing != 0:
                return k
            for i in range(axes):
                rows.command[k, i] = command[i]
                target[i] = command[i]
        else:
            for i in range(axes):
                target[i] = min(max(rows.command[k, i], -loop.limit[i]), loop.limit[i])
        integrator.advance(JOINTS, AXIS_JOINTS, mass_and_bias, friction_level, imu, state, effort, brakes, model, work)
    return -1
'''


def closed_loop_kernel(plant: CompiledPlant) -> ModuleType:
    """The compiled kernel of a plant, from disk where it is there: its `run` takes the named tuples of this module."""
    sources = "\n".join(inspect.getsource(module) for module in (controllers.feedback, controllers.sections))
    return plant.fuse("closed_loop", KERNEL, sources)
