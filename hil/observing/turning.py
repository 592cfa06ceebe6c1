"""Centrifugal and Coriolis torques of turning axes, from sweeps; Sec. 5.4.1 neglects them, and they bend a gear like gravity.

In a sweep the gears are bent by gravity, by the drives' effort beyond their friction, and in proportion to products of the axes' speeds.
The last part is what gravity and the drives do not explain of the axes' accelerations, of link against motor sides and of tilt. It acts
where disturbances act, in the gears and at the place that tilts the detector most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.signal import savgol_filter

from controllers.models.modal import ModalModel, basis_at, basis_size, chain_at_rest, chain_reading
from hil.errors import RecordingError
from hil.observing.gravity_at_rest import ENCODER_TRUST_rad, TILT_TRUST_m_s2
from hil.observing.over_poses import embedded
from hil.recording import Recording

SMOOTHED_s = 0.25
"""Over which parabolas are laid through the rows: two periods of a mode at 8 Hz."""

SAMPLES_Hz = 16.0
"""Of what is left after that."""

TURN_HARMONIC = 2
"""Of the pose, in what turning pushes: slopes of inertias, and centrifugal torques."""

BOTH_MOVE = 0.05
"""Share of the square of the largest speed that a product of two axes' speeds must reach to be fitted."""

SLOWEST_rad_s = 1e-3
"""Speed (or m/s) that nothing may stay below for a sweep."""

ACCELERATION_TRUST = 5e-3
"""rad/s^2: what friction beyond the viscous leaves of an axis's balance."""

EXPECTED_SHARE = 0.2
"""What turning may push at the sweeps' largest speed without a penalty, as a share of what the drives could."""

GRID = 4
"""Poses per axis and harmonic at which a product of two functions of the pose is written as one again."""


@dataclass(frozen=True)
class Moment:
    """One moment of a sweep.

    Attributes
    ----------
    pose, speed : (n_axes,)
    acceleration_left : (n_axes,) what neither drives nor gravity explain of the axes' accelerations.
    left : (n_axes + 3,) likewise of link against motor sides and of the first sensor's specific force.
    by_modes : (n_axes + 3, modes) what a mode's deflection makes of these.
    """

    pose: np.ndarray
    speed: np.ndarray
    acceleration_left: np.ndarray
    left: np.ndarray
    by_modes: np.ndarray


def with_turning(model: ModalModel, bias: np.ndarray, sweeps: Sequence[Recording], effort_gain: np.ndarray) -> ModalModel:
    """Return the model with the push of products of speeds.

    Parameters
    ----------
    model : ModalModel
        With gravity and directions.
    bias : (6 sensors,) array
        Of the inertial sensors.
    sweeps : sequence of Recording
        Of any axes, there and back, best over the whole range and with nothing that shakes. The product of two axes of which never both
        move stays without effect.
    effort_gain : (n_axes,) array
        Force or torque on the joint per unit of the drive.

    Raises
    ------
    RecordingError
        Nothing moves in them, or a channel is missing.
    """
    n, modes, directions = len(model.axes), model.modes, model.directions
    if directions is None:
        raise RecordingError("sweeps tell what turning pushes at the places where disturbances act; the model has none")
    moments = [moment for sweep in sweeps for moment in moments_of(sweep, model, bias)]
    fastest = max(float(np.abs(moment.speed).max()) for moment in moments)
    if fastest < SLOWEST_rad_s:
        raise RecordingError("no axis moves in the sweeps: what turning pushes is not in them")
    pairs = [(j, k) for j in range(n) for k in range(j, n)]
    products = np.array([[moment.speed[j] * moment.speed[k] for j, k in pairs] for moment in moments])
    poses = np.array([moment.pose for moment in moments])
    order = tuple(min(known, TURN_HARMONIC) for known in model.harmonics)
    moves = np.abs(products).max(axis=0) > BOTH_MOVE * fastest**2
    told = [np.repeat(moves[:, None], basis_size(order), axis=1)] * n + [moves[:, None] & _turned(pairs, order)]
    strength = EXPECTED_SHARE / fastest**2 * model.effort_limit * effort_gain
    rigid = model.at(np.zeros(n))[modes * model.mode_stride :][: n * n].reshape(n, n)

    factors = _factors(products, order, poses) * told[0].ravel()
    found = []
    left = np.array([moment.acceleration_left for moment in moments])
    for axis in range(n):
        expected = np.full(factors.shape[1], strength[axis] * abs(rigid[axis, axis]) / effort_gain[axis])
        found.append(_told(factors / ACCELERATION_TRUST, left[:, axis] / ACCELERATION_TRUST, expected))
    of_axes = embedded(np.array(found).reshape(-1, basis_size(order)), order, model.harmonics).reshape(n, len(pairs), -1)

    places = [*range(n, 2 * n), _tilting(model, directions, poses)]
    pushed = np.einsum("cdb,mb->mcd", directions[n:], basis_at(model.harmonics, poses))  # bends of modes per unit at a place
    trust = np.concatenate((np.full(n, ENCODER_TRUST_rad), np.full(3, TILT_TRUST_m_s2)))
    by_modes = np.array([moment.by_modes for moment in moments]) / trust[:, None]
    columns, expectations = [], []
    for place, kept in zip(places, told, strict=True):
        by_place = np.einsum("mrc,mc->mr", by_modes, pushed[:, :, place])
        columns.append(by_place[:, :, None] * (_factors(products, order, poses) * kept.ravel())[:, None, :])
        expectations.append(np.full(columns[-1].shape[2], strength[place - n] if place < 2 * n else strength.max()))
    system = np.concatenate(columns, axis=2).reshape(len(moments) * len(trust), -1)
    target = np.array([moment.left for moment in moments]) / trust
    torques = np.split(_told(system, target.ravel(), np.concatenate(expectations)), np.cumsum([len(part) for part in expectations])[:-1])

    grid = _grid(model, poses)
    at_grid = np.einsum("cdb,gb->gcd", directions[n:], basis_at(model.harmonics, grid))
    of_modes = np.zeros((len(grid), modes, len(pairs)))
    for place, torque in zip(places, torques, strict=True):
        by_pair = basis_at(order, grid) @ torque.reshape(len(pairs), -1).T
        of_modes += at_grid[:, :, place, None] * by_pair[:, None, :]
    written = np.linalg.lstsq(basis_at(model.harmonics, grid), of_modes.reshape(len(grid), -1), rcond=1e-8)[0].T
    turning = np.concatenate((of_axes, written.reshape(modes, len(pairs), -1)))
    return replace(model, turning=np.ascontiguousarray(turning))


