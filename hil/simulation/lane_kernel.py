"""The fused kernel of `kernel.py` for LANES machines of one plant at a time, with common inputs and separate outputs.

A lane that is not finite stays so, with its commands in closed loop, and the others continue.
"""

from __future__ import annotations

import inspect
import sys
from types import ModuleType
from typing import NamedTuple

import numpy as np

from virtual_bus.effects.dispatch import compiled_effects, dispatch_sources
from virtual_bus.plant import lanes, side_by_side
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.lanes import LaneRecord
from virtual_bus.sensors.measure import sensor_sources

DEPENDENCIES = (lanes, side_by_side)  # compiled into every lane kernel besides a plant's own


class Given(NamedTuple):
    """Inputs of all lanes, N rows of n axes, and their controllers."""

    reference: np.ndarray  # (N, n)
    excitation: np.ndarray  # (N, n)
    feedforward: np.ndarray  # (N, n)
    command: np.ndarray  # (N, n): taken in open loop
    sections: np.ndarray  # (S, 6)
    rows: np.ndarray  # (n, 3) as `controllers.feedback.feedback_step` takes them
    limit: np.ndarray  # (n,)
    target_resolution: np.ndarray  # (n,)
    restart: np.ndarray  # (N,) which of the states below joints are set to at the row, -1 for none; (0,) where there is no restart
    begins: np.ndarray  # (R, joints, 2): positions and speeds
    is_set: np.ndarray  # (joints,) which joints a restart sets


class Acting(NamedTuple):
    """Lanes whose machines have parts of their own, each kind in ascending order, and the joints where these need responses."""

    terms: np.ndarray
    memories: np.ndarray
    frictions: np.ndarray  # with friction or an effect with a memory
    drives: np.ndarray
    sensors: np.ndarray
    joints: np.ndarray  # (joints,) 1: a lane has friction or an effect with a memory there


def loop_record(joints: int, axes: int, imus: int, sections: int) -> LaneRecord:
    """Return the record of controllers, sensors and targets of the lanes, and of how far each begins from a restart's state."""
    shapes: dict[str, tuple[int, ...]] = {"state": (max(sections, 1), 2), "imu": (max(6 * imus, 1),)}
    shapes |= {"begin_position": (joints,), "begin_speed": (joints,)}
    names = ("target", "effort", "current", "position", "link_position", "speed", "measured_effort", "command", "gain", "early")
    return LaneRecord(shapes | {name: (axes,) for name in names})


