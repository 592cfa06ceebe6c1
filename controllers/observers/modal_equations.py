"""The modal model as the filters call it: one state one sample on, and what the sensors would read. (5.2), (5.3) with (5.30)-(5.35).

State: [q_r, q_r', η, η', ξ, quadratures of those ξ that lie in a band, log frequency ratios of the adapted modes,
offsets, sensor biases]. Offsets, where there are any: of the motor sides' encoders, and of the detector's twist that no mode has (5.37).

What the sensors read is a nonlinear function (rotations, products of rates) of a few signals that are linear in the state, and biases. So a
deviation is carried to the signals once, and only the function of the signals is asked at both of its ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.compiled import exactly_inlined
from controllers.models.chain import chain_motion
from controllers.models.modal import schedule
from controllers.models.vectors import cross, minus, plus, scaled

SENSOR_SIGNALS = 12
"""Per inertial sensor: acceleration and velocity by the modes, turn and turning rate by the modes."""


class Constants(NamedTuple):
    """What a compiled observer works with; nothing in it changes while it runs."""

    sizes: np.ndarray  # (10,) int: axes, modes, sensors, adapted, states, measurements, noise sources, disturbances, in a band, offsets
    harmonics: np.ndarray  # (axes,) int
    coefficients: np.ndarray  # (basis, rows): `ModalModel.all_rows`, transposed
    adapted: np.ndarray  # (modes,) int: place of the mode's log frequency ratio in the state, -1 where it is fixed
    axes: np.ndarray  # (axes, 3)
    points: np.ndarray  # (axes, 3)
    revolute: np.ndarray  # (axes,) bool
    sensors: np.ndarray  # (sensors, 16): body's centre, sensor, rotation by rows, lag
    source_and_gravity: np.ndarray  # (2, 3)
    period_s: float
    colour: np.ndarray  # (disturbances, 5): transition by rows, disturbance before quadrature; what drives the first in the second
    quadrature: np.ndarray  # (disturbances,) int: its place in the state, -1 where the disturbance is of first order
    offset_kept: np.ndarray  # (offsets,): share of an offset that a sample leaves
    noise_std: np.ndarray  # (noise sources,): commands, disturbances, quadratures, adapted, offsets, biases
    measurement_std: np.ndarray  # (measurements,)


class Scheduled(NamedTuple):
    """The model's parameters at the scheduled pose, as the equations want them. Overwritten once per sample."""

    values: np.ndarray  # (rows,)
    modes: np.ndarray  # (modes, 8): ω², 2ζω, discretisation over the period
    encoders: np.ndarray  # (modes, 3 axes): motor shapes, link shapes, inputs
    rigid: np.ndarray  # (axes, axes + 1): B_r, friction at the drive per speed of its motor side, in the command's unit
    directions: np.ndarray  # (axes + modes, disturbances)
    acting: np.ndarray  # (2 axes + modes,): the command that acts, then what gravity and turning push at this pose
    forces: np.ndarray  # (2 axes + modes,): scratch of `accelerations`
    looks: np.ndarray  # (sensors, modes, 15): what a sensor sees of a mode, see `look`; then its shape at the sensor


@exactly_inlined
def mode_step(stiffness, damping, duration):
    """Exact discretisation of η'' = -stiffness η - damping η' + f, f held: Φ11, Φ12, Φ21, Φ22, Γ1, Γ2. Backwards for duration < 0."""
    half = 0.5 * damping
    root = np.sqrt(max(stiffness - half * half, 1e-12))
    e = np.exp(-half * duration)
    c = np.cos(root * duration)
    s = np.sin(root * duration) / root
    first = e * (c + half * s)
    return first, e * s, -stiffness * e * s, e * (c - half * s), (1.0 - first) / stiffness, e * s


