"""The mode above the excited band, derived from the springs and the modes below.

Gears, turns and the mount move in as many ways as they have springs. Where all modes but one are identified, the last one is orthogonal to
them in the springs, φ_iᵀ K φ = 0, and stores φᵀ K φ. So its shape, and how far a slow push bends it, are known though no line excited it.
Without it the model's detector motion under a push in a gear or at the mount is wrong by that much. Its frequency is known only to lie
above the lines; within a sample's time its exact value hardly matters.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from controllers.models.modal import ModalModel, chain_at_rest
from hil.observing.modal_fit import TURN_LENGTH_m
from hil.observing.sag import detector_places, first_axis_frame
from hil.observing.structure import Structure, relative_motion, spread_over_poses

DAMPING_RATIO = 0.01
"""Of a welded structure; it is not measured."""


def with_last_mode(model: ModalModel, structure: Structure, highest_line_Hz: float) -> tuple[ModalModel, str]:
    """Return the model with a mode that completes the springs, and a line for the design.

    It is the same model and no line where the number of missing modes is not one. Where another body than the detector has an inertial
    sensor, it is the same model and a line that says so.

    Parameters
    ----------
    model : ModalModel
        Complete but for that mode.
    structure : Structure
    highest_line_Hz : float
        Of the responses: the mode is put in the geometric middle between it and half the sample rate.
    """
    n, modes, poses = len(model.axes), model.modes, structure.poses
    frame = first_axis_frame(model.chain)
    if modes != len(structure.springs) - 1 or frame is None or not highest_line_Hz < 0.5 * model.sample_rate_Hz:
        return model, ""
    sensor = model.sensors[0]
    for other in model.sensors[1:]:
        if not np.allclose(other.body_end_m, sensor.body_end_m):  # springs tell what the detector does, not what other bodies do
            return model, f"mode {modes + 1}, above the lines, is left out: what it does where {other.channels[0]} is measured is not known"
    moves = np.array([np.linalg.svd(here * structure.springs)[2][-1] for here in structure.moves])
    largest = int(np.argmax(np.sqrt(structure.springs) * np.abs(moves).mean(axis=0)))
    moves *= (np.sign(moves[:, largest]) / np.sqrt(moves**2 @ structure.springs))[:, None]  # one joule at a deflection of √2
    frequency_Hz = float(np.sqrt(0.5 * highest_line_Hz * model.sample_rate_Hz))
    omega = 2.0 * np.pi * frequency_Hz
    rows, pushed = [], []
    for move, place, rotation, pose in zip(moves, *detector_places(model, poses, frame), poses, strict=True):
        by = relative_motion(place, rotation, structure.turns, structure.mount.lever, structure.mount.vertical)
        twist = rotation.T @ (by @ move[n:]).reshape(2, 3).T  # shift and turn, columns
        link = move[:n]
        rest = chain_at_rest(model.chain, model.sensors[:1], pose)
        turn = sensor.rotation @ rest.speed[3:6]
        shift = sensor.rotation @ rest.acceleration[:3] - np.cross(turn.T, sensor.sensor_end_m - sensor.body_end_m).T
        of_detector = np.concatenate((twist[:, 0] + shift @ link, twist[:, 1] / TURN_LENGTH_m + turn @ link))
        rows.append(np.concatenate((np.zeros(n), link, np.tile(of_detector, len(model.sensors)), np.zeros(n))))
        pushed.append(np.concatenate((np.zeros(n), move)))
    basis = model.coefficients.shape[1]
    constant = np.zeros((2, basis))
    constant[:, 0] = omega**-2, 2.0 * DAMPING_RATIO / omega
    last = modes * model.mode_stride
    bends = last + n * (n + 1) + n + modes
    coefficients = np.vstack((
        model.coefficients[:last], constant, spread_over_poses(np.array(rows), poses, model.harmonics),
        model.coefficients[last:bends], np.zeros((1, basis)), model.coefficients[bends:],
    ))  # fmt: skip
    assert model.directions is not None, "a structure has places"
    directions = np.concatenate((model.directions, spread_over_poses(np.array(pushed), poses, model.harmonics)[None]))
    turning = None if model.turning is None else np.concatenate((model.turning, np.zeros((1, *model.turning.shape[1:]))))
    coupling = None if model.coupling is None else np.concatenate((model.coupling, np.zeros((n, n, 1, basis))), axis=2)
    note = f"mode {modes + 1}, above the lines, is what the springs leave for it; it is put at {frequency_Hz:.0f} Hz"
    return replace(model, coefficients=coefficients, directions=directions, turning=turning, coupling=coupling), note
