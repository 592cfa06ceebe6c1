"""The modal model as the filters ask it: one state one sample on, and what the sensors would read. (5.2), (5.3) with (5.30)-(5.35).

State: [q_r, q_r', η, η', ξ, quadratures of those ξ that lie in a band, log frequency ratios of the adapted modes,
offsets, sensor biases]. Offsets, where there are any: of the motor sides' encoders, and of the detector's twist that no mode has (5.37).

All but two things are linear in the state, and stand in tables (`linear_part`): what an adapted mode does with its frequency ratio, and
what the sensors read (rotations, products of rates) of a few signals. So a deviation is carried to the next state and to the signals once,
and only these two are asked at both of its ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.compiled import exactly_inlined
from controllers.models.chain import chain_motion
from controllers.models.vectors import cross, minus, plus, scaled

SENSOR_SIGNALS = 12
"""Per inertial sensor: acceleration and velocity by the modes, turn and turning rate by the modes."""

MODE_SIGNALS = 4
"""Per adapted mode: deflection, speed, what forces it, log frequency ratio."""


class Constants(NamedTuple):
    """What a compiled observer works with; nothing in it changes while it runs."""

    sizes: np.ndarray  # (10,) int: axes, modes, sensors, adapted, states, measurements, noise sources, disturbances, in a band, offsets
    harmonics: np.ndarray  # (axes,) int
    coefficients: np.ndarray  # (basis, rows): `ModalModel.all_rows`, transposed
    adapted: np.ndarray  # (adapted,) int: modes whose log frequency ratio is a state
    axes: np.ndarray  # (axes, 3)
    points: np.ndarray  # (axes, 3)
    revolute: np.ndarray  # (axes,) bool
    sensors: np.ndarray  # (sensors, 16): body's centre, sensor, rotation by rows, lag
    source_and_gravity: np.ndarray  # (2, 3)
    period_s: float
    effort_step: np.ndarray  # (axes,): to which the drives round; 0: not at all
    colour: np.ndarray  # (disturbances, 5): transition by rows, disturbance before quadrature; what drives the first in the second
    quadrature: np.ndarray  # (disturbances,) int: its place in the state, -1 where the disturbance is of first order
    kept: np.ndarray  # (states - moving,): share of a ratio, an offset or a bias that a sample leaves
    noise_std: np.ndarray  # (noise sources,): commands, disturbances, quadratures, adapted, offsets, biases
    measurement_std: np.ndarray  # (measurements,)


class Scheduled(NamedTuple):
    """The model at the scheduled pose, as the equations want it. Overwritten once per sample.

    Tables have a row for each moving state, then one for each command, then one for what gravity and turning push.
    """

    values: np.ndarray  # (rows,)
    modes: np.ndarray  # (modes, 8): ω², 2ζω, discretisation over the period
    encoders: np.ndarray  # (modes, 3 axes): motor shapes, link shapes, inputs
    rigid: np.ndarray  # (axes, axes + 1): B_r, friction at the drive per speed of its motor side, in the command's unit
    directions: np.ndarray  # (axes + modes, disturbances)
    pushes: np.ndarray  # (axes + modes,): what gravity and turning push
    speeds: np.ndarray  # (axes,) at which the model is scheduled
    command: np.ndarray  # (axes,): what acts
    rubbing: np.ndarray  # (axes + modes, axes + modes): by drives' friction and turning, row: per speed of a coordinate; column: on one
    forces: np.ndarray  # (table rows, axes + modes): accelerations of the axes, and what forces the modes
    shapes: np.ndarray  # (sensors, modes, 6): shift at the sensor, turn
    looks: np.ndarray  # (sensors, 3 modes, SENSOR_SIGNALS): what a sensor sees of deflection, speed and force of a mode; adapted: zero
    steps: np.ndarray  # (table rows, moving + MODE_SIGNALS adapted): moving states one sample later, and the adapted modes now
    sees: np.ndarray  # (table rows, signals)


@exactly_inlined
def moving(constants):
    """How many states move others: axes, modes, disturbances, quadratures. The rest stay or decay."""
    sizes = constants.sizes
    return 2 * (sizes[0] + sizes[1]) + sizes[7] + sizes[8]


@exactly_inlined
def first_bias(constants):
    """Place of the sensors' biases in the state."""
    return constants.sizes[4] - 6 * constants.sizes[2]


@exactly_inlined
def first_offset(constants):
    """Place of the offsets in the state: motor sides' encoders, then the detector's twist."""
    return first_bias(constants) - constants.sizes[9]


@exactly_inlined
def adapted_signals(constants):
    """Place of the adapted modes among the signals: after motor sides, link sides and what the sensors see."""
    n, sensors = constants.sizes[0], constants.sizes[2]
    return 2 * n + sensors * (3 * n + SENSOR_SIGNALS)


@exactly_inlined
def rounded(constants, command, out):
    """Commands (axes,) as the drives round them, into out (axes,)."""
    for i in range(constants.sizes[0]):
        step = constants.effort_step[i]
        out[i] = step * np.rint(command[i] / step) if step > 0.0 else command[i]


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
def adapted_step(constants, scheduled, mode, now):
    """Deflection and speed of an adapted mode one sample later, from its `MODE_SIGNALS` now."""
    ratio = np.exp(now[3])
    p11, p12, p21, p22, g1, g2 = mode_step(scheduled.modes[mode, 0] * ratio * ratio, scheduled.modes[mode, 1] * ratio, constants.period_s)
    return p11 * now[0] + p12 * now[1] + g1 * now[2], p21 * now[0] + p22 * now[1] + g2 * now[2]


@exactly_inlined
def seen_of_mode(constants, scheduled, sensor, mode, seen):
    """Deflection, speed and acceleration of an adapted mode as a sensor shows them, from its `MODE_SIGNALS`."""
    position, speed, force, ratio = seen[0], seen[1], seen[2], np.exp(seen[3])
    rows = look(scheduled.modes[mode, 0] * ratio * ratio, scheduled.modes[mode, 1] * ratio, constants.sensors[sensor, 15])
    return (
        rows[0] * position + rows[1] * speed + rows[2] * force,
        rows[3] * position + rows[4] * speed + rows[5] * force,
        rows[6] * position + rows[7] * speed + rows[8] * force,
    )


@exactly_inlined
def readings(constants, scheduled, seen, z):
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
        for k in range(constants.sizes[3]):
            mode = adapted_signals(constants) + MODE_SIGNALS * k
            past, past_speed, pressed = seen_of_mode(constants, scheduled, s, constants.adapted[k], seen[mode : mode + MODE_SIGNALS])
            shape = scheduled.shapes[s, constants.adapted[k]]
            shift, twist = (shape[0], shape[1], shape[2]), (shape[3], shape[4], shape[5])
            acceleration, velocity = plus(acceleration, scaled(shift, pressed)), plus(velocity, scaled(shift, past_speed))
            turn, rate = plus(turn, scaled(twist, past)), plus(rate, scaled(twist, past_speed))
        # (I - [ρ]x) of what the chain feels, the modes' own acceleration, and what turning makes of their velocity
        felt = plus(minus(force, cross(turn, force)), plus(acceleration, scaled(cross(omega, velocity), 2.0)))
        turned = plus(minus(omega, cross(turn, omega)), rate)
        place = 2 * n + 6 * s
        for j in range(3):
            z[place + j] = at[s, 6 + j] * felt[0] + at[s, 9 + j] * felt[1] + at[s, 12 + j] * felt[2]
            z[place + 3 + j] = at[s, 6 + j] * turned[0] + at[s, 9 + j] * turned[1] + at[s, 12 + j] * turned[2]
