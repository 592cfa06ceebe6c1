"""Plant and feedback fused into one compiled kernel: a whole recording in one call. Timing: docs/explanation/notation.md.

At row k the drives apply the target they hold (command k-1), sensors latch, the controller makes command k of this row, and the plant
advances to k+1 under the effort of the drives. Noise is off, quantisation is on.
"""

from __future__ import annotations

import inspect
from types import ModuleType
from typing import NamedTuple

import numpy as np

import controllers.feedback
import controllers.sections
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.sensors.measure import compiled_sensors, sensor_sources


class Loop(NamedTuple):
    """The controllers' arrays as `controllers.feedback.feedback_step` takes them. `state` and `held` are advanced in place."""

    sections: np.ndarray
    state: np.ndarray
    rows: np.ndarray
    limit: np.ndarray
    held: np.ndarray


class Rows(NamedTuple):
    """Inputs and outputs of one recording, N rows of n axes."""

    reference: np.ndarray  # (N, n)
    excitation: np.ndarray  # (N, n)
    feedforward: np.ndarray  # (N, n)
    command: np.ndarray  # (N, n): computed in closed loop, given in open loop
    effort: np.ndarray  # (N, n) as the drives measure it
    position: np.ndarray  # (N, n)
    link_position: np.ndarray  # (N, n)
    speed: np.ndarray  # (N, n)
    imu: np.ndarray  # (N, 6 imus)


class Scratch(NamedTuple):
    """Arrays that the kernel writes at every row before it reads them, and zeros that are never written: see `new_scratch`."""

    effort: np.ndarray  # (n,) targets on the drives' lattice
    currents: np.ndarray  # (n,) that flow
    command: np.ndarray  # (n,)
    open_brakes: np.ndarray  # (n,) zeros
    no_rise: np.ndarray  # (n,) zeros: of temperature
    no_noise: np.ndarray  # (n + 6 imus,) zeros


def new_scratch(axes: int, imus: int) -> Scratch:
    """Return memory for one run at a time."""
    return Scratch(np.zeros(axes), np.zeros(axes), np.zeros(axes), np.zeros(axes), np.zeros(axes), np.zeros(axes + 6 * imus))


KERNEL = '''"""Generated: closed loop of one plant; do not edit."""

from PLANT import FIRST_DRIVE, advance, drive_currents, imu_reading
from SENSORS import measure as measure_affected
from SENSORS import remember, start

from controllers.feedback import feedback_step
from virtual_bus.compilation.jit import compiled_for_threads
from virtual_bus.sensors.encoder import quantised
from virtual_bus.sensors.measure import measure


@compiled_for_threads
def run(closed, state, target, target_resolution, model, work, sensors, memory, readings, imu_motion, loop, rows, scratch):
    """All rows, in place; returns the first row without a finite position, or -1. `target` (n,): what the drives hold before row 0."""
    axes = target.shape[0]
    effort, currents, command, brakes = scratch.effort, scratch.currents, scratch.command, scratch.open_brakes
    no_rise, noise = scratch.no_rise, scratch.no_noise
    start(state, sensors, memory)
    affected = sensors.switches[0] != 0
    for k in range(rows.reference.shape[0]):
        for i in range(axes):
            effort[i] = quantised(target[i], target_resolution[i])
            currents[i] = effort[i]
        READ_IMUS
        if model[0].has_drive_effects:
            drive_currents(state, effort, model, currents)
        if affected:
            measure_affected(state, currents, no_rise, imu_motion, noise, sensors, memory, readings)
        else:
            measure(state, currents, no_rise, imu_motion, noise, sensors, readings)
        for i in range(axes):
            rows.position[k, i] = readings.position[i]
            rows.link_position[k, i] = readings.link_position[i]
            rows.speed[k, i] = readings.speed[i]
            rows.effort[k, i] = readings.effort[i]
        for i in range(imu_motion.shape[0]):
            rows.imu[k, i] = readings.imu[i]
        if closed:
            missing = feedback_step(
                loop.sections, loop.state, loop.rows, loop.limit, loop.held,
                rows.reference[k], readings.position, rows.excitation[k], rows.feedforward[k], command,
            )
            if missing != 0:
                return k
            for i in range(axes):
                rows.command[k, i] = command[i]
        else:
            for i in range(axes):
                command[i] = min(max(rows.command[k, i], -loop.limit[i]), loop.limit[i])
        for i in range(axes):
            target[i] = command[i]
        advance(state, effort, brakes, model, work)
        if affected:
            remember(sensors, memory)
    return -1
'''

AT_THE_INSTANT = """if imu_motion.shape[0] > 0:
            imu_reading(state, effort, brakes, model, work, imu_motion)"""
FROM_STATE = """for i in range(imu_motion.shape[0]):
            imu_motion[i] = state[FIRST_DRIVE - 1 - imu_motion.shape[0] + i]"""


def closed_loop_kernel(plant: CompiledPlant, filters_all: bool) -> ModuleType:
    """Return the compiled kernel of a plant, from disk if cached; its `run` takes the named tuples of this module.

    Where every IMU channel has a low pass the kernel needs a tenth less compiling: what the IMUs read stands in the state.
    """
    controller_sources = "\n".join(inspect.getsource(module) for module in (controllers.feedback, controllers.sections))
    text = KERNEL.replace("SENSORS", compiled_sensors().__name__).replace("READ_IMUS", FROM_STATE if filters_all else AT_THE_INSTANT)
    return plant.fuse("closed_loop", text, controller_sources + sensor_sources())
