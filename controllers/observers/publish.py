"""Published values from the observer's state: the detector's displacement and velocity, and the geometric parameters (2.2)."""

from __future__ import annotations

import numpy as np

from controllers.bound import Bound
from controllers.compiled import exactly_called, exactly_compiled
from controllers.models.chain import axis_screw, direction_in_world, point_in_world
from controllers.models.vectors import dot, minus, plus, row
from controllers.observers.consistency import corrects_too_much, is_unusual, mean_innovation
from controllers.observers.linear_part import TURN_STEP_s
from controllers.observers.modal_equations import Constants, Scheduled, first_offset

TWIST = ("x", "y", "z", "rx", "ry", "rz")
GEOMETRY = 9
QUANTITIES = (
    "motor side", "link side", "displacement", "turn", "velocity", "angular velocity", "focal spot", "isocentre", "orientation",
)  # fmt: skip
"""What the published values are of, in their order."""
GEOMETRY_STEP = 1e-6
"""Difference step [rad, m] for the variances of the geometric parameters; the gradient's error is 1e-10."""


def estimate_channels(axes: tuple[str, ...], units: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return names and units of the published values in order: values, `<name>_variance` of each, then four consistency numbers."""
    values = [(f"estimate_position_{axis}", unit) for axis, unit in zip(axes, units, strict=True)]
    values += [(f"estimate_link_position_{axis}", unit) for axis, unit in zip(axes, units, strict=True)]
    values += [(f"estimate_detector_{name}", "m") for name in "xyz"] + [(f"estimate_detector_r{name}", "rad") for name in "xyz"]
    values += [(f"estimate_detector_v{name}", "m/s") for name in "xyz"] + [(f"estimate_detector_w{name}", "rad/s") for name in "xyz"]
    values += [(f"estimate_source_{name}", "m") for name in "xyz"] + [(f"estimate_isocenter_{name}", "m") for name in "xyz"]
    values += [(f"estimate_orientation_{name}", "rad") for name in "xyz"]
    variances = [(f"{name}_variance", squared(unit)) for name, unit in values]
    return values + variances + [("estimate_nis", ""), ("estimate_measured", ""), ("estimate_nis_window", ""), ("estimate_alarm", "")]


def of_quantities(axes: int) -> np.ndarray:
    """Return which of `QUANTITIES` each published value (values,) is of."""
    return np.repeat(np.arange(len(QUANTITIES)), [axes, axes, *[3] * (len(QUANTITIES) - 2)])


def squared(unit: str) -> str:
    """Return the unit of a variance."""
    return {"m": "m^2", "rad": "rad^2", "m/s": "m^2/s^2", "rad/s": "rad^2/s^2"}[unit]


@exactly_called
def geometric_parameters(constants: Constants, motion: np.ndarray, isocenter: np.ndarray, out: np.ndarray) -> None:
    """Write focal spot and isocentre in the detector's frame [m], then the detector's orientation as extrinsic x, y, z angles (2.2).

    `motion` (2 axes + 6,) is motor side, link side and displacement; three more are the focal spot's. The detector is displaced from its
    pose on the rigid chain at the motor side's positions, and so is the focal spot, which without a displacement of its own follows the
    link side. The angles are those in the world.
    """
    n = constants.sizes[0]
    chain = (constants.axes, constants.points, constants.revolute)
    motor, link = motion[:n], motion[n : 2 * n]
    shift = motion[2 * n], motion[2 * n + 1], motion[2 * n + 2]
    turn = motion[2 * n + 3], motion[2 * n + 4], motion[2 * n + 5]
    end = constants.sensors[0, 0], constants.sensors[0, 1], constants.sensors[0, 2]
    center = point_in_world(*chain, motor, plus(end, shift))
    at_source = row(constants.source_and_gravity, 0)
    if len(motion) > 2 * n + 6:
        source = point_in_world(*chain, motor, plus(at_source, (motion[2 * n + 6], motion[2 * n + 7], motion[2 * n + 8])))
    else:
        source = point_in_world(*chain, link, at_source)
    # columns of R (I + [ρ]x)
    x = direction_in_world(constants.axes, constants.revolute, motor, (1.0, turn[2], -turn[1]))
    y = direction_in_world(constants.axes, constants.revolute, motor, (-turn[2], 1.0, turn[0]))
    z = direction_in_world(constants.axes, constants.revolute, motor, (turn[1], -turn[0], 1.0))
    to_source, to_isocenter = minus(source, center), minus((isocenter[0], isocenter[1], isocenter[2]), center)
    out[0], out[1], out[2] = dot(x, to_source), dot(y, to_source), dot(z, to_source)
    out[3], out[4], out[5] = dot(x, to_isocenter), dot(y, to_isocenter), dot(z, to_isocenter)
    out[6] = np.arctan2(y[2], z[2])
    out[7] = np.arctan2(-x[2], np.sqrt(y[2] ** 2 + z[2] ** 2))
    out[8] = np.arctan2(x[1], x[0])


@exactly_called
def displacement_rows(constants: Constants, values: np.ndarray, motor: np.ndarray, rows: np.ndarray) -> None:
    """Write rows (2 axes + 6, axes + modes): motor side, link side and displacement relative to the motor side, from [q_r, η].

    Three more rows are the focal spot's displacement, as the sensor on its body shows it.
    """
    n, modes = constants.sizes[0], constants.sizes[1]
    stride = 2 + 3 * n + 6 * constants.sizes[2]
    end = constants.sensors[0, 0], constants.sensors[0, 1], constants.sensors[0, 2]
    rows[:] = 0.0
    for k in range(n):
        shift, turn = axis_screw(constants.axes, constants.points, constants.revolute, motor, end, k)
        rows[k, k] = 1.0
        rows[n + k, k] = 1.0
        for i in range(modes):
            motor_shape = values[i * stride + 2 + k]
            rows[k, n + i] = motor_shape
            rows[n + k, n + i] = values[i * stride + 2 + n + k]
            for j in range(3):
                rows[2 * n + j, n + i] -= shift[j] * motor_shape
                rows[2 * n + 3 + j, n + i] -= turn[j] * motor_shape
    for i in range(modes):
        for j in range(6):
            rows[2 * n + j, n + i] += values[i * stride + 2 + 2 * n + j]
    if len(rows) > 2 * n + 6:
        at_source = row(constants.source_and_gravity, 0)
        first = 2 + 2 * n + 6 * constants.sizes[10]
        for i in range(modes):
            for j in range(3):
                rows[2 * n + 6 + j, n + i] = values[i * stride + first + j]
            for k in range(n):
                shift, _ = axis_screw(constants.axes, constants.points, constants.revolute, motor, at_source, k)
                for j in range(3):
                    rows[2 * n + 6 + j, n + i] -= shift[j] * values[i * stride + 2 + k]


@exactly_called
def _turning_rows(constants: Constants, scheduled: Scheduled, x: np.ndarray, rates: np.ndarray) -> None:
    """Write how fast the rows of `displacement_rows` of the displacements change as the axes of a state move."""
    n = constants.sizes[0]
    later, sooner = np.zeros(rates.shape), np.zeros(rates.shape)
    displacement_rows(constants, scheduled.values, x[:n] + TURN_STEP_s * x[n : 2 * n], later)
    displacement_rows(constants, scheduled.values, x[:n] - TURN_STEP_s * x[n : 2 * n], sooner)
    displacement_rows(constants, scheduled.rates, x[:n], rates)
    for r in range(2 * n, len(rates)):
        for c in range(rates.shape[1]):
            rates[r, c] += (later[r, c] - sooner[r, c]) / (2.0 * TURN_STEP_s)


@exactly_called
def quasi_static(constants: Constants, values: np.ndarray, motor: np.ndarray, rows: np.ndarray, out: np.ndarray) -> None:
    """Write M_qs (5.37) into out (6,): the model's offsets of the detector's twist, less the shift that gravity's force on the modes gives.

    Three more are the focal spot's shift. Both are taken relative to the link sides, beyond which no sensor shows a shift at rest: mode
    shapes measured in motion are not trusted for the static deflection under gravity. `rows` are those of `displacement_rows` at `motor`.
    """
    n, modes = constants.sizes[0], constants.sizes[1]
    stride = 2 + 3 * n + 6 * constants.sizes[2]
    first = modes * stride
    push = first + n * (n + 1)
    for j in range(6):
        out[j] = values[push + n + modes + j]
    holding, left = np.zeros(n), np.zeros((n, n))  # B_r u = -d_r
    for i in range(n):
        holding[i] = -values[push + i]
        for k in range(n):
            left[i, k] = values[first + i * n + k]
    for i in range(n):
        if left[i, i] == 0.0:
            return
        for other in range(n):
            if other != i:
                share = left[other, i] / left[i, i]
                holding[other] -= share * holding[i]
                for k in range(n):
                    left[other, k] -= share * left[i, k]
    bend = np.zeros(modes)
    for i in range(modes):
        force = values[push + n + i]
        for k in range(n):
            force += values[i * stride + stride - n + k] * holding[k] / left[k, k]
        bend[i] = force / values[i * stride]
    for place in range(0, len(out), 6):  # the detector, the focal spot
        end = row(constants.source_and_gravity, 0) if place else row(constants.sensors, 0)
        for i in range(modes):
            for j in range(3):
                out[place + j] -= rows[2 * n + place + j, n + i] * bend[i]
        for k in range(n):
            shift, _ = axis_screw(constants.axes, constants.points, constants.revolute, motor, end, k)
            wound = 0.0
            for i in range(modes):
                wound += (rows[n + k, n + i] - rows[k, n + i]) * bend[i]
            for j in range(3):
                out[place + j] += shift[j] * wound


@exactly_called
def _moved(constants: Constants, rows: np.ndarray, states: np.ndarray, out: np.ndarray) -> None:
    """Write what rows of deviations of the state (N, states) move: motor sides, link sides, the displacements (moved, N)."""
    n, modes = constants.sizes[0], constants.sizes[1]
    for s in range(len(states)):
        for r in range(len(rows)):
            total = 0.0
            for i in range(n):
                total += rows[r, i] * states[s, i]
            for i in range(modes):
                total += rows[r, n + i] * states[s, 2 * n + i]
            out[r, s] = total
        if constants.sizes[9] > n:
            for j in range(6):
                out[2 * n + j, s] += states[s, first_offset(constants) + n + j]


@exactly_compiled
def publish(filter_: Bound, summary: np.ndarray, isocenter: np.ndarray, estimate: np.ndarray) -> None:
    """Write `estimate` (channels,): values, their variances, and four consistency numbers, the first two from `summary` (1, 3).

    `filter_` binds constants, scheduled model, memory, and what the two monitors remember.
    """
    constants, scheduled, memory, innovations, corrections = filter_.held
    n, modes, states, values = constants.sizes[0], constants.sizes[1], constants.sizes[4], scheduled.values
    x, factor = memory.x, memory.factor
    count = 2 * n + 12 + GEOMETRY
    wide = 2 * n + 6
    moved = wide + 3 if constants.sizes[10] >= 0 else wide  # the focal spot's displacement is no channel
    rows = np.zeros((moved, n + modes))
    displacement_rows(constants, values, x[:n], rows)
    offset = np.zeros(moved - 2 * n)
    quasi_static(constants, values, x[:n], rows, offset)
    motion = np.zeros(moved)
    by_measurement = memory.correction
    deviations, by_sample, spread = np.zeros((moved, states)), np.zeros((moved, len(by_measurement))), np.zeros(states)
    for r in range(moved):
        for i in range(n):
            motion[r] += rows[r, i] * x[i]
        for i in range(modes):
            motion[r] += rows[r, n + i] * x[2 * n + i]
    _moved(constants, rows, factor, deviations)
    _moved(constants, rows, by_measurement, by_sample)
    if constants.sizes[9] > n:
        first = first_offset(constants) + n
        for j in range(6):
            motion[2 * n + j] += x[first + j]
    for r in range(2 * n, moved):
        motion[r] += offset[r - 2 * n]
    for r in range(wide):
        variance = 0.0
        for s in range(states):
            variance += deviations[r, s] ** 2
        estimate[r] = motion[r]
        estimate[count + r] = variance * constants.published[r]
    turning = np.zeros((moved, n + modes))
    _turning_rows(constants, scheduled, x, turning)
    for r in range(6):
        speed, variance = 0.0, 0.0
        for i in range(modes):
            speed += rows[2 * n + r, n + i] * x[2 * n + modes + i] + turning[2 * n + r, n + i] * x[2 * n + i]
        for s in range(states):
            total = 0.0
            for i in range(modes):
                total += rows[2 * n + r, n + i] * factor[s, 2 * n + modes + i] + turning[2 * n + r, n + i] * factor[s, 2 * n + i]
            variance += total * total
        estimate[wide + r] = speed
        estimate[count + wide + r] = variance * constants.published[wide + r]
    place = wide + 6
    geometry, upper, lower = estimate[place : place + GEOMETRY], np.zeros(GEOMETRY), np.zeros(GEOMETRY)
    gradient = np.zeros((GEOMETRY, moved))
    geometric_parameters(constants, motion, isocenter, geometry)
    for r in range(moved):
        kept = motion[r]
        motion[r] = kept + GEOMETRY_STEP
        geometric_parameters(constants, motion, isocenter, upper)
        motion[r] = kept - GEOMETRY_STEP
        geometric_parameters(constants, motion, isocenter, lower)
        motion[r] = kept
        for g in range(GEOMETRY):
            difference = upper[g] - lower[g]
            if g >= 6:  # an angle may wrap between the two
                difference -= 2.0 * np.pi * np.round(difference / (2.0 * np.pi))
            gradient[g, r] = difference / (2.0 * GEOMETRY_STEP)
    memory.corrected[:] = 0.0
    for g in range(GEOMETRY):
        for s in range(states):
            spread[s] = 0.0
        for r in range(moved):
            slope = gradient[g, r]
            for s in range(states):
                spread[s] += slope * deviations[r, s]
        variance = 0.0
        for s in range(states):
            variance += spread[s] * spread[s]
        estimate[count + place + g] = variance * constants.published[place + g]
        for s in range(len(by_measurement)):
            total = 0.0
            for r in range(moved):
                total += gradient[g, r] * by_sample[r, s]
            if s == 0:
                memory.corrected[0, g] = total
            else:
                memory.corrected[1, g] += total * total
    tail = 2 * count
    estimate[tail], estimate[tail + 1] = summary[0, 0], summary[0, 1]
    estimate[tail + 2] = mean_innovation(innovations, summary[0, 0], summary[0, 1])
    if len(corrections.usual):
        estimate[tail + 3] = is_unusual(corrections, memory.whitened)
    else:
        estimate[tail + 3] = corrects_too_much(corrections, memory.corrected[0], memory.corrected[1])