@exactly_inlined
def look(stiffness, damping, lag):
    """Deflection, speed and acceleration of a mode as a sensor shows them, from [η, η', f] now: three rows of three.

    A low pass far above the mode is a lag: the motion `lag` ago, speed and acceleration with the low pass's gain at the mode's frequency.
    """
    p11, p12, p21, p22, g1, g2 = mode_step(stiffness, damping, -lag)
    gain = 1.0 / np.sqrt(1.0 + stiffness * lag * lag)
    return (
        p11, p12, g1,
        gain * p21, gain * p22, gain * g2,
        -gain * (stiffness * p11 + damping * p21), -gain * (stiffness * p12 + damping * p22), gain * (1.0 - stiffness * g1 - damping * g2),
    )  # fmt: skip


@exactly_inlined
def prepare(constants, x, scheduled):
    """All parameters at a state's pose, and what turning pushes at its speeds."""
    sizes, modes_at, encoders, rigid, looks = constants.sizes, scheduled.modes, scheduled.encoders, scheduled.rigid, scheduled.looks
    n, modes, sensors = sizes[0], sizes[1], sizes[2]
    values, period = scheduled.values, constants.period_s
    schedule(sizes, constants.harmonics, constants.coefficients, x, values)
    stride = 2 + 3 * n + 6 * sensors
    for i in range(modes):
        first = i * stride
        stiffness, damping = values[first], values[first + 1]
        modes_at[i, 0], modes_at[i, 1] = stiffness, damping
        modes_at[i, 2], modes_at[i, 3], modes_at[i, 4], modes_at[i, 5], modes_at[i, 6], modes_at[i, 7] = mode_step(
            stiffness, damping, period
        )
        for k in range(2 * n):
            encoders[i, k] = values[first + 2 + k]
        for k in range(n):
            encoders[i, 2 * n + k] = values[first + stride - n + k]
        for s in range(sensors):
            rows = look(stiffness, damping, constants.sensors[s, 15])
            for j in range(9):
                looks[s, i, j] = rows[j]
            place = first + 2 + 2 * n + 6 * s
            shift = values[place], values[place + 1], values[place + 2]
            turn = values[place + 3], values[place + 4], values[place + 5]
            at = constants.sensors
            arm = at[s, 3] - at[s, 0], at[s, 4] - at[s, 1], at[s, 5] - at[s, 2]
            shift = plus(shift, cross(turn, arm))
            for j in range(3):
                looks[s, i, 9 + j] = shift[j]
                looks[s, i, 12 + j] = turn[j]
    first = modes * stride
    for i in range(n):
        for k in range(n):
            rigid[i, k] = values[first + i * n + k]
        rigid[i, n] = values[first + n * n + i]
    first += n * (n + 1)
    for i in range(n + modes):
        scheduled.acting[n + i] = values[first + i]
    first += n + modes + 6
    for i in range(n + modes):
        stiffness = 1.0 if i < n else modes_at[i - n, 0]
        for j in range(sizes[7]):
            scheduled.directions[i, j] = stiffness * values[first + i * sizes[7] + j]
    row = first + (n + modes) * sizes[7]
    if row < len(values):
        for i in range(n + modes):
            stiffness = 1.0 if i < n else modes_at[i - n, 0]
            for j in range(n):
                for k in range(j, n):
                    scheduled.acting[n + i] += stiffness * values[row] * x[n + j] * x[n + k]
                    row += 1


@exactly_inlined
def first_offset(constants):
    """Place of the offsets in the state: motor sides' encoders, then the detector's twist."""
    return constants.sizes[4] - 6 * constants.sizes[2] - constants.sizes[9]


@exactly_inlined
def pushed(constants, scheduled, x, i):
    """Acceleration that the disturbances of a state give coordinate i, axes before modes."""
    push, total = 2 * (constants.sizes[0] + constants.sizes[1]), 0.0
    for j in range(constants.sizes[7]):
        total += scheduled.directions[i, j] * x[push + j]
    return total


@exactly_inlined
def friction(scheduled, n, modes, x, k):
    """At drive k, in the command's unit, from its motor side's speed."""
    speed = x[n + k]
    for i in range(modes):
        speed += scheduled.encoders[i, k] * x[2 * n + modes + i]
    return -scheduled.rigid[k, n] * speed


