"""The sampled loop around a MuJoCo model, compiled: drives, effects, sensors, controller, written from docs/explanation/notation.md."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from concealed.truth.joint_physics import add_efforts, tabulated
from concealed.truth.memory import forward

DRIVE = ("delay", "pole1_Hz", "pole2_Hz", "limit", "knee", "Np", "A1", "phi1", "A2", "phi2", "gain")
"""Columns of the drives' table: delay [samples], two real poles, soft limit, ripple per joint turn, gain on the effort, not the current."""

ENCODER = ("a", "phi", "b", "psi", "lattice", "beta", "lost", "mark")
"""Columns of the encoders' table: once and twice per turn error, own lattice, ratio error, counts lost at every upward pass of a mark."""

HISTORY = 64


@njit(cache=True)
def filtered(sections, states, first, end, x):
    """Second-order sections first to end, direct form II transposed."""
    for s in range(first, end):
        b0, b1, b2, a1, a2 = sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 4], sections[s, 5]
        y = b0 * x + states[s, 0]
        states[s, 0] = b1 * x - a1 * y + states[s, 1]
        states[s, 1] = b2 * x - a2 * y
        x = y
    return x


@njit(cache=True)
def on_lattice(x, q):
    return q * math.floor(x / q + 0.5) if q > 0.0 else x


@njit(cache=True)
def low_pass(value, middle, slope, pole_Hz, h):
    """First order over a step, exact for an input that is `middle` halfway and changes by `slope`; without a pole the input."""
    if pole_Hz <= 0.0:
        return middle
    lag = 1.0 / (2.0 * math.pi * pole_Hz)
    decay = math.exp(-h / lag)
    return decay * value + (1.0 - decay) * middle + slope * (0.5 * h * (1.0 + decay) - lag * (1.0 - decay))


@njit(cache=True)
def passed_by(target, limit, knee):
    """What passes a soft limit; all of it where there is none."""
    return target / (1.0 + abs(target / limit) ** knee) ** (1.0 / knee) if limit > 0.0 else target


@njit(cache=True)
def held(newer, older, part, begin, end):
    """Mean between two shares of a row of a target that takes over from the older one at the share `part`; at an instant what acts."""
    if part <= begin and (part < end or part == 0.0):
        return newer
    if part >= end:
        return older
    return older + (newer - older) * (end - part) / (end - begin)


@njit(cache=True)
def through_poles(state, target, first_Hz, second_Hz, h):
    """Mean over a step of what two different real poles in a row make of a held target, the target itself where there are none; their
    state is moved on. Exact.
    """
    if first_Hz <= 0.0:
        return target
    if h == 0.0:
        return state[1]
    first, second = 1.0 / (2.0 * math.pi * first_Hz), 1.0 / (2.0 * math.pi * second_Hz)
    short, begun = state[0] - target, state[1]
    decays = math.exp(-h / first), math.exp(-h / second)
    state[0] = target + short * decays[0]
    state[1] = target + (begun - target) * decays[1] + short * first / (first - second) * (decays[0] - decays[1])
    return target + (short * first * (1.0 - decays[0]) - second * (state[1] - begun)) / h


