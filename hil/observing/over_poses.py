"""Parameters that vary with pose from modal fits at several poses: Sec. 5.4.2, smooth functions of θ with static parameters."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from controllers.models.chain import Chain
from controllers.models.modal import InertialSensor, ModalModel, basis_at, basis_size
from hil.errors import BadAnswerError
from hil.identification import FrequencyResponse
from hil.machine import Machine
from hil.observing.geometry import observed_chain
from hil.observing.modal_fit import PoseFit, TURN_LENGTH_m, drive_friction, fit_pose

HIGHEST_HARMONIC = 5
"""Of an axis position: inertias vary with the second harmonic, frequencies and shapes with what division makes of it."""

JOG_ROOM = 0.06
"""rad (m) that the outermost poses keep from the ends of the range: the jog and what it brings."""

APART_rad = np.radians(2.0)
"""Positions closer than this are one position."""

NEGLIGIBLE = 1e-8
"""Share of the largest singular value below which a combination of functions of the pose is not determined."""

MISSED = 1e-6
"""Error of a function between the poses above which they do not determine it."""

LARGEST_SWING = 100.0
"""Largest growth of the parameters' error between poses: 11 evenly spaced poses of one axis give a factor of 13, 5 of another 2."""

LEAST_LIKENESS = 0.3
"""Cosine between a mode's shapes at neighbouring poses below which it is not taken for the same mode."""


def fit_observed_model(machine: Machine, responses: Sequence[FrequencyResponse], modes: int = 4) -> tuple[ModalModel, tuple[PoseFit, ...]]:
    """Fit the modal model of a machine to frequency responses at one pose or more.

    Parameters
    ----------
    machine : Machine
        For the geometry, the axes' units and limits, and the sensors' bandwidth.
    responses : sequence of FrequencyResponse
        One per pose, outputs as `observed_channels`.
    modes : int

    Raises
    ------
    BadAnswerError
        A mode cannot be followed from pose to pose.
    """
    chain, sensors, source_end, _ = observed_chain(machine)
    fits = _fits(responses, chain, sensors, modes)
    harmonics = harmonics_for(np.array([fit.pose for fit in fits]))
    basis = basis_at(harmonics, [fit.pose for fit in fits])
    rows = np.array([_rows(fit) for fit in fits])
    coefficients = np.linalg.lstsq(basis, rows, rcond=NEGLIGIBLE)[0].T
    left = rows - basis @ coefficients.T
    model = ModalModel(
        axes=machine.axes,
        chain=chain,
        sensors=sensors,
        source_end_m=source_end,
        harmonics=harmonics,
        coefficients=np.ascontiguousarray(coefficients),
        sample_rate_Hz=machine.sample_rate_Hz,
        effort_limit=np.array([drive.limit for drive in machine.plant.drives]),
        effort_step=np.array([drive.resolution for drive in machine.plant.drives]),
        position_unit=tuple(units.position for units in machine.units),
        notes=_notes(fits, left, modes) + untold_note([fit.pose for fit in fits], harmonics, "responses"),
    )
    return model, fits


def observed_channels(machine: Machine) -> tuple[str, ...]:
    """Return the channels a frequency response must have as outputs: motor sides, link sides, inertial sensors."""
    _, sensors, _, _ = observed_chain(machine)
    encoders = [f"position_{axis}" for axis in machine.axes] + [f"link_position_{axis}" for axis in machine.axes]
    return (*encoders, *(channel for sensor in sensors for channel in sensor.channels))


