"""Inverse dynamics: a plant along a motion that is known, the efforts it takes, what its sensors would read, and its linearisation.

Nothing is integrated but joints that no sensor follows (`carry`). Rows are one sample period apart.
"""

from __future__ import annotations

import inspect
import math
import sys
from types import ModuleType

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.dispatch import compiled_effects
from virtual_bus.effects.motion import FrictionOf, LimitedBy, ReactionOf, ReactionState, RippleOf
from virtual_bus.plant.compiled import DEPENDENCIES, CompiledPlant
from virtual_bus.plant.drives import drive_currents, drive_joints, remember_targets
from virtual_bus.plant.friction import friction_level, shared_level, shared_speed
from virtual_bus.plant.integrator import second_order
from virtual_bus.plant.linear import invert
from virtual_bus.plant.records import Equations
from virtual_bus.sensors.measure import compiled_sensors, sensor_sources

STEP_OF_POSITION = 1e-6
"""rad or m: for central differences of gravity and of springs' laws; half the digits of a double."""
STEP_OF_SPEED = 1e-4
"""rad/s or m/s: the equations are quadratic in speeds, so that the central difference is exact but for rounding."""

ENTRY_POINTS = '''"""Generated: one plant along a known motion; do not edit."""

from EFFECTS import friction_of, limited_by, reaction_of, ripple_of
from PLANT import AXIS_JOINTS, FIRST_DRIVE, equations, imu
from SENSORS import measure, remember, start

from virtual_bus import inverse_dynamics
from virtual_bus.compilation.jit import compiled_for_threads


@compiled_for_threads
def efforts(model, work, positions, speeds, accelerations, out):
    inverse_dynamics.efforts(equations, reaction_of, model[0], work[0], positions, speeds, accelerations, out)


@compiled_for_threads
def rub(model, work, positions, speeds, deviations, efforts, out, variances):
    inverse_dynamics.rub(equations, friction_of, model[0], work[0], positions, speeds, deviations, efforts, out, variances)


@compiled_for_threads
def readings(model, work, positions, speeds, accelerations, out):
    inverse_dynamics.readings(imu, model[0], work[0], positions, speeds, accelerations, out)


@compiled_for_threads
def carry(model, work, is_carried, substeps, positions, speeds, accelerations):
    return inverse_dynamics.carry(equations, friction_of, model[0], work[0], is_carried, substeps, positions, speeds, accelerations)


@compiled_for_threads
def drive(model, work, targets, positions, speeds, accelerations, state, currents, efforts):
    inverse_dynamics.drive(
        AXIS_JOINTS, FIRST_DRIVE, limited_by, ripple_of, model[0], work[0], targets, positions, speeds, accelerations, state, currents,
        efforts,
    )


@compiled_for_threads
def sense(positions, speeds, currents, imus, state, temperatures, noise, sensors, memory, readings, out):
    joints, axes = positions.shape[1], currents.shape[1]
    for k in range(len(positions)):
        for i in range(joints):
            state[i] = positions[k, i]
            state[joints + i] = speeds[k, i]
        if k == 0:
            start(state, sensors, memory)
        measure(state, currents[k], temperatures, imus[k], noise, sensors, memory, readings)
        for i in range(axes):
            out[k, i] = readings.position[i]
            out[k, axes + i] = readings.link_position[i]
            out[k, 2 * axes + i] = readings.effort[i]
            out[k, out.shape[1] - axes + i] = readings.speed[i]
        for i in range(imus.shape[1]):
            out[k, 3 * axes + i] = readings.imu[i]
        remember(sensors, memory)


@compiled_for_threads
def linearise(model, work, positions, speeds, accelerations, inverses, stiffnesses, dampings, of_position, of_speed, of_acceleration):
    inverse_dynamics.linearise(
        equations, imu, model[0], work[0], positions, speeds, accelerations, inverses, stiffnesses, dampings, of_position, of_speed,
        of_acceleration,
    )
'''


def along_sources() -> str:
    """Return the source of everything that `along_module` is compiled from."""
    return "\n".join(inspect.getsource(module) for module in (*DEPENDENCIES, sys.modules[__name__])) + sensor_sources()


