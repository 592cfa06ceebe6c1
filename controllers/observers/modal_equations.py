"""The modal model as the filters use it: the state one sample later and the sensors' readings, (5.2), (5.3) with (5.30)-(5.35).

State: [q_r, q_r', η, η', ξ, quadratures of those ξ that lie in a band, log frequency ratios of the adapted modes,
offsets, gains, sensor biases]. Offsets, where there are any: of the motor sides' encoders, of the detector's twist that no mode contains
(5.37), and of the link sides' encoders. Gains, where there are any: how each sensor sits turned in its mount, and its errors of scale.

All but two parts are linear in the state and stand in tables (`linear_part`). The two are the dependence of an adapted mode on its
frequency ratio, and the sensors' readings (rotations, products of rates) as functions of a few signals. So a deviation is carried to the
next state and to the signals once, and only these two parts are evaluated at both of its ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.compiled import exactly_inlined
from controllers.models.chain import chain_motion
from controllers.models.vectors import cross, minus, plus, scaled

GAINS = 7
"""Gains per inertial sensor: a turn (3), the accelerometers' scales (3), the gyros' scale."""

SENSOR_SIGNALS = 12
"""Signals per inertial sensor: acceleration and velocity by the modes, turn and turning rate by the modes."""

MODE_SIGNALS = 4
"""Signals per adapted mode: deflection, speed, force, log frequency ratio."""


class Constants(NamedTuple):
    """Constants of a compiled observer; nothing in them changes while it runs."""

    sizes: np.ndarray  # (12,) int: axes, modes, sensors, adapted, states, measurements, noise sources, disturbances, in a band, offsets,
    # the sensor on the body of the focal spot, -1 without one, and gains
    harmonics: np.ndarray  # (axes,) int
    coefficients: np.ndarray  # (basis, rows): `ModalModel.all_rows`, transposed
    adapted: np.ndarray  # (adapted,) int: modes whose log frequency ratio is a state
    axes: np.ndarray  # (axes, 3)
    points: np.ndarray  # (axes, 3)
    revolute: np.ndarray  # (axes,) bool
    sensors: np.ndarray  # (sensors, 16): body's centre, sensor, rotation by rows, lag
    source_and_gravity: np.ndarray  # (2, 3)
    period_s: float
    effort_step: np.ndarray  # (axes,): step to which the drives round; 0: no rounding
    colour: np.ndarray  # (disturbances, 5): transition by rows, disturbance before quadrature; the disturbance's noise in the quadrature
    quadrature: np.ndarray  # (disturbances,) int: its place in the state, -1 where the disturbance is of first order
    kept: np.ndarray  # (states - moving,): share of a ratio, an offset, a gain or a bias that a sample leaves
    noise_std: np.ndarray  # (noise sources,): commands, disturbances, quadratures, adapted, offsets, gains, biases
    measurement_std: np.ndarray  # (measurements,)
    published: np.ndarray  # (values,): by what stated variances are multiplied


class Scheduled(NamedTuple):
    """The model at the scheduled pose, in the form of the equations. Overwritten once per sample.

    Tables have a row for each moving state, then one for each command, then one for the forces of gravity and turning.
    """

    values: np.ndarray  # (rows,)
    modes: np.ndarray  # (modes, 8): ω², 2ζω, discretisation over the period
    encoders: np.ndarray  # (modes, 3 axes): motor shapes, link shapes, inputs
    rigid: np.ndarray  # (axes, axes + 1): B_r, friction at the drive per speed of its motor side, in the command's unit
    directions: np.ndarray  # (axes + modes, disturbances)
    pushes: np.ndarray  # (axes + modes,): forces of gravity and turning
    speeds: np.ndarray  # (axes,) at which the model is scheduled
    command: np.ndarray  # (axes,): the command that acts
    rubbing: np.ndarray  # (axes + modes, axes + modes): by drives' friction and turning; row: per speed of a coordinate; column: on one
    forces: np.ndarray  # (table rows, axes + modes): accelerations of the axes, and forces on the modes
    shapes: np.ndarray  # (sensors, modes, 6): shift at the sensor, turn
    rates: np.ndarray  # (rows of the modes,): how fast their values, shapes above all, change as the axes move
    looks: np.ndarray  # (sensors, 3 modes, SENSOR_SIGNALS): a sensor's signals of a mode's deflection, speed and force; adapted modes: zero
    steps: np.ndarray  # (table rows, moving + MODE_SIGNALS adapted): moving states one sample later, and the adapted modes at this sample
    sees: np.ndarray  # (table rows, signals)


@exactly_inlined
def moving(constants: Constants) -> int:
    """Return the number of states that move others: axes, modes, disturbances, quadratures. The rest stay or decay."""
    sizes = constants.sizes
    count: int = 2 * (sizes[0] + sizes[1]) + sizes[7] + sizes[8]
    return count


@exactly_inlined
def first_bias(constants: Constants) -> int:
    """Return the place of the sensors' biases in the state."""
    place: int = constants.sizes[4] - 6 * constants.sizes[2]
    return place


@exactly_inlined
def first_gain(constants: Constants) -> int:
    """Return the place of the sensors' gains in the state; what stands there and behind it only changes readings."""
    place: int = first_bias(constants) - constants.sizes[11]
    return place


@exactly_inlined
def first_offset(constants: Constants) -> int:
    """Return the place of the offsets in the state: motor sides' encoders, the detector's twist, link sides' encoders."""
    place: int = first_gain(constants) - constants.sizes[9]
    return place


