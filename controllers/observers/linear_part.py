"""The linear part of the modal model as tables: next state and signals, a row for each state and each input.

The tables are made once per sample, at the pose of the last estimate, so that sigma points and deviations cost sums along memory and no
equations.
"""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_compiled, exactly_inlined
from controllers.models.modal import basis_values, schedule
from controllers.models.vectors import cross, plus
from controllers.observers.modal_equations import (
    MODE_SIGNALS,
    SENSOR_SIGNALS,
    Constants,
    Scheduled,
    adapted_signals,
    adapted_step,
    first_offset,
    look,
    mode_step,
    moving,
)

TURN_STEP_s = 1e-4
"""Half a difference of shapes that turn: below a radian per second its error is 1e-8 of them."""


@exactly_compiled
def prepare(constants: Constants, x: np.ndarray, scheduled: Scheduled) -> None:
    """Schedule the model at a state's pose, and the forces of turning axes at its speeds.

    Kept on disk by itself, since a filter and a linearisation both need it.
    """
    _parameters(constants, x, scheduled)
    _forces(constants, scheduled)
    _sees(constants, scheduled)
    _steps(constants, scheduled)


@exactly_inlined
def _parameters(constants: Constants, x: np.ndarray, scheduled: Scheduled) -> None:
    sizes, modes_at, encoders, rigid, looks = constants.sizes, scheduled.modes, scheduled.encoders, scheduled.rigid, scheduled.looks
    n, modes, sensors, at = sizes[0], sizes[1], sizes[2], constants.sensors
    values, pushes = scheduled.values, scheduled.pushes
    schedule(sizes, constants.harmonics, constants.coefficients, x, values)
    stride = 2 + 3 * n + 6 * sensors
    _turning_shapes(constants, x, scheduled)
    for i in range(modes):
        first = i * stride
        stiffness, damping = values[first], values[first + 1]
        modes_at[i, 0], modes_at[i, 1] = stiffness, damping
        step = mode_step(stiffness, damping, constants.period_s)
        for j in range(6):
            modes_at[i, 2 + j] = step[j]
        for k in range(2 * n):
            encoders[i, k] = values[first + 2 + k]
        for k in range(n):
            encoders[i, 2 * n + k] = values[first + stride - n + k]
        for s in range(sensors):
            place = first + 2 + 2 * n + 6 * s
            turn = values[place + 3], values[place + 4], values[place + 5]
            arm = at[s, 3] - at[s, 0], at[s, 4] - at[s, 1], at[s, 5] - at[s, 2]
            shift = plus((values[place], values[place + 1], values[place + 2]), cross(turn, arm))
            rows = look(stiffness, damping, at[s, 15])
            for j in range(3):
                scheduled.shapes[s, i, j], scheduled.shapes[s, i, 3 + j] = shift[j], turn[j]
                for part in range(3):  # deflection, speed, force
                    looks[s, 3 * i + part, j], looks[s, 3 * i + part, 3 + j] = shift[j] * rows[6 + part], shift[j] * rows[3 + part]
                    looks[s, 3 * i + part, 6 + j] = turn[j] * rows[part]
                    looks[s, 3 * i + part, 9 + j] = turn[j] * rows[3 + part] + scheduled.rates[place + 3 + j] * rows[part]
    for mode in constants.adapted:
        looks[:, 3 * mode : 3 * mode + 3] = 0.0
    first = modes * stride
    for i in range(n):
        scheduled.speeds[i] = x[n + i]
        for k in range(n):
            rigid[i, k] = values[first + i * n + k]
        rigid[i, n] = values[first + n * n + i]
    first += n * (n + 1)
    for i in range(n + modes):
        pushes[i] = values[first + i]
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
                    pushes[i] += stiffness * values[row] * x[n + j] * x[n + k]
                    row += 1


