"""Effect of gravity on a machine at rest, from recordings in which it stood or swung about a pose: the quasi-static part of (5.37).

At rest a mode is bent by gravity's push on it and by the command that holds the axes. Link sides against motor sides and the
accelerometer's tilt against the encoders show how far; its biases, the same in every pose, are separated by the difference between poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from controllers.models.modal import ModalModel, basis_at, basis_size, chain_at_rest
from hil.errors import RecordingError
from hil.observing.over_poses import embedded, harmonics_for
from hil.recording import Recording

ENCODER_TRUST_rad = 2e-6
"""Weight of encoders' differences: some counts."""

TILT_TRUST_m_s2 = 2e-3
"""Weight of mean specific forces: the remaining noise and vibration about the mean."""

GRAVITY_HARMONIC = 1
"""Of the pose, in gravity's torque about an axis: a lever that turns with the axes, times a weight."""

MEAN_TRUST_m_s2 = 5e-4
"""Weight of mean specific forces where unknowns are few: three times a 4 s mean's noise."""

BESIDE_SHARE = 0.01
"""Of what the drives could bend a mode: how far gravity may bend it beside its torques at the places."""

GRID = 4
"""Poses per axis and harmonic at which a product of two functions of the pose is written as one again."""

EXPECTED_BIAS_m_s2 = 0.05
"""How far an accelerometer's bias may be from zero without a penalty: ten times the specification of better sensors."""


@dataclass(frozen=True)
class Standing:
    """Means of one recording about one pose: (n_axes,), (n_axes,), (n_axes,), (6 sensors,)."""

    motor: np.ndarray
    link: np.ndarray
    command: np.ndarray
    inertial: np.ndarray


def standing_mean(recording: Recording, model: ModalModel) -> Standing:
    """Return means over whole periods of a periodic recording, else over all of it.

    Raises
    ------
    RecordingError
        The recording lacks a channel.
    """
    rows = slice(None)
    if recording.experiment.get("period_samples"):
        slices = recording.period_slices
        rows = slice(slices[0].start, slices[-1].stop)

    def mean(names: Sequence[str]) -> np.ndarray:
        values = recording.matrix(names)[rows]
        if np.isnan(values).all(axis=0).any():
            raise RecordingError(f"{names[int(np.isnan(values).all(axis=0).argmax())]} has no sample at all")
        averaged: np.ndarray = np.nanmean(values, axis=0)
        return averaged

    channels, n = model.channels(), len(model.axes)
    return Standing(
        mean(channels[:n]), mean(channels[n : 2 * n]), mean([f"command_{axis}" for axis in model.axes]), mean(channels[2 * n :])
    )


def with_gravity(model: ModalModel, standing: Sequence[Standing]) -> tuple[ModalModel, np.ndarray, np.ndarray]:
    """Return the model with gravity's pushes as functions of the pose; the inertial sensors' biases and their deviations.

    Biases and deviations are (6 sensors,). Gravity may depend on more axes than the modes were measured over: the model's harmonics grow to
    what these poses can determine. Gyro biases are the mean rates; an accelerometer's bias follows from tilt where the poses differ enough,
    else it is assumed small.
    """
    n, modes, sensors = len(model.axes), model.modes, len(model.sensors)
    told = harmonics_for(np.array([each.motor for each in standing]))
    grown = tuple(max(pair) for pair in zip(model.harmonics, told, strict=True))
    width = basis_size(grown)
    directions = model.directions
    if directions is not None:
        directions = embedded(directions.reshape(-1, directions.shape[2]), model.harmonics, grown).reshape(*directions.shape[:2], width)
    coefficients = embedded(model.coefficients, model.harmonics, grown)
    model = replace(model, harmonics=grown, coefficients=coefficients, directions=directions)
    unknowns = modes * width + 3 * sensors
    system, target = [], []
    basis = basis_at(model.harmonics, [each.motor for each in standing])
    pushes = []
    strength = _strength(model)
    for each, functions in zip(standing, basis, strict=True):
        first = modes * model.mode_stride
        pushes.append(-model.at(each.motor)[first : first + n * n].reshape(n, n) @ each.command)
        by_modes, left = _beside_the_drives(model, each)
        for k, (by_mode, value) in enumerate(zip(by_modes, left, strict=True)):
            row = np.zeros(unknowns)
            row[: modes * width] = np.outer(by_mode, functions).ravel()
            if k >= n:
                row[modes * width + k - n] = 1.0
            trust = TILT_TRUST_m_s2 if k >= n else ENCODER_TRUST_rad
            system.append(row / trust)
            target.append(value / trust)
    for i in range(modes):
        for k in range(width):
            row = np.zeros(unknowns)
            row[i * width + k] = 1.0 / strength[i]
            system.append(row)
            target.append(0.0)
    for b in range(3 * sensors):
        row = np.zeros(unknowns)
        row[modes * width + b] = 1.0 / EXPECTED_BIAS_m_s2
        system.append(row)
        target.append(0.0)
    table = np.array(system)
    solution = np.linalg.lstsq(table, np.array(target), rcond=1e-12)[0]
    spread = np.sqrt(np.diag(np.linalg.inv(table.T @ table)))[modes * width :]
    coefficients = model.coefficients.copy()
    first = modes * model.mode_stride + n * (n + 1)
    coefficients[first : first + n] = np.linalg.lstsq(basis, np.array(pushes), rcond=1e-8)[0].T
    coefficients[first + n : first + n + modes] = solution[: modes * width].reshape(modes, width)
    return (replace(model, coefficients=coefficients), *_biases(standing, solution[modes * width :], spread))