def harmonics_for(poses: np.ndarray) -> tuple[int, ...]:
    """Return the order of the trigonometric polynomial in each axis that poses (P, n_axes) can determine."""
    orders = []
    for positions in poses.T:
        distinct = 1 + int(np.sum(np.diff(np.sort(positions)) > APART_rad))
        orders.append(min((distinct - 1) // 2, HIGHEST_HARMONIC))
    while basis_size(tuple(orders)) > len(poses):
        orders[int(np.argmax(orders))] -= 1
    return tuple(orders)


def axis_grid(machine: Machine, axis: int, count: int) -> list[float]:
    """Return positions of one axis over its range [rad or m], closer together towards the ends.

    They are Chebyshev points of the arc, for trigonometric polynomials, stretched to reach its ends: between equidistant points the
    polynomials oscillate, most near the ends.
    """
    limit = machine.limits[axis]
    is_bounded = bool(np.isfinite([limit.lower, limit.upper]).all())
    low, high = (limit.lower + JOG_ROOM, limit.upper - JOG_ROOM) if is_bounded else (-1.0, 1.0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if half >= np.pi:
        return [float(position) for position in np.linspace(low, high, count)]
    points = -np.cos((np.arange(count) + 0.5) * np.pi / count) / np.cos(0.5 * np.pi / count)
    return [float(position) for position in middle + 2.0 * np.arcsin(np.sin(0.5 * half) * points)]


def untold_note(poses: Sequence[np.ndarray] | np.ndarray, harmonics: tuple[int, ...], measured: str) -> tuple[str, ...]:
    """Return a line for a design where functions of the pose are not determined over the poses' whole range.

    Poses along a line, or a cross, do not show how the axes act together, even with enough positions of each axis.
    """
    if sum(order > 0 for order in harmonics) < 2:
        return ()
    at = np.array(poses, dtype=float)
    ends = zip(at.min(axis=0), at.max(axis=0), harmonics, strict=True)
    between = np.array(list(product(*(np.linspace(low, high, 4 * order + 1) for low, high, order in ends))))
    basis, wanted = basis_at(harmonics, at), basis_at(harmonics, between)
    weights = wanted @ np.linalg.pinv(basis, rcond=NEGLIGIBLE)
    missed = np.abs(wanted - weights @ basis).max(axis=1)
    swing = np.where(missed > MISSED, np.inf, np.abs(weights).sum(axis=1))
    if swing.max() < LARGEST_SWING:
        return ()
    worst = np.round(between[int(np.argmax(swing))], 2).tolist()
    return (
        f"WARNING: the {len(at)} poses of {measured} do not tell how the axes act together: around {worst} (rad or m) the model is a guess;"
        " add poses away from the line or cross on which they lie",
    )


def embedded(coefficients: np.ndarray, known: tuple[int, ...], wanted: tuple[int, ...]) -> np.ndarray:
    """Return the same functions of the pose: coefficients (rows, basis) of a smaller basis, written in a larger one."""
    shape_known, shape_wanted = ([2 * order + 1 for order in orders] for orders in (known, wanted))
    places = np.ravel_multi_index(np.unravel_index(np.arange(coefficients.shape[1]), shape_known), shape_wanted)
    wide = np.zeros((len(coefficients), int(np.prod(shape_wanted))))
    wide[:, places] = coefficients
    return wide


def _fits(responses: Sequence[FrequencyResponse], chain: Chain, sensors: tuple[InertialSensor, ...], modes: int) -> tuple[PoseFit, ...]:
    """Fit in the order of the poses' distance from the middle one, every mode followed from the nearest pose already fitted."""
    poses = np.array([response.pose for response in responses])
    order = np.argsort(np.linalg.norm(poses - np.median(poses, axis=0), axis=1), kind="stable")
    friction = np.median([drive_friction(response) for response in responses], axis=0)  # a drive's own, whatever the pose
    done: list[PoseFit] = []
    for index in order:
        near = min(done, key=lambda other: float(np.linalg.norm(other.pose - poses[index]))) if done else None
        fit = fit_pose(responses[index], chain, sensors, modes, near, friction)
        done.append(fit if near is None else _aligned(fit, near, chain))
    return tuple(sorted(done, key=lambda fit: tuple(fit.pose)))


def _aligned(fit: PoseFit, near: PoseFit, chain: Chain) -> PoseFit:
    """Return the same fit with its shapes' signs as the neighbour's; the order of frequencies is the order of modes.

    A mode of the arc keeps its shape in the detector's frame, one of the mount in the world: the clearer similarity decides.

    Raises
    ------
    BadAnswerError
        A shape has nothing in common with its neighbour's: modes crossed between the poses.
    """
    n = len(fit.pose)
    shapes, inputs = fit.shapes.copy(), fit.inputs.copy()
    for i in range(len(shapes)):
        here, there = _twist(shapes[i], n), _twist(near.shapes[i], n)
        turned = _rotation(chain, fit.pose).apply(here), _rotation(chain, near.pose).apply(there)
        likeness = max(_likeness(here, there), _likeness(*turned), key=abs)
        if abs(likeness) < LEAST_LIKENESS:
            raise BadAnswerError(
                f"mode {i + 1} at {np.degrees(fit.pose).round(1).tolist()} deg is not the one at {np.degrees(near.pose).round(1).tolist()}"
                " deg: identify poses between them, or fewer modes"
            )
        if likeness < 0.0:
            shapes[i], inputs[i] = -shapes[i], -inputs[i]
    return PoseFit(fit.pose, fit.stiffness, fit.damping, shapes, inputs, fit.rigid, fit.friction, fit.misfit)


def _twist(shape: np.ndarray, n: int) -> np.ndarray:
    """Return shift and turn (2, 3) of the detector, both in metres."""
    turns: np.ndarray = shape[2 * n : 2 * n + 6].reshape(2, 3) * np.array([[1.0], [TURN_LENGTH_m]])
    return turns


def _likeness(a: np.ndarray, b: np.ndarray) -> float:
    """Return the cosine between two shapes."""
    return float(np.sum(a * b) / (np.linalg.norm(a) * np.linalg.norm(b)))


def _rotation(chain: Chain, pose: np.ndarray) -> Rotation:
    """Return the rotation from the chain's last frame to the world."""
    turn = Rotation.identity()
    for axis, revolute, angle in zip(chain.axes, chain.revolute, pose, strict=True):
        turn = turn * Rotation.from_rotvec(axis * angle if revolute else np.zeros(3))
    return turn


def _rows(fit: PoseFit) -> np.ndarray:
    """Return one pose's parameters in the order of `ModalModel.coefficients`, with pushes and offsets zero."""
    modes = [
        np.concatenate(([1.0 / stiffness, damping / stiffness], shape, given / stiffness))
        for stiffness, damping, shape, given in zip(fit.stiffness, fit.damping, fit.shapes, fit.inputs, strict=True)
    ]
    return np.concatenate((*modes, fit.rigid.ravel(), fit.friction, np.zeros(len(fit.pose) + len(modes) + 6)))


def _notes(fits: Sequence[PoseFit], left: np.ndarray, modes: int) -> tuple[str, ...]:
    n = len(fits[0].pose)
    worst = max(float(np.sqrt(np.mean(fit.misfit**2))) for fit in fits)
    notes = [f"{len(fits)} poses; responses are met to {100.0 * worst:.1f} % rms or better"]
    stride = 2 + len(fits[0].shapes[0]) + n if modes else 0
    for i in range(modes):
        frequency = np.sqrt([fit.stiffness[i] for fit in fits]) / (2.0 * np.pi)
        spread = float(np.max(np.abs(left[:, i * stride]) * [fit.stiffness[i] for fit in fits]) / 2.0)
        notes.append(f"mode {i + 1}: {frequency.min():.2f} to {frequency.max():.2f} Hz over the poses, met to {100.0 * spread:.2f} %")
    return tuple(notes)