@exactly_inlined
def _turning_shapes(constants: Constants, x: np.ndarray, scheduled: Scheduled) -> None:
    """Fill `rates`: what stands before an axis turns in the detector's frame as that axis does, and a bend of it with its shape.

    A gyro sees that as a rate. Of accelerometers it is left out together with the bend's centrifugal part: of a bend that rests in the
    world they cancel.
    """
    n, count, rows = constants.sizes[0], constants.coefficients.shape[0], len(scheduled.rates)
    later, sooner, pose, rates = np.zeros(count), np.zeros(count), np.empty(n), scheduled.rates
    for k in range(n):
        pose[k] = x[k] + TURN_STEP_s * x[n + k]
    basis_values(constants.harmonics, pose, later)
    for k in range(n):
        pose[k] = x[k] - TURN_STEP_s * x[n + k]
    basis_values(constants.harmonics, pose, sooner)
    rates[:] = 0.0
    for b in range(count):
        slope = (later[b] - sooner[b]) / (2.0 * TURN_STEP_s)
        for row in range(rows):
            rates[row] += slope * constants.coefficients[b, row]


@exactly_inlined
def _forces(constants: Constants, scheduled: Scheduled) -> None:
    """Fill `forces`: accelerations of axes and modes by inputs, disturbances, the drives' friction and gyroscopic coupling."""
    n, modes, disturbances, first_input = constants.sizes[0], constants.sizes[1], constants.sizes[7], moving(constants)
    encoders, rigid, rubbing, forces = scheduled.encoders, scheduled.rigid, scheduled.rubbing, scheduled.forces
    size = n + modes
    forces[:] = 0.0
    for k in range(n):
        for i in range(size):
            forces[first_input + k, i] = rigid[i, k] if i < n else encoders[i - n, 2 * n + k]
    rubbing[:] = 0.0
    _couple(constants, scheduled)
    for k in range(n):  # the motor side moves with its axis and with the modes; its friction acts where the command does
        for j in range(size):
            speed = (1.0 if j == k else 0.0) if j < n else encoders[j - n, k]
            for i in range(size):
                rubbing[j, i] -= rigid[k, n] * speed * forces[first_input + k, i]
    for i in range(size):
        forces[first_input + n, i] = scheduled.pushes[i]
        for j in range(n):
            forces[n + j, i] = rubbing[j, i]
        for j in range(modes):
            forces[2 * n + modes + j, i] = rubbing[n + j, i]
        for j in range(disturbances):
            forces[2 * size + j, i] = scheduled.directions[i, j]


@exactly_inlined
def _couple(constants: Constants, scheduled: Scheduled) -> None:
    """Add the gyroscopic coupling: forces on the axes by the modes' speeds while the axes turn."""
    n, modes, sensors, disturbances = constants.sizes[0], constants.sizes[1], constants.sizes[2], constants.sizes[7]
    size, values = n + modes, scheduled.values
    row = modes * (2 + 3 * n + 6 * sensors) + n * (n + 1) + size + 6 + size * disturbances + size * n * (n + 1) // 2
    if row >= len(values):
        return
    for axis in range(n):
        for i in range(n):
            for k in range(modes):
                scheduled.rubbing[n + k, i] += scheduled.speeds[axis] * values[row]
                row += 1


@exactly_inlined
def _sees(constants: Constants, scheduled: Scheduled) -> None:
    """Fill `sees`, the table of signals.

    Signals are motor sides, link sides, per sensor the axes' motion (3 axes) `lag` ago and `SENSOR_SIGNALS`, then the adapted modes.
    """
    n, modes, sensors = constants.sizes[0], constants.sizes[1], constants.sizes[2]
    encoders, forces, looks, sees = scheduled.encoders, scheduled.forces, scheduled.looks, scheduled.sees
    sees[:] = 0.0
    for i in range(n):
        sees[i, i] = sees[i, n + i] = 1.0
        for j in range(modes):
            sees[2 * n + j, i], sees[2 * n + j, n + i] = encoders[j, i], encoders[j, n + i]
    for s in range(sensors):
        lag, place = constants.sensors[s, 15], 2 * n + s * (3 * n + SENSOR_SIGNALS)
        by_modes = place + 3 * n
        for row in range(sees.shape[0]):
            for i in range(n):
                a = forces[row, i]
                sees[row, place + i], sees[row, place + n + i], sees[row, place + 2 * n + i] = 0.5 * lag * lag * a, -lag * a, a
            for i in range(modes):
                force = forces[row, n + i]
                for j in range(SENSOR_SIGNALS):
                    sees[row, by_modes + j] += force * looks[s, 3 * i + 2, j]
        for i in range(n):
            sees[i, place + i] += 1.0
            sees[n + i, place + i] -= lag
            sees[n + i, place + n + i] += 1.0
        for i in range(modes):
            for j in range(SENSOR_SIGNALS):
                sees[2 * n + i, by_modes + j] += looks[s, 3 * i, j]
                sees[2 * n + modes + i, by_modes + j] += looks[s, 3 * i + 1, j]
    for k in range(constants.sizes[3]):
        place, mode = adapted_signals(constants) + MODE_SIGNALS * k, constants.adapted[k]
        sees[2 * n + mode, place] = 1.0
        sees[2 * n + modes + mode, place + 1] = 1.0
        for row in range(sees.shape[0]):
            sees[row, place + 2] = forces[row, n + mode]