KERNEL = '''"""Generated: closed loop of LANES machines of one plant; do not edit."""

from EFFECTS import (
    effort_of, encoder_error_of, friction_of, lag_of, limited_by, lost_by, reaction_of, ripple_of, signed_by, terms_of,
)
from hil.simulation import lane_kernel
from PLANT import AXIS_JOINTS, FIRST_DRIVE, IMUS
from PLANT import imu as imu_of_one
from PLANT import mass_and_bias as mass_and_bias_of_one
from virtual_bus.plant import side_by_side
from virtual_bus.plant.drives import drive_currents
from virtual_bus.compilation.jit import compiled, compiled_for_threads
from virtual_bus.sensors.current import current_reading
from virtual_bus.sensors.effects import SensorEffects, SensorMemory, remember
from virtual_bus.sensors.encoder import encoder_reading, quantised, summed_position
from virtual_bus.sensors.imu import measured_channel
from virtual_bus.sensors.measure import SensorModel, measure_affected

JOINTS, AXES = SIZES
mass_and_bias, imu = compiled(mass_and_bias_of_one.py_func), compiled(imu_of_one.py_func)
model_of = side_by_side.model_record(JOINTS, AXES, IMUS, CONSTANTS).view
side_of = side_by_side.work_record(JOINTS, IMUS).view
loop_of = lane_kernel.loop_record(JOINTS, AXES, IMUS, SECTIONS).view


@compiled
def filtered(sections, begin, end, x, loop):
    y = x
    for s in range(begin, end):
        x = y
        y = sections[s, 0] * x + loop.state[s, 0]
        loop.state[s, 0] = sections[s, 1] * x - sections[s, 4] * y + loop.state[s, 1]
        loop.state[s, 1] = sections[s, 2] * x - sections[s, 5] * y
    return y


@compiled
def see(lane, no_noise, no_rise, imu_motion, currents, state, sensors, effects, memory, readings, loop):
    """Sensors of a machine whose sensors have effects."""
    own = SensorEffects(
        effects.encoder_channel[lane], effects.encoder_rows[lane], effects.counts_from_start[lane], effects.lattice[lane],
        effects.imu_gain[lane], effects.imu_offset[lane], effects.switches[lane], effects.sign_rows[lane], effects.clock_rows[lane],
        effects.dropout_rows[lane], effects.period_s[lane],
    )
    kept = SensorMemory(
        memory.samples[lane], memory.home_error[lane], memory.values[lane], memory.raw[lane], memory.latest[lane], memory.issued[lane],
        memory.history[lane],
    )
    one = SensorModel(
        sensors.position_joints, sensors.position_resolution, sensors.link_joints, sensors.link_resolution, sensors.speed_joints,
        sensors.speed_resolution, sensors.effort_resolution, sensors.imu_bias, sensors.imu_resolution, sensors.ambient_degC,
        sensors.rise_per_effort2, sensors.temperature_decay, sensors.temperature_resolution, own.switches, own,
    )
    measure_affected(
        state, currents, no_rise, imu_motion, no_noise, encoder_error_of, signed_by, lag_of, lost_by, one, kept, readings
    )
    remember(own, kept)
    for i in range(AXES):
        loop.position[i, lane] = readings.position[i]
        loop.link_position[i, lane] = readings.link_position[i]
        loop.speed[i, lane] = readings.speed[i]
        loop.measured_effort[i, lane] = readings.effort[i]
    for k in range(6 * IMUS):
        loop.imu[k, lane] = readings.imu[k]


@compiled
def begin(state, is_set, acting, states, side, loop):
    """Set joints to a state, each machine as far from it as its own record says."""
    for j in range(JOINTS):
        if is_set[j]:
            side.position[j] = loop.begin_position[j] + state[j, 0]
            side.speed[j] = loop.begin_speed[j] + state[j, 1]
    tell(acting.drives, states, side)
    tell(acting.sensors, states, side)


@compiled
def tell(lanes, states, side):
    """Copy positions and speeds to the machines' own states."""
    for lane in lanes:
        for j in range(JOINTS):
            states[lane, j] = side.position[j, lane]
            states[lane, JOINTS + j] = side.speed[j, lane]


@compiled_for_threads
def run(
    closed, states, models, works, model_memory, side_memory, loop_memory, sensors, effects, memory, readings, scratch, acting, given, rows
):
    """All rows of all lanes; `rows` (LANES, N, 5 axes + 6 imus): commands, then what the sensors read."""
    model, side, loop = model_of(model_memory), side_of(side_memory), loop_of(loop_memory)
    efforts, currents, imu_motion, no_rise, no_noise = scratch
    period_s = models[0].steps * models[0].step_s
    for k in range(given.excitation.shape[0]):
        if given.restart.shape[0] > 0 and given.restart[k] >= 0:
            begin(given.begins[given.restart[k]], given.is_set, acting, states, side, loop)
        for i in range(AXES):
            loop.effort[i] = quantised(loop.target[i], given.target_resolution[i])
            loop.current[i] = loop.effort[i]
        for lane in acting.drives:
            for i in range(AXES):
                efforts[lane, i] = loop.effort[i, lane]
            drive_currents(AXIS_JOINTS, FIRST_DRIVE, limited_by, states[lane], efforts[lane], models[lane], currents)
            for i in range(AXES):
                loop.current[i, lane] = currents[i]
        for i in range(AXES):
            loop.position[i] = encoder_reading(summed_position(sensors.position_joints[i], side.position), sensors.position_resolution[i])
            loop.link_position[i] = encoder_reading(summed_position(sensors.link_joints[i], side.position), sensors.link_resolution[i])
            loop.speed[i] = encoder_reading(summed_position(sensors.speed_joints[i], side.speed), sensors.speed_resolution[i])
            loop.measured_effort[i] = current_reading(loop.current[i], 0.0, sensors.effort_resolution[i])
        for c in range(6 * IMUS):
            loop.imu[c] = measured_channel(side.filtered[c], sensors.imu_bias[c], 0.0, sensors.imu_resolution[c])
        for lane in acting.sensors:
            for i in range(AXES):
                currents[i] = loop.current[i, lane]
            for c in range(6 * IMUS):
                imu_motion[c] = side.filtered[c, lane]
            see(lane, no_noise, no_rise, imu_motion, currents, states[lane], sensors, effects, memory, readings, loop)
        for i in range(AXES):
            first, middle, end = given.rows[i, 0], given.rows[i, 1], given.rows[i, 2]
            if not closed:
                loop.command[i] = given.command[k, i]
            elif first == middle:
                loop.command[i] = filtered(given.sections, middle, end, given.reference[k, i] - loop.position[i], loop)
            else:
                ahead = filtered(given.sections, first, middle, 0.0 * loop.position[i] + given.reference[k, i], loop)
                loop.command[i] = ahead - filtered(given.sections, middle, end, loop.position[i], loop)
            if closed:
                loop.command[i] *= loop.gain[i]
                loop.command[i] += given.excitation[k, i] + given.feedforward[k, i]
            loop.command[i] = min(max(loop.command[i], -given.limit[i]), given.limit[i])
            loop.target[i] = loop.command[i]
            loop.effort[i] += loop.early[i] * (quantised(loop.target[i], given.target_resolution[i]) - loop.effort[i])
        for lane in range(states.shape[0]):
            for i in range(AXES):
                rows[lane, k, i] = loop.command[i, lane]
                rows[lane, k, AXES + i] = loop.measured_effort[i, lane]
                rows[lane, k, 2 * AXES + i] = loop.position[i, lane]
                rows[lane, k, 3 * AXES + i] = loop.link_position[i, lane]
                rows[lane, k, 4 * AXES + i] = loop.speed[i, lane]
            for c in range(6 * IMUS):
                rows[lane, k, 5 * AXES + c] = loop.imu[c, lane]
        side_by_side.advance(
            AXIS_JOINTS, IMUS, FIRST_DRIVE, mass_and_bias, friction_of, reaction_of, effort_of, terms_of, limited_by, ripple_of, imu,
            k * period_s, loop.effort, efforts, acting, states, models, works, model, side,
        )
        tell(acting.drives, states, side)
        tell(acting.sensors, states, side)
'''


def lane_kernel(plant: CompiledPlant, sections: int) -> ModuleType:
    """Return the compiled kernel of LANES machines with this number of controller sections, from disk if cached."""
    own = KERNEL.replace("EFFECTS", compiled_effects().__name__).replace("SIZES", f"{plant.joints}, {len(plant.settings.drives)}")
    own = own.replace("CONSTANTS", str(plant.constant_count)).replace("SECTIONS", str(sections))
    sources = "\n".join(inspect.getsource(module) for module in (*DEPENDENCIES, sys.modules[__name__]))
    return plant.fuse("side_by_side", own, sources + dispatch_sources() + sensor_sources())