@exactly_inlined
def accelerations(constants, scheduled, x, xi, u, out):
    """Of the axes, and what forces the modes, into out (axes + modes,), friction at the drives after them (axes,).

    `xi` is a state whose disturbances push; u as `Scheduled.acting`, zeros for a deviation.
    """
    n, modes = constants.sizes[0], constants.sizes[1]
    for k in range(n):
        out[n + modes + k] = friction(scheduled, n, modes, x, k)
    for i in range(n):
        total = pushed(constants, scheduled, xi, i) + u[n + i]
        for k in range(n):
            total += scheduled.rigid[i, k] * (u[k] + out[n + modes + k])
        out[i] = total
    for i in range(modes):
        total = pushed(constants, scheduled, xi, n + i) + u[2 * n + i]
        for k in range(n):
            total += scheduled.encoders[i, 2 * n + k] * (u[k] + out[n + modes + k])
        out[n + i] = total


@exactly_inlined
def halfway(constants, scheduled, x, force):
    """Accelerations as `accelerations` finds them, friction taken half a sample on: its speed changes while the rest holds."""
    n, modes, half = constants.sizes[0], constants.sizes[1], 0.5 * constants.period_s
    for k in range(n):
        gained = force[k]
        for i in range(modes):
            at = scheduled.modes
            gained += scheduled.encoders[i, k] * (force[n + i] - at[i, 0] * x[2 * n + i] - at[i, 1] * x[2 * n + modes + i])
        force[n + modes + k] = -scheduled.rigid[k, n] * half * gained
    for k in range(n):
        for i in range(n):
            force[i] += scheduled.rigid[i, k] * force[n + modes + k]
        for i in range(modes):
            force[n + i] += scheduled.encoders[i, 2 * n + k] * force[n + modes + k]


@exactly_inlined
def transition(constants, scheduled, x, u, out):
    """State one sample later while u acts, laid out as `Scheduled.acting`. Linear in x where no mode is adapted.

    A disturbance in the state is the one that acted until now: it decays first, then acts over the sample, and so the sensors see it.
    """
    n, modes, states = constants.sizes[0], constants.sizes[1], constants.sizes[4]
    period, adapted, colour, at = constants.period_s, constants.adapted, constants.colour, scheduled.modes
    push = 2 * n + 2 * modes
    for j in range(constants.sizes[7]):
        out[push + j] = colour[j, 0] * x[push + j]
        beside = constants.quadrature[j]
        if beside >= 0:
            out[push + j] += colour[j, 1] * x[beside]
            out[beside] = colour[j, 2] * x[push + j] + colour[j, 3] * x[beside]
    force = scheduled.forces
    accelerations(constants, scheduled, x, out, u, force)
    halfway(constants, scheduled, x, force)
    for i in range(n):
        out[i] = x[i] + period * (x[n + i] + 0.5 * period * force[i])
        out[n + i] = x[n + i] + period * force[i]
    for i in range(modes):
        p11, p12, p21, p22, g1, g2 = at[i, 2], at[i, 3], at[i, 4], at[i, 5], at[i, 6], at[i, 7]
        if adapted[i] >= 0:
            ratio = np.exp(x[adapted[i]])
            p11, p12, p21, p22, g1, g2 = mode_step(at[i, 0] * ratio * ratio, at[i, 1] * ratio, period)
        position, speed = x[2 * n + i], x[2 * n + modes + i]
        out[2 * n + i] = p11 * position + p12 * speed + g1 * force[n + i]
        out[2 * n + modes + i] = p21 * position + p22 * speed + g2 * force[n + i]
    for i in range(push + constants.sizes[7] + constants.sizes[8], states):
        out[i] = x[i]
    offsets = first_offset(constants)
    for i in range(constants.sizes[9]):
        out[offsets + i] = constants.offset_kept[i] * x[offsets + i]


