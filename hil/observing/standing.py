"""What gravity does to a machine at rest, from recordings in which it stood or swung about a pose: the quasi-static part of (5.37).

At rest a mode is bent by gravity's push on it and by the command that holds the axes. Link sides against motor sides and the
accelerometer's tilt against the encoders tell how far; its biases, the same in every pose, are told apart by the poses' difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.models.modal import ModalModel, basis_size, basis_values, chain_at_rest
from hil.errors import RecordingError
from hil.observing.over_poses import embedded, harmonics_for
from hil.recording import Recording

ENCODER_TRUST_rad = 2e-6
"""Weight of encoders' differences: some counts."""

TILT_TRUST_m_s2 = 2e-3
"""Weight of mean specific forces: what is left of noise and of vibration about the mean."""

EXPECTED_BIAS_m_s2 = 0.05
"""How far an accelerometer's bias may be from zero before it costs anything: ten times what better sensors promise."""


@dataclass(frozen=True)
class Standing:
    """Means of one recording about one pose: (n_axes,), (n_axes,), (n_axes,), (6 sensors,)."""

    motor: np.ndarray
    link: np.ndarray
    command: np.ndarray
    inertial: np.ndarray


def standing_mean(recording: Recording, model: ModalModel) -> Standing:
    """Means over whole periods of a periodic recording, else over all of it.

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
        return np.nanmean(values, axis=0)

    channels, n = model.channels(), len(model.axes)
    return Standing(
        mean(channels[:n]), mean(channels[n : 2 * n]), mean([f"command_{axis}" for axis in model.axes]), mean(channels[2 * n :])
    )


def with_gravity(model: ModalModel, standing: Sequence[Standing]) -> tuple[ModalModel, np.ndarray, np.ndarray]:
    """The model with gravity's pushes as functions of the pose; the inertial sensors' biases and their deviations (6 sensors,).

    Gravity may depend on more axes than the modes were measured over: the model's harmonics grow to what these poses can tell. Gyro biases
    are the mean rates; an accelerometer's bias is told from tilt where the poses differ enough, else it is taken for small.
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
    basis = np.zeros(width)
    harmonics = np.array(model.harmonics, dtype=np.int64)
    seen, pushes = [], []
    table = model.at(np.zeros(n))[: modes * model.mode_stride].reshape(modes, model.mode_stride)
    strength = np.abs(table[:, -n:]) @ model.effort_limit / table[:, 0]  # gravity bends a mode about as far as the drives could
    for each in standing:
        values = model.at(each.motor)
        table = values[: modes * model.mode_stride].reshape(modes, model.mode_stride)
        basis_values(harmonics, each.motor, basis)
        rest = chain_at_rest(model.chain, model.sensors, each.motor)
        seen.append(basis.copy())
        given = table[:, -n:] @ each.command / table[:, 0]  # what bends a mode beside gravity: η = (b u + d) / ω²
        first = modes * model.mode_stride
        pushes.append(-values[first : first + n * n].reshape(n, n) @ each.command)
        for k in range(n):
            row = np.zeros(unknowns)
            by_modes = table[:, 2 + n + k] - table[:, 2 + k]
            row[: modes * width] = np.outer(by_modes, basis).ravel()
            system.append(row / ENCODER_TRUST_rad)
            target.append((each.link[k] - each.motor[k] - by_modes @ given) / ENCODER_TRUST_rad)
        for s, sensor in enumerate(model.sensors):
            twist = table[:, 2 + 2 * n + 6 * s : 8 + 2 * n + 6 * s]
            tilt = np.cross(twist[:, 3:], rest.down) @ sensor.rotation  # (modes, 3)
            # the chain stands at q_r = motor side less what the modes bend there
            by_chain = -table[:, 2 : 2 + n] @ rest.position[6 * s : 6 * s + 3].T
            upright = -rest.down @ sensor.rotation
            for j in range(3):
                row = np.zeros(unknowns)
                by_modes = tilt[:, j] + by_chain[:, j]
                row[: modes * width] = np.outer(by_modes, basis).ravel()
                row[modes * width + 3 * s + j] = 1.0
                system.append(row / TILT_TRUST_m_s2)
                target.append((each.inertial[6 * s + j] - upright[j] - by_modes @ given) / TILT_TRUST_m_s2)
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
    coefficients[first : first + n] = np.linalg.lstsq(np.array(seen), np.array(pushes), rcond=1e-8)[0].T
    coefficients[first + n : first + n + modes] = solution[: modes * width].reshape(modes, width)
    biases, deviations = np.zeros(6 * sensors), np.zeros(6 * sensors)
    for s in range(sensors):
        forces, rates = slice(6 * s, 6 * s + 3), slice(6 * s + 3, 6 * s + 6)
        biases[forces], deviations[forces] = solution[modes * width + 3 * s :][:3], spread[3 * s : 3 * s + 3]
        found = np.array([each.inertial[rates] for each in standing])
        biases[rates], deviations[rates] = found.mean(axis=0), found.std(axis=0)
    return replace(model, coefficients=coefficients), biases, deviations