def with_gravity_at_places(
    model: ModalModel, standing: Sequence[Standing], effort_gain: np.ndarray
) -> tuple[ModalModel, np.ndarray, np.ndarray]:
    """Return the model with gravity's pushes on the modes as torques at real places; biases and deviations as `with_gravity`.

    Gravity's torque about an axis is a polynomial of first order in every position, whatever the modes' shapes do, so all poses together
    determine these few unknowns. At the drives and about the mount's axis the torque is what the drives hold and already known; it is
    fitted in the gears and between link side and detector. Beside that each mode may bend a little freely, to allow for errors of its
    shape.

    Parameters
    ----------
    model : ModalModel
        With gravity's push on the axes, and places (`structure.with_places`).
    standing : sequence of Standing
    effort_gain : (n_axes,) array
        Force or torque on the joint per unit of the drive.
    """
    n, modes, sensors = len(model.axes), model.modes, len(model.sensors)
    poses = np.array([each.motor for each in standing])
    known, by_unknowns, torques = _bends(model, poses, effort_gain)
    system, target = [], []
    trust = np.repeat([ENCODER_TRUST_rad, MEAN_TRUST_m_s2], [n, 3 * sensors])
    for each, base, by_unknown in zip(standing, known, by_unknowns, strict=True):
        by_modes, left = _beside_the_drives(model, each)
        rows = np.hstack((by_modes @ by_unknown, np.vstack((np.zeros((n, 3 * sensors)), np.eye(3 * sensors)))))
        system.append(rows / trust[:, None])
        target.append((left - by_modes @ base) / trust)
    strength = np.repeat(BESIDE_SHARE * _strength(model), basis_size(model.harmonics))
    largest = float(np.max(model.effort_limit * effort_gain))
    expected = np.concatenate((np.full(torques, largest), strength, np.full(3 * sensors, EXPECTED_BIAS_m_s2)))
    table = np.vstack((*system, np.diag(1.0 / expected)))
    solution = np.linalg.lstsq(table, np.concatenate((*target, np.zeros(len(expected)))), rcond=1e-13)[0]
    spread = np.sqrt(np.diag(np.linalg.inv((table * expected).T @ (table * expected)))) * expected
    ends = zip(poses.min(axis=0), poses.max(axis=0), model.harmonics, strict=True)
    grid = np.array(list(product(*(np.linspace(low, high, GRID * order + 1) for low, high, order in ends))))
    known, by_unknowns, _ = _bends(model, grid, effort_gain)
    pushed = known + by_unknowns @ solution[: -3 * sensors]
    coefficients = model.coefficients.copy()
    first = modes * model.mode_stride + n * (n + 1) + n
    coefficients[first : first + modes] = np.linalg.lstsq(basis_at(model.harmonics, grid), pushed, rcond=1e-8)[0].T
    biases, deviations = _biases(standing, solution[-3 * sensors :], spread[-3 * sensors :])
    return replace(model, coefficients=coefficients), biases, deviations