@exactly_inlined
def _steps(constants: Constants, scheduled: Scheduled) -> None:
    """Fill `steps`, the table of the transition by one sample, and adjust `forces` to it.

    Friction is taken half a sample ahead, because its speed changes while the other forces hold. A disturbance in the state is the one
    that acted until this sample: it decays first, then acts over the sample, and the sensors see it so.
    """
    n, modes, disturbances, period = constants.sizes[0], constants.sizes[1], constants.sizes[7], constants.period_s
    at, rubbing, forces, steps, colour = scheduled.modes, scheduled.rubbing, scheduled.forces, scheduled.steps, constants.colour
    size, half = n + modes, 0.5 * period
    first = 2 * size
    for j in range(disturbances):
        beside = constants.quadrature[j]
        for i in range(size):
            if beside >= 0:
                forces[beside, i] = colour[j, 1] * forces[first + j, i]
            forces[first + j, i] *= colour[j, 0]
    steps[:] = 0.0
    line = steps[0]
    for row in range(steps.shape[0]):
        force = forces[row]
        for j in range(size):
            line[j] = force[j]
        if 2 * n <= row < 2 * n + modes:
            line[row - n] -= at[row - 2 * n, 0]
        elif 2 * n + modes <= row < first:
            line[row - n - modes] -= at[row - 2 * n - modes, 1]
        for j in range(size):
            gained = half * line[j]
            for i in range(size):
                force[i] += gained * rubbing[j, i]
    for row in range(steps.shape[0]):
        for i in range(n):
            steps[row, i], steps[row, n + i] = half * period * forces[row, i], period * forces[row, i]
        for i in range(modes):
            force = forces[row, n + i]
            steps[row, 2 * n + i], steps[row, 2 * n + modes + i] = at[i, 6] * force, at[i, 7] * force
    for i in range(n):
        steps[i, i] += 1.0
        steps[n + i, i] += period
        steps[n + i, n + i] += 1.0
    for i in range(modes):
        position, speed = 2 * n + i, 2 * n + modes + i
        steps[position, position] += at[i, 2]
        steps[speed, position] += at[i, 3]
        steps[position, speed] += at[i, 4]
        steps[speed, speed] += at[i, 5]
    for j in range(disturbances):
        steps[first + j, first + j] = colour[j, 0]
        beside = constants.quadrature[j]
        if beside >= 0:
            steps[beside, first + j] = colour[j, 1]
            steps[first + j, beside] = colour[j, 2]
            steps[beside, beside] = colour[j, 3]
    for k in range(constants.sizes[3]):
        mode, place = constants.adapted[k], moving(constants) + MODE_SIGNALS * k
        steps[2 * n + mode, place] = 1.0
        steps[2 * n + modes + mode, place + 1] = 1.0
        for row in range(steps.shape[0]):
            steps[row, place + 2] = forces[row, n + mode]


@exactly_inlined
def carried(constants: Constants, table: np.ndarray, x: np.ndarray, first: int, out: np.ndarray) -> None:
    """Apply a table to the moving states of a deviation x whose first `first` states are zero; `out` is as wide as the table."""
    for j in range(table.shape[1]):
        out[j] = 0.0
    for k in range(first, moving(constants)):
        value = x[k]
        for j in range(table.shape[1]):
            out[j] += value * table[k, j]