def _tilting(model: ModalModel, directions: np.ndarray, poses: np.ndarray) -> int:
    """Return the place behind the gears that tilts the first sensor's body most."""
    n, modes, middle = len(model.axes), model.modes, np.median(poses, axis=0)
    turns = model.at(middle)[: modes * model.mode_stride].reshape(modes, model.mode_stride)[:, 5 + 2 * n : 8 + 2 * n]
    bends = directions[n:, 2 * n :] @ basis_at(model.harmonics, middle[None])[0]
    return 2 * n + int(np.argmax(np.linalg.norm(turns.T @ bends, axis=0)))


def moments_of(sweep: Recording, model: ModalModel, bias: np.ndarray) -> list[Moment]:
    """Return the moments of a recording, smoothed."""
    n, modes, sensor = len(model.axes), model.modes, model.sensors[0]
    window, every = 2 * round(0.5 * SMOOTHED_s * model.sample_rate_Hz) + 1, max(1, round(model.sample_rate_Hz / SAMPLES_Hz))
    names = [*model.channels()[: 2 * n + 3], *(f"command_{axis}" for axis in model.axes)]
    rows = sweep.matrix(names)
    if len(rows) < 2 * window:
        raise RecordingError(f"a sweep of {len(rows)} rows is too short: {2 * window} at least")
    holes = np.isnan(rows).any(axis=0)
    if holes.any():
        raise RecordingError(f"{names[int(holes.argmax())]} has holes: a sweep needs every row")
    rows[2:, -n:] = 0.5 * (rows[1:-1, -n:] + rows[:-2, -n:])  # command k acts from row k+1 to k+2
    steady, slope, bend = (savgol_filter(rows, window, 2, deriv, 1.0 / model.sample_rate_Hz, axis=0) for deriv in range(3))
    found = []
    for k in range(window, len(rows) - window, every):
        pose, speed, acceleration = steady[k, :n], slope[k, :n], bend[k, :n]
        values = model.at(pose)
        table = values[: modes * model.mode_stride].reshape(modes, model.mode_stride)
        rest = values[modes * model.mode_stride :]
        driving = steady[k, -n:] - rest[n * n : n * n + n] * speed
        push = rest[n * (n + 1) :][: n + modes]
        deflection = (table[:, -n:] @ driving + push[n:]) / table[:, 0]
        acceleration_left = acceleration - rest[: n * n].reshape(n, n) @ driving - push[:n]
        lag = sensor.lag_s
        felt = chain_reading(model.chain, sensor, np.concatenate((pose - lag * speed, speed - lag * acceleration, acceleration)))[:3]
        by_pose = chain_at_rest(model.chain, (sensor,), pose).position[:3]
        tilt = np.cross(sensor.rotation @ felt, table[:, 5 + 2 * n : 8 + 2 * n]) @ sensor.rotation
        # the chain stands at the motor side less what modes bend there
        by_modes = np.vstack(((table[:, 2 + n : 2 + 2 * n] - table[:, 2 : 2 + n]).T, tilt.T - by_pose @ table[:, 2 : 2 + n].T))
        seen = np.concatenate((steady[k, n : 2 * n] - pose, steady[k, 2 * n : 2 * n + 3] - bias[:3] - felt))
        found.append(Moment(pose, speed, acceleration_left, seen - by_modes @ deflection, by_modes))
    return found


def _factors(products: np.ndarray, harmonics: tuple[int, ...], poses: np.ndarray) -> np.ndarray:
    """Return products of speeds times functions of the pose: (moments, pairs x basis)."""
    rows: np.ndarray = (products[:, :, None] * basis_at(harmonics, poses)[:, None, :]).reshape(len(poses), -1)
    return rows


def _turned(pairs: list[tuple[int, int]], harmonics: tuple[int, ...]) -> np.ndarray:
    """Return which functions of the pose a torque on the detector may have: (pairs, basis).

    It is fixed except that the directions of its two axes turn with every position behind them.
    """
    sizes = [2 * order + 1 for order in harmonics]
    of_function = (np.array(np.unravel_index(np.arange(basis_size(harmonics)), sizes)).T + 1) // 2
    allowed = np.array([[int(j < axis) + int(k < axis) for axis in range(len(harmonics))] for j, k in pairs])
    return np.array((of_function[None] <= allowed[:, None]).all(axis=2))


def _grid(model: ModalModel, poses: np.ndarray) -> np.ndarray:
    """Return poses (grid, n_axes) over the range that was swept."""
    ends = zip(poses.min(axis=0), poses.max(axis=0), model.harmonics, strict=True)
    return np.array(list(product(*(np.linspace(low, high, GRID * order + 1) for low, high, order in ends))))


def _told(system: np.ndarray, target: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Solve by least squares with the expected size of the unknowns as a prior."""
    scaled = system * expected
    return expected * np.linalg.solve(scaled.T @ scaled + np.eye(len(expected)), scaled.T @ target)