@exactly_inlined
def adapted_signals(constants: Constants) -> int:
    """Return the place of the adapted modes among the signals: after motor sides, link sides and the sensors' signals."""
    n, sensors = constants.sizes[0], constants.sizes[2]
    place: int = 2 * n + sensors * (3 * n + SENSOR_SIGNALS)
    return place


@exactly_inlined
def rounded(constants: Constants, command: np.ndarray, out: np.ndarray) -> None:
    """Write commands (axes,) as the drives round them into out (axes,)."""
    for i in range(constants.sizes[0]):
        step = constants.effort_step[i]
        out[i] = step * np.rint(command[i] / step) if step > 0.0 else command[i]


@exactly_inlined
def mode_step(stiffness: float, damping: float, duration: float) -> tuple[float, float, float, float, float, float]:
    """Discretise η'' = -stiffness η - damping η' + f exactly, f held: Φ11, Φ12, Φ21, Φ22, Γ1, Γ2. A duration < 0 steps backwards."""
    half = 0.5 * damping
    root = np.sqrt(max(stiffness - half * half, 1e-12))
    e = np.exp(-half * duration)
    c = np.cos(root * duration)
    s = np.sin(root * duration) / root
    first = e * (c + half * s)
    return first, e * s, -stiffness * e * s, e * (c - half * s), (1.0 - first) / stiffness, e * s


@exactly_inlined
def look(stiffness: float, damping: float, lag: float) -> tuple[float, ...]:
    """Return deflection, speed and acceleration of a mode as a sensor shows them, from [η, η', f] at this sample: three rows of three.

    A low pass far above the mode acts as a lag: the sensor shows the motion `lag` ago, speed and acceleration with the low pass's gain at
    the mode's frequency.
    """
    p11, p12, p21, p22, g1, g2 = mode_step(stiffness, damping, -lag)
    gain = 1.0 / np.sqrt(1.0 + stiffness * lag * lag)
    return (
        p11, p12, g1,
        gain * p21, gain * p22, gain * g2,
        -gain * (stiffness * p11 + damping * p21), -gain * (stiffness * p12 + damping * p22), gain * (1.0 - stiffness * g1 - damping * g2),
    )  # fmt: skip


@exactly_inlined
def adapted_step(constants: Constants, scheduled: Scheduled, mode: int, now: np.ndarray) -> tuple[float, float]:
    """Return deflection and speed of an adapted mode one sample later, from its `MODE_SIGNALS` at this sample."""
    ratio = np.exp(now[3])
    p11, p12, p21, p22, g1, g2 = mode_step(scheduled.modes[mode, 0] * ratio * ratio, scheduled.modes[mode, 1] * ratio, constants.period_s)
    return p11 * now[0] + p12 * now[1] + g1 * now[2], p21 * now[0] + p22 * now[1] + g2 * now[2]


@exactly_inlined
def seen_of_mode(constants: Constants, scheduled: Scheduled, sensor: int, mode: int, seen: np.ndarray) -> tuple[float, float, float]:
    """Return deflection, speed and acceleration of an adapted mode as a sensor shows them, from its `MODE_SIGNALS`."""
    position, speed, force, ratio = seen[0], seen[1], seen[2], np.exp(seen[3])
    rows = look(scheduled.modes[mode, 0] * ratio * ratio, scheduled.modes[mode, 1] * ratio, constants.sensors[sensor, 15])
    return (
        rows[0] * position + rows[1] * speed + rows[2] * force,
        rows[3] * position + rows[4] * speed + rows[5] * force,
        rows[6] * position + rows[7] * speed + rows[8] * force,
    )


@exactly_inlined
def misread(constants: Constants, x: np.ndarray, read: np.ndarray, out: np.ndarray) -> None:
    """Add to `out` (measurements,) what the gains and biases of a state, or of a deviation, make of readings (measurements,)."""
    n, sensors = constants.sizes[0], constants.sizes[2]
    biases = first_bias(constants)
    for j in range(6 * sensors):
        out[2 * n + j] += x[biases + j]
    if constants.sizes[11] == 0:
        return
    for s in range(sensors):
        gain, place = first_gain(constants) + GAINS * s, 2 * n + 6 * s
        turn = x[gain], x[gain + 1], x[gain + 2]
        force = read[place], read[place + 1], read[place + 2]
        rate = read[place + 3], read[place + 4], read[place + 5]
        turned, spun = cross(turn, force), cross(turn, rate)
        for j in range(3):
            out[place + j] += turned[j] + x[gain + 3 + j] * force[j]
            out[place + 3 + j] += spun[j] + x[gain + 6] * rate[j]


@exactly_inlined
def readings(constants: Constants, scheduled: Scheduled, seen: np.ndarray, z: np.ndarray) -> None:
    """Write the sensors' readings (measurements,), without their biases, from the signals."""
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
        # (I - [ρ]x) of the rigid chain's force, the modes' own acceleration, and the Coriolis part of their velocity
        felt = plus(minus(force, cross(turn, force)), plus(acceleration, scaled(cross(omega, velocity), 2.0)))
        turned = plus(minus(omega, cross(turn, omega)), rate)
        place = 2 * n + 6 * s
        for j in range(3):
            z[place + j] = at[s, 6 + j] * felt[0] + at[s, 9 + j] * felt[1] + at[s, 12 + j] * felt[2]
            z[place + 3 + j] = at[s, 6 + j] * turned[0] + at[s, 9 + j] * turned[1] + at[s, 12 + j] * turned[2]