@exactly_inlined
def signals(constants, scheduled, x, u, out):
    """Motor sides, link sides; per sensor the axes' position, speed and acceleration `lag` ago and `SENSOR_SIGNALS`, into out.

    Linear in x and u where no mode is adapted.
    """
    n, modes, sensors = constants.sizes[0], constants.sizes[1], constants.sizes[2]
    encoders, looks, adapted = scheduled.encoders, scheduled.looks, constants.adapted
    for i in range(n):
        motor, link = x[i], x[i]
        for j in range(modes):
            motor += encoders[j, i] * x[2 * n + j]
            link += encoders[j, n + i] * x[2 * n + j]
        out[i], out[n + i] = motor, link
    if constants.sizes[9] > 0:
        offsets = first_offset(constants)
        for i in range(n):
            out[i] += x[offsets + i]
    forces = scheduled.forces
    accelerations(constants, scheduled, x, x, u, forces)
    for s in range(sensors):
        lag = constants.sensors[s, 15]
        place = 2 * n + s * (3 * n + SENSOR_SIGNALS)
        for i in range(n):
            a = forces[i]
            out[place + i] = x[i] - lag * (x[n + i] - 0.5 * lag * a)
            out[place + n + i] = x[n + i] - lag * a
            out[place + 2 * n + i] = a
        acceleration, velocity, turn, rate = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for i in range(modes):
            position, speed = x[2 * n + i], x[2 * n + modes + i]
            force = forces[n + i]
            if adapted[i] >= 0:
                ratio = np.exp(x[adapted[i]])
                rows = look(scheduled.modes[i, 0] * ratio * ratio, scheduled.modes[i, 1] * ratio, lag)
                past = rows[0] * position + rows[1] * speed + rows[2] * force
                past_speed = rows[3] * position + rows[4] * speed + rows[5] * force
                felt = rows[6] * position + rows[7] * speed + rows[8] * force
            else:
                past = looks[s, i, 0] * position + looks[s, i, 1] * speed + looks[s, i, 2] * force
                past_speed = looks[s, i, 3] * position + looks[s, i, 4] * speed + looks[s, i, 5] * force
                felt = looks[s, i, 6] * position + looks[s, i, 7] * speed + looks[s, i, 8] * force
            shift = looks[s, i, 9], looks[s, i, 10], looks[s, i, 11]
            twist = looks[s, i, 12], looks[s, i, 13], looks[s, i, 14]
            acceleration, velocity = plus(acceleration, scaled(shift, felt)), plus(velocity, scaled(shift, past_speed))
            turn, rate = plus(turn, scaled(twist, past)), plus(rate, scaled(twist, past_speed))
        place += 3 * n
        for j in range(3):
            out[place + j], out[place + 3 + j] = acceleration[j], velocity[j]
            out[place + 6 + j], out[place + 9 + j] = turn[j], rate[j]


@exactly_inlined
def readings(constants, seen, z):
    """What the sensors read (measurements,) without their biases, from the signals."""
    n, sensors = constants.sizes[0], constants.sizes[2]
    at = constants.sensors
    for i in range(2 * n):
        z[i] = seen[i]
    for s in range(sensors):
        place = 2 * n + s * (3 * n + SENSOR_SIGNALS)
        end = at[s, 3], at[s, 4], at[s, 5]
        omega, _, force = chain_motion(
            constants.axes, constants.points, constants.revolute, constants.source_and_gravity[1], seen[place : place + 3 * n], end
        )
        place += 3 * n
        acceleration, velocity = (seen[place], seen[place + 1], seen[place + 2]), (seen[place + 3], seen[place + 4], seen[place + 5])
        turn, rate = (seen[place + 6], seen[place + 7], seen[place + 8]), (seen[place + 9], seen[place + 10], seen[place + 11])
        # (I - [ρ]x) of what the chain feels, the modes' own acceleration, and what turning makes of their velocity
        felt = plus(minus(force, cross(turn, force)), plus(acceleration, scaled(cross(omega, velocity), 2.0)))
        turned = plus(minus(omega, cross(turn, omega)), rate)
        place = 2 * n + 6 * s
        for j in range(3):
            z[place + j] = at[s, 6 + j] * felt[0] + at[s, 9 + j] * felt[1] + at[s, 12 + j] * felt[2]
            z[place + 3 + j] = at[s, 6 + j] * turned[0] + at[s, 9 + j] * turned[1] + at[s, 12 + j] * turned[2]