@exactly_inlined
def acted(constants: Constants, table: np.ndarray, command: np.ndarray, out: np.ndarray) -> None:
    """Add the contributions of commands (axes,) and of the forces of gravity and turning to `out`."""
    first = moving(constants)
    for k in range(constants.sizes[0]):
        for j in range(table.shape[1]):
            out[j] += command[k] * table[first + k, j]
    for j in range(table.shape[1]):
        out[j] += table[first + constants.sizes[0], j]


@exactly_inlined
def others_stepped(constants: Constants, x: np.ndarray, out: np.ndarray) -> None:
    """Add the log frequency ratios, which are no moving states, where `steps` leaves room for them."""
    for k in range(constants.sizes[3]):
        out[moving(constants) + MODE_SIGNALS * k + 3] += x[moving(constants) + k]


@exactly_inlined
def heading(constants: Constants, scheduled: Scheduled, x: np.ndarray, command: np.ndarray, out: np.ndarray) -> None:
    """Apply `steps` to a state x while a command (axes,) acts."""
    carried(constants, scheduled.steps, x, 0, out)
    acted(constants, scheduled.steps, command, out)
    others_stepped(constants, x, out)


@exactly_inlined
def arrived(constants: Constants, scheduled: Scheduled, line: np.ndarray, out: np.ndarray) -> None:
    """Write the moving states one sample later, from the line that `heading` made."""
    n, modes, first = constants.sizes[0], constants.sizes[1], moving(constants)
    for k in range(first):
        out[k] = line[k]
    for k in range(constants.sizes[3]):
        mode, place = constants.adapted[k], first + MODE_SIGNALS * k
        out[2 * n + mode], out[2 * n + modes + mode] = adapted_step(constants, scheduled, mode, line[place : place + MODE_SIGNALS])


@exactly_inlined
def stays(constants: Constants, x: np.ndarray, out: np.ndarray) -> None:
    """Write those states one sample later that move no other state."""
    first = moving(constants)
    for k in range(first, constants.sizes[4]):
        out[k] = constants.kept[k - first] * x[k]


@exactly_inlined
def transition(constants: Constants, scheduled: Scheduled, x: np.ndarray, command: np.ndarray, out: np.ndarray) -> None:
    """Write the state (states,) one sample after x while a command (axes,) acts."""
    line = np.empty(scheduled.steps.shape[1])
    heading(constants, scheduled, x, command, line)
    arrived(constants, scheduled, line, out)
    stays(constants, x, out)


@exactly_inlined
def others_seen(constants: Constants, x: np.ndarray, out: np.ndarray) -> None:
    """Add the part of the signals that comes from states that move no other: encoders' offsets, log frequency ratios."""
    if constants.sizes[9] > 0:
        offsets = first_offset(constants)
        for i in range(constants.sizes[0]):
            out[i] += x[offsets + i]
            if constants.sizes[9] > constants.sizes[0] + 6:
                out[constants.sizes[0] + i] += x[offsets + constants.sizes[0] + 6 + i]
    for k in range(constants.sizes[3]):
        out[adapted_signals(constants) + MODE_SIGNALS * k + 3] += x[moving(constants) + k]


@exactly_inlined
def signals(constants: Constants, scheduled: Scheduled, x: np.ndarray, command: np.ndarray, out: np.ndarray) -> None:
    """Write the signals (signals,) of a state while a command (axes,) acts."""
    carried(constants, scheduled.sees, x, 0, out)
    acted(constants, scheduled.sees, command, out)
    others_seen(constants, x, out)


@exactly_inlined
def alone(constants: Constants, scheduled: Scheduled, x: np.ndarray, k: int, out: np.ndarray) -> None:
    """Write the signals (signals,) of a deviation x of which only state k is not zero."""
    moves, width = k < moving(constants), scheduled.sees.shape[1]
    for j in range(width):
        out[j] = x[k] * scheduled.sees[k, j] if moves else 0.0
    others_seen(constants, x, out)