def _bends(model: ModalModel, poses: np.ndarray, effort_gain: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Return how the modes are bent at poses: by what the drives hold, by each unknown, and how many unknowns are torques.

    Shapes (P, modes) and (P, modes, unknowns).
    """
    n, modes, directions = len(model.axes), model.modes, model.directions
    assert directions is not None, "places have directions"
    asked = [j for j, place in enumerate(model.places) if place in ("gear", "turn")]
    about_first = model.places.index("mount")
    basis = basis_at(model.harmonics, poses)
    by_place = np.einsum("cdb,pb->pcd", directions[n:], basis)
    given = []
    for pose in poses:
        rest = model.at(pose)[modes * model.mode_stride :]
        given.append(np.linalg.solve(rest[: n * n].reshape(n, n), rest[n * (n + 1) :][:n]))
    held = np.array(given)
    known = np.einsum("pcd,pd->pc", by_place[:, :, :n], held) + by_place[:, :, about_first] * held[:, :1] * effort_gain[0]
    of_torques = basis_at(tuple(min(order, GRAVITY_HARMONIC) for order in model.harmonics), poses)
    by_torques = (by_place[:, :, asked][..., None] * of_torques[:, None, None, :]).reshape(len(poses), modes, -1)
    beside = np.einsum("mk,pb->pmkb", np.eye(modes), basis).reshape(len(poses), modes, -1)
    return known, np.concatenate((by_torques, beside), axis=2), by_torques.shape[2]


def _strength(model: ModalModel) -> np.ndarray:
    """Return how far the drives could bend modes (modes,) at pose zero: gravity bends them about as far."""
    n, modes = len(model.axes), model.modes
    table = model.at(np.zeros(n))[: modes * model.mode_stride].reshape(modes, model.mode_stride)
    bound: np.ndarray = np.abs(table[:, -n:]) @ model.effort_limit / table[:, 0]
    return bound


def _beside_the_drives(model: ModalModel, each: Standing) -> tuple[np.ndarray, np.ndarray]:
    """Return the effect of a bend of each mode on the measurements, and what is measured beside the effect of the drives.

    The measurements are link against motor sides, then the sensors' specific forces (n_axes + 3 sensors).
    """
    n, modes = len(model.axes), model.modes
    table = model.at(each.motor)[: modes * model.mode_stride].reshape(modes, model.mode_stride)
    rest = chain_at_rest(model.chain, model.sensors, each.motor)
    given = table[:, -n:] @ each.command / table[:, 0]  # what bends a mode beside gravity: η = (b u + d) / ω²
    by_modes, seen = [(table[:, 2 + n : 2 + 2 * n] - table[:, 2 : 2 + n]).T], [each.link - each.motor]
    for s, sensor in enumerate(model.sensors):
        twist = table[:, 2 + 2 * n + 6 * s : 8 + 2 * n + 6 * s]
        tilt = np.cross(twist[:, 3:], rest.down) @ sensor.rotation  # (modes, 3)
        # the chain stands at q_r = motor side less what the modes bend there
        by_chain = -table[:, 2 : 2 + n] @ rest.position[6 * s : 6 * s + 3].T
        by_modes.append((tilt + by_chain).T)
        seen.append(each.inertial[6 * s : 6 * s + 3] + rest.down @ sensor.rotation)
    rows = np.vstack(by_modes)
    return rows, np.concatenate(seen) - rows @ given


def _biases(standing: Sequence[Standing], forces: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return biases of the inertial sensors and their deviations (6 sensors,), given those of the forces (3 sensors,).

    The biases of the rates are their means.
    """
    sensors = len(forces) // 3
    biases, deviations = np.zeros(6 * sensors), np.zeros(6 * sensors)
    for s in range(sensors):
        place, rates = slice(6 * s, 6 * s + 3), slice(6 * s + 3, 6 * s + 6)
        biases[place], deviations[place] = forces[3 * s : 3 * s + 3], spread[3 * s : 3 * s + 3]
        found = np.array([each.inertial[rates] for each in standing])
        biases[rates], deviations[rates] = found.mean(axis=0), found.std(axis=0)
    return biases, deviations