@njit(cache=True)
def run(
    address, model, data, memory, sensor, kinds, dofs, others, parameters, states, drives, encoders, sections, rows, controller,
    axes, see, link, gear, limits, steps_of_target, counts, reference, excitation, disturbance, calm_speed, standing, substeps, period,
    imu_poles, closed,
    command0, out_command, out_effort, out_position, out_link, out_imu, out_q, out_v,
):  # fmt: skip
    """Fill the outputs; row k is latched before command k acts. Returns the row where the machine left all bounds, else -1."""
    qpos, qvel, qacc, ctrl, applied, bias, armature = memory
    samples, n = reference.shape
    joints = qpos.shape[0]
    q, v, a, a_before = qpos.copy(), np.zeros(joints), np.zeros(joints), np.zeros(joints)
    drive, newer, older = np.zeros(joints), np.zeros(n), np.zeros(n)
    poles = np.zeros((n, 2))
    history = np.zeros((HISTORY, n))
    history[:] = command0
    poles[:, 0], poles[:, 1] = command0, command0
    lost, before = np.zeros(n), q.copy()
    command = command0.copy()
    start = qpos.copy()
    with_imu = sensor.shape[0] > 0
    ctrl[:] = command0
    applied[:] = standing
    qvel[:] = 0.0
    forward(address, model, data, 0)
    passed, middle_before, slopes, bends = np.zeros((2, 6)), np.zeros(6), np.zeros(6), np.zeros(6)
    if with_imu:
        passed[0, :], passed[1, :] = sensor, sensor
    a[:] = 0.0
    for k in range(samples):
        for i in range(n):
            history[k % HISTORY, i] = on_lattice(command[i], steps_of_target[i])
            whole = int(drives[i, 0])
            part = drives[i, 0] - whole
            newer[i] = passed_by(history[(k - whole) % HISTORY, i], drives[i, 3], drives[i, 4])
            older[i] = passed_by(history[(k - whole - 1) % HISTORY, i], drives[i, 3], drives[i, 4])
            if drives[i, 1] > 0.0:
                out_effort[k, i] = poles[i, 1]
            else:
                out_effort[k, i] = older[i] if part > 0.0 else newer[i]  # what flows at the SYNC
            j = axes[i]
            error = encoders[i, 0] * math.cos(q[j] + encoders[i, 1]) + encoders[i, 2] * math.cos(2.0 * q[j] + encoders[i, 3])
            error -= encoders[i, 0] * math.cos(start[j] + encoders[i, 1]) + encoders[i, 2] * math.cos(2.0 * start[j] + encoders[i, 3])
            if before[j] < encoders[i, 7] <= q[j]:
                lost[i] += encoders[i, 6]
            seen = 0.0
            for joint in range(joints):
                seen += see[i, joint] * q[joint]
                out_link[k, i] += link[i, joint] * q[joint]
            seen += encoders[i, 5] * (q[j] - start[j]) + error - lost[i]
            seen = on_lattice(on_lattice(seen, encoders[i, 4]), counts[i])
            out_position[k, i] = seen
            if closed:
                first, middle, end = rows[i]
                if first == middle:
                    wanted = filtered(sections, controller, middle, end, reference[k, i] - seen)
                else:
                    wanted = filtered(sections, controller, first, middle, reference[k, i])
                    wanted -= filtered(sections, controller, middle, end, seen)
                wanted += excitation[k, i]
            else:
                wanted = excitation[k, i]
            command[i] = min(max(wanted, -limits[i]), limits[i])
            out_command[k, i] = command[i]
        for joint in range(joints):
            out_q[k, joint], out_v[k, joint] = q[joint], v[joint]
            before[joint] = q[joint]
            if not abs(q[joint]) < 100.0:
                return k
        if with_imu:
            out_imu[k, :] = passed[1] if imu_poles[2] > 0.0 else passed[0]
        for stage in range(substeps + 1):  # the first takes no time: accelerations under the efforts that have just changed
            h = period / substeps if stage > 0 else 0.0
            t = k * period + max(0.0, stage - 0.5) * h
            for joint in range(joints):
                # Takahashi and Imada 1984: with the force from there, frequencies are right to fourth order
                qpos[joint] = q[joint] + 0.5 * h * v[joint] + h * h / 12.0 * a[joint]
                qvel[joint] = v[joint] + 0.5 * h * (a[joint] + (0.75 * (a[joint] - a_before[joint]) if stage > 2 else 0.0))
                applied[joint] = 0.0
            for i in range(n):
                j = axes[i]
                part = drives[i, 0] - int(drives[i, 0])
                flowing = held(newer[i], older[i], part, max(0.0, stage - 1.0) / substeps, stage / substeps)
                current = through_poles(poles[i], flowing, drives[i, 1], drives[i, 2], h)
                ripple = tabulated(drives[i, 5] * qpos[j] / (2.0 * math.pi), drives[i, 6], drives[i, 7], drives[i, 8], drives[i, 9], 0.0)
                ctrl[i] = current
                drive[j] = gear[i] * current
                applied[j] += drive[j] * ((1.0 + ripple) * drives[i, 10] - 1.0)
                calm = math.exp(-((qvel[j] / calm_speed) ** 2)) if calm_speed > 0.0 else 1.0
                applied[j] += disturbance[k, i] * calm
            add_efforts(kinds, dofs, others, parameters, states, qpos, qvel, a, t, h, bias, drive, applied, armature)
            forward(address, model, data, 0 if with_imu and stage > 0 else 1)
            for joint in range(joints):
                a_before[joint], a[joint] = a[joint], qacc[joint]
                v[joint] += h * a[joint]
                q[joint] += 0.5 * h * (v[joint] + v[joint] - h * a[joint])
            if with_imu and stage > 0:
                for c in range(6):
                    if stage > 2:  # efforts jump where rows begin: slopes and bends of middles further on, kept until then
                        bends[c] = (sensor[c] - middle_before[c]) / h - slopes[c] if stage > 3 else 0.0
                        slopes[c] = (sensor[c] - middle_before[c]) / h
                    slope = slopes[c] + 0.5 * bends[c]
                    middle_before[c] = sensor[c]
                    pole = imu_poles[0] if c < 3 else imu_poles[1]
                    begun = passed[0, c]
                    passed[0, c] = low_pass(begun, sensor[c] + bends[c] * h / 24.0, slope, pole, h)
                    if imu_poles[2] > 0.0:
                        passed[1, c] = low_pass(passed[1, c], 0.5 * (begun + passed[0, c]), (passed[0, c] - begun) / h, imu_poles[2], h)
    return -1