def along_module(plant: CompiledPlant) -> ModuleType:
    """Return the module with `efforts`, `readings`, `carry`, `drive`, `sense` and `linearise`, compiled once and cached."""
    text = ENTRY_POINTS.replace("EFFECTS", compiled_effects().__name__).replace("SENSORS", compiled_sensors().__name__)
    return plant.fuse("along", text, along_sources())


@compiled
def query(row: int, positions: np.ndarray, speeds: np.ndarray, work: np.record) -> None:
    """Take the equations' arguments of one row."""
    for i in range(positions.shape[1]):
        work.query_position[i] = positions[row, i]
        work.query_speed[i] = speeds[row, i]


@compiled
def efforts(
    equations: Equations, reaction_of: ReactionOf, model: np.record, work: np.record, positions: np.ndarray, speeds: np.ndarray,
    accelerations: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Write the effort (N, n) that this motion takes of the joints' drives: springs, dampers and effects included, friction not."""
    rows, joints = positions.shape
    period = model.step_s * model.steps
    for row in range(model.reaction_count):
        work.memory[row, 0] = 0.0
        work.memory[row, 1] = 0.0
    for k in range(rows):
        query(k, positions, speeds, work)
        work.query_time_s = k * period
        equations(model, work)
        for i in range(joints):
            total = work.bias[i] + model.stiffness[i] * (positions[k, i] - model.rest_position[i]) + model.damping[i] * speeds[k, i]
            for j in range(joints):
                total += work.mass[max(i, j), min(i, j)] * accelerations[k, j]
            out[k, i] = total
        if k + 1 < rows:
            for row in range(model.reaction_count):
                j = model.reaction_joint[row]
                state = ReactionState(work.memory[row, 0], work.memory[row, 1], positions[k, j], speeds[k, j], speeds[k + 1, j], period)
                mean, work.memory[row, 0], work.memory[row, 1] = reaction_of(
                    int(model.reaction_rows[row, 0]), state, model.reaction_rows[row]
                )
                out[k, j] -= 0.5 * (work.reaction[row] + mean) if k > 0 else mean
                work.reaction[row] = mean
        else:
            for row in range(model.reaction_count):
                out[k, model.reaction_joint[row]] -= work.reaction[row]


@compiled
def mean_sign(start: float, end: float, deviation: float) -> float:
    """Return the mean sign of a speed that goes from `start` to `end` along a straight line, and is known up to `deviation`."""
    x0, x1 = start / (1.4142135623730951 * deviation), end / (1.4142135623730951 * deviation)
    if abs(x1 - x0) < 1e-6:
        return math.erf(0.5 * (x0 + x1))
    g0 = x0 * math.erf(x0) + math.exp(-x0 * x0) / 1.772453850905516
    g1 = x1 * math.erf(x1) + math.exp(-x1 * x1) / 1.772453850905516
    return (g1 - g0) / (x1 - x0)


@compiled
def unknown_sign(speed: float, deviation: float) -> float:
    """Return the variance of the sign of a speed that is known up to `deviation`."""
    mean = math.erf(speed / (1.4142135623730951 * max(deviation, 1e-12)))
    return 1.0 - mean * mean


@compiled
def rub(
    equations: Equations, friction_of: FrictionOf, model: np.record, work: np.record, positions: np.ndarray, speeds: np.ndarray,
    deviations: np.ndarray, efforts: np.ndarray, out: np.ndarray, variances: np.ndarray,
) -> None:  # fmt: skip
    """Write the mean effort (N, n) of dry friction, against the motion, from each row to the next, and its variance (N, n).

    `efforts` (N, n) are those of the drives on the joints, from each row to the next.

    The speed goes along a straight line in between, and is known up to its standard deviation (N, n): friction has the mean that it has
    over such speeds, so that it does not jump where the direction is not known. There it may be anything up to its level.
    """
    rows, joints = positions.shape
    period = model.step_s * model.steps
    for k in range(rows):
        query(k, positions, speeds, work)
        work.query_time_s = k * period
        equations(model, work)
        for j in range(joints):
            out[k, j] = 0.0
            variances[k, j] = 0.0
            work.brake[j] = 0.0
            work.effort[j] = efforts[k, j]
            ahead = min(k + 1, rows - 1)
            work.position[j] = 0.5 * (positions[k, j] + positions[ahead, j])
            if model.friction_first[j + 1] == model.friction_first[j]:
                continue
            speed = 0.5 * (abs(speeds[k, j]) + abs(speeds[ahead, j]))
            forward = 0.5 * (1.0 + mean_sign(speeds[k, j], speeds[ahead, j], max(deviations[k, j], 1e-12)))
            up = friction_level(j, speed, 1.0, friction_of, model, work)
            down = friction_level(j, speed, -1.0, friction_of, model, work)
            out[k, j] = forward * up - (1.0 - forward) * down
            variances[k, j] = (0.5 * (up + down)) ** 2 * unknown_sign(speeds[k, j], deviations[k, j])
        for row in range(model.shared_count):
            i, j, share = model.shared_joints[row, 0], model.shared_joints[row, 1], model.share[row]
            ahead = min(k + 1, rows - 1)
            begin, end = shared_speed(row, speeds[k], model), shared_speed(row, speeds[ahead], model)
            deviation = math.hypot(deviations[k, i], share * deviations[k, j])
            forward = 0.5 * (1.0 + mean_sign(begin, end, max(deviation, 1e-12)))
            speed = 0.5 * (abs(begin) + abs(end))
            up = shared_level(row, speed, 1.0, friction_of, model, work)
            down = shared_level(row, speed, -1.0, friction_of, model, work)
            effort = forward * up - (1.0 - forward) * down
            variance = (0.5 * (up + down)) ** 2 * unknown_sign(begin, deviation)
            out[k, i] += effort
            out[k, j] += share * effort
            variances[k, i] += variance
            variances[k, j] += share * share * variance


@compiled
def readings(
    imu: Equations, model: np.record, work: np.record, positions: np.ndarray, speeds: np.ndarray, accelerations: np.ndarray, out: np.ndarray
) -> None:
    """Write the IMUs' channels (N, 6 imus) after their low passes; at row 0 they have settled."""
    rows, joints = positions.shape
    channels = out.shape[1]
    for k in range(rows):
        query(k, positions, speeds, work)
        for i in range(joints):
            work.query_acceleration[i] = accelerations[k, i]
        imu(model, work)
        for c in range(channels):
            new = work.reading[c]
            if model.is_filtered[c] == 0:
                out[k, c] = new
                continue
            if k == 0:
                work.filtered[c] = new
                work.filtered_slope[c] = 0.0
                work.start_reading[c] = new
            if model.is_filtered[c] == 2:
                second_order(c, model, work)
            else:
                weights = model.filter_weights[c]
                work.filtered[c] = weights[0] * work.filtered[c] + weights[1] * work.start_reading[c] + weights[2] * new
            work.start_reading[c] = new
            out[k, c] = work.filtered[c]


@compiled
def free_acceleration(equations: Equations, friction_of: FrictionOf, is_carried: np.ndarray, model: np.record, work: np.record) -> None:
    """Find the carried joints' accelerations, into work.acceleration, at the query; the other joints' stand there already."""
    joints = len(is_carried)
    equations(model, work)
    for i in range(joints):
        work.force[i] = 0.0
        if is_carried[i]:
            pull = -work.bias[i] - model.stiffness[i] * (work.query_position[i] - model.rest_position[i])
            pull -= model.damping[i] * work.query_speed[i]
            if model.friction_first[i + 1] > model.friction_first[i]:
                work.brake[i] = 0.0
                work.effort[i] = 0.0
                work.position[i] = work.query_position[i]
                direction = 1.0 if work.query_speed[i] >= 0.0 else -1.0
                pull -= direction * friction_level(i, abs(work.query_speed[i]), direction, friction_of, model, work)
            for j in range(joints):
                if not is_carried[j]:
                    pull -= work.mass[max(i, j), min(i, j)] * work.acceleration[j]
            work.force[i] = pull
    for row in range(model.shared_count):
        i, j = model.shared_joints[row, 0], model.shared_joints[row, 1]
        speed = shared_speed(row, work.query_speed, model)
        if speed != 0.0 and (is_carried[i] or is_carried[j]):
            direction = 1.0 if speed > 0.0 else -1.0
            effort = direction * shared_level(row, abs(speed), direction, friction_of, model, work)
            work.force[i] -= effort if is_carried[i] else 0.0
            work.force[j] -= model.share[row] * effort if is_carried[j] else 0.0
    # the carried block of the inertia, the other joints decoupled with unit inertia
    for i in range(joints):
        for j in range(i + 1):
            if not (is_carried[i] and is_carried[j]):
                work.mass[i, j] = 1.0 if i == j else 0.0
    invert(work.mass, work.pivots, work.inverse)
    for i in range(joints):
        if is_carried[i]:
            total = 0.0
            for j in range(joints):
                if is_carried[j]:
                    total += work.inverse[i, j] * work.force[j]
            work.derivative[i] = total
    for i in range(joints):
        if is_carried[i]:
            work.acceleration[i] = work.derivative[i]


@compiled
def carry(
    equations: Equations, friction_of: FrictionOf, model: np.record, work: np.record, is_carried: np.ndarray, substeps: int,
    positions: np.ndarray, speeds: np.ndarray, accelerations: np.ndarray,
) -> bool:  # fmt: skip
    """Integrate the carried joints under the prescribed motion of the others, in place, from their values in row 0.

    Classical Runge-Kutta with `substeps` steps a row. Returns whether it stayed finite.
    """
    rows, joints = positions.shape
    period = model.step_s * model.steps
    h = period / substeps
    q0, v0 = work.start_position, work.start_speed
    qs, vs = work.first_position, work.first_speed  # sums of the four slopes
    for k in range(rows):
        if k > 0:
            for i in range(joints):
                if is_carried[i]:
                    positions[k, i] = positions[k - 1, i]
                    speeds[k, i] = speeds[k - 1, i]
            for step in range(substeps):
                for i in range(joints):
                    q0[i], v0[i] = positions[k, i], speeds[k, i]
                    qs[i], vs[i] = 0.0, 0.0
                for stage in range(4):
                    ahead = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                    share = (step + ahead) / substeps
                    for i in range(joints):
                        if is_carried[i]:
                            if stage == 0:
                                work.query_position[i], work.query_speed[i] = q0[i], v0[i]
                            else:
                                work.query_position[i] = q0[i] + ahead * h * work.lower_derivative[i]
                                work.query_speed[i] = v0[i] + ahead * h * work.derivative[i]
                        else:
                            a0, a1 = accelerations[k - 1, i], accelerations[k, i]
                            t = share * period
                            jerk = (a1 - a0) / period
                            work.query_speed[i] = speeds[k - 1, i] + t * (a0 + 0.5 * t * jerk)
                            work.query_position[i] = positions[k - 1, i] + t * (speeds[k - 1, i] + t * (0.5 * a0 + t * jerk / 6.0))
                            work.acceleration[i] = a0 + t * jerk
                    work.query_time_s = (k - 1 + share) * period
                    free_acceleration(equations, friction_of, is_carried, model, work)
                    weight = 1.0 / 6.0 if ahead in (0.0, 1.0) else 1.0 / 3.0
                    for i in range(joints):
                        if is_carried[i]:
                            work.lower_derivative[i] = work.query_speed[i]
                            qs[i] += weight * work.query_speed[i]
                            vs[i] += weight * work.derivative[i]
                for i in range(joints):
                    if is_carried[i]:
                        positions[k, i] = q0[i] + h * qs[i]
                        speeds[k, i] = v0[i] + h * vs[i]
                        if not abs(positions[k, i]) < 1e12:
                            return False
        query(k, positions, speeds, work)
        work.query_time_s = k * period
        for i in range(joints):
            if not is_carried[i]:
                work.acceleration[i] = accelerations[k, i]
        free_acceleration(equations, friction_of, is_carried, model, work)
        for i in range(joints):
            if is_carried[i]:
                accelerations[k, i] = work.acceleration[i]
    return True


@compiled
def drive(
    axis_joints: tuple[int, ...], first: int, limited_by: LimitedBy, ripple_of: RippleOf, model: np.record, work: np.record,
    targets: np.ndarray, positions: np.ndarray, speeds: np.ndarray, accelerations: np.ndarray, state: np.ndarray, currents: np.ndarray,
    efforts: np.ndarray,
) -> None:  # fmt: skip
    """Write the currents (N, axes) at the rows, and the mean effort (N, n) on the joints from each row to the next.

    `targets` (N, axes) act from their row to the next; `state` is the plant's, whose drives have settled at the first targets.
    """
    rows, axes = targets.shape
    joints = positions.shape[1]
    for k in range(rows):
        for i in range(joints):
            state[i] = positions[k, i]
            state[joints + i] = speeds[k, i]
            work.position[i] = positions[k, i]
            work.speed[i] = speeds[k, i]
            work.acceleration[i] = accelerations[k, i]
            efforts[k, i] = 0.0
        drive_currents(axis_joints, first, limited_by, state, targets[k], model, work.currents)
        for axis in range(axes):
            currents[k, axis] = work.currents[axis]
        for step in range(model.steps):
            drive_joints(axis_joints, first, step, limited_by, ripple_of, state, targets[k], model, work)
            for i in range(joints):
                efforts[k, i] += work.effort[i] / model.steps
                work.position[i] += model.step_s * work.speed[i]
        remember_targets(axes, first, state, targets[k], model)


@compiled
def linearise(
    equations: Equations, imu: Equations, model: np.record, work: np.record, positions: np.ndarray, speeds: np.ndarray,
    accelerations: np.ndarray, inverses: np.ndarray, stiffnesses: np.ndarray, dampings: np.ndarray, of_position: np.ndarray,
    of_speed: np.ndarray, of_acceleration: np.ndarray,
) -> None:  # fmt: skip
    """Write inverse inertias, stiffnesses and dampings (N, n, n), and the gradients (N, 6 imus, n) of the IMUs' raw channels.

    The stiffness is the gradient of the effort that the motion takes with the positions at given accelerations, the damping the one with
    the speeds.
    """
    rows, joints = positions.shape
    channels = of_position.shape[1]
    for k in range(rows):
        work.query_time_s = k * model.step_s * model.steps
        query(k, positions, speeds, work)
        for i in range(joints):
            work.query_acceleration[i] = accelerations[k, i]
        equations(model, work)
        invert(work.mass, work.pivots, work.inverse)
        for i in range(joints):
            for j in range(joints):
                inverses[k, i, j] = work.inverse[i, j]
        for j in range(joints):
            for sign in (1.0, -1.0):
                by = 0.5 * sign / STEP_OF_POSITION
                work.query_position[j] = positions[k, j] + sign * STEP_OF_POSITION
                equations(model, work)
                for i in range(joints):
                    total = work.bias[i]
                    for m in range(joints):
                        total += work.mass[max(i, m), min(i, m)] * accelerations[k, m]
                    stiffnesses[k, i, j] = by * total if sign > 0.0 else stiffnesses[k, i, j] + by * total
                imu(model, work)
                for c in range(channels):
                    of_position[k, c, j] = by * work.reading[c] if sign > 0.0 else of_position[k, c, j] + by * work.reading[c]
            work.query_position[j] = positions[k, j]
            for sign in (1.0, -1.0):
                by = 0.5 * sign / STEP_OF_SPEED
                work.query_speed[j] = speeds[k, j] + sign * STEP_OF_SPEED
                equations(model, work)
                for i in range(joints):
                    dampings[k, i, j] = by * work.bias[i] if sign > 0.0 else dampings[k, i, j] + by * work.bias[i]
                imu(model, work)
                for c in range(channels):
                    of_speed[k, c, j] = by * work.reading[c] if sign > 0.0 else of_speed[k, c, j] + by * work.reading[c]
            work.query_speed[j] = speeds[k, j]
            stiffnesses[k, j, j] += model.stiffness[j]
            dampings[k, j, j] += model.damping[j]
        imu(model, work)
        for c in range(channels):
            work.start_reading[c] = work.reading[c]
        for j in range(joints):
            work.query_acceleration[j] = accelerations[k, j] + 1.0
            imu(model, work)
            for c in range(channels):
                of_acceleration[k, c, j] = work.reading[c] - work.start_reading[c]
            work.query_acceleration[j] = accelerations[k, j]
