"""A plant at rest: elastic equilibrium, and the effort that holds it.

The efforts of effects are included, friction is not.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from virtual_bus.effects.table import targets_at_rest
from virtual_bus.errors import PlantError
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.drives import DRIVE_STATES

DIFFERENCE = 1e-6  # rad or m, for gradients of gravity: half the digits of a central difference
TOLERANCE = 1e-12  # of the Newton step, relative to 1 rad or 1 m
UNBALANCED = 1e-6  # share of the largest static effort that may remain where a spring gives no effort
SOFTEST = 1e-12  # share of the largest stiffness: a softer direction is treated as if it were this stiff
MAX_ITERATIONS = 50
LARGEST_STEP = 0.3  # rad or m per Newton iteration, so that a soft joint does not jump to another equilibrium
TURNED_BACK = 0.25
"""A step that leads back by more than this share of the last one is halved. A difference across the corner of a gap is the mean of both
slopes; where one of them is nearly zero Newton's step is twice too long and would lead back and forth over the corner for ever."""


def static_effort(plant: CompiledPlant, model: np.ndarray, joint_positions: np.ndarray) -> np.ndarray:
    """Return the effort (..., n) [Nm or N] that standstill at these joint positions (..., n) takes besides the springs."""
    _, bias = plant.inertia_and_bias(model, joint_positions, np.zeros(np.shape(joint_positions)))
    effort: np.ndarray = bias + model["stiffness"][0] * (joint_positions - model["rest_position"][0])
    return effort


def static_stiffness(plant: CompiledPlant, model: np.ndarray, joint_positions: np.ndarray) -> np.ndarray:
    """Return the gradient (n, n) of `static_effort` with the joint positions: springs and gravity."""
    return _linearised(plant, model, joint_positions)[1]


def _linearised(plant: CompiledPlant, model: np.ndarray, joint_positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return `static_effort` (n,) and its gradient (n, n) with the joint positions."""
    n = plant.joints
    efforts = static_effort(plant, model, joint_positions + _shifts(n))
    return efforts[2 * n], (efforts[:n] - efforts[n : 2 * n]).T / (2.0 * DIFFERENCE)


@lru_cache(maxsize=16)
def _shifts(joints: int) -> np.ndarray:
    """Return the shifts (2 joints + 1, joints) of a difference: every joint ahead, every joint behind, none."""
    ahead = DIFFERENCE * np.eye(joints)
    return np.vstack([ahead, -ahead, np.zeros(joints)])


def equilibrium(plant: CompiledPlant, model: np.ndarray, axis_positions: np.ndarray) -> np.ndarray:
    """Return the joint positions (n,) at rest with the actuated joints held at `axis_positions` (axes,).

    There the springs balance gravity.

    Raises
    ------
    PlantError
        A joint that is neither actuated nor sprung has nothing to rest against.
    """
    free = plant.free_joints
    is_sprung = model["stiffness"][0] > 0.0
    q = np.where(is_sprung, model["rest_position"][0], 0.0)
    q[plant.driven_joints] = axis_positions
    if not free.size:
        return q
    last = np.zeros(len(free))
    for _ in range(MAX_ITERATIONS):
        effort, gradient = _linearised(plant, model, q)
        effort, gradient = effort[free], gradient[free[:, None], free]
        try:
            step = -np.linalg.solve(gradient, effort)
        except np.linalg.LinAlgError:
            step = np.full(len(free), np.nan)
        if is_sprung[free].all():
            balances = bool(np.isfinite(step).all())
            if not balances:
                step = -np.linalg.lstsq(gradient, effort, rcond=None)[0]  # a spring within its backlash holds any position
                most = UNBALANCED * np.abs(static_effort(plant, model, q)).max(initial=1.0)
                balances = bool(np.abs(gradient @ step + effort).max() <= most)
            if not (balances and _is_stable(gradient)):
                # Within a gap gravity may balance where the balance is not stable: step away, to the flank that the joint falls on. Without
                # gravity nothing is stiff within the gap: then the springs outside it say which stiffness counts as soft.
                curvatures, directions = np.linalg.eigh(0.5 * (gradient + gradient.T))
                stiffest = np.abs(gradient).max() or model["stiffness"][0].max()
                step = -directions @ (directions.T @ effort / np.maximum(np.abs(curvatures), SOFTEST * stiffest))
        if not np.isfinite(step).all():
            break
        if step @ last < -TURNED_BACK * (last @ last):
            step = 0.5 * step
        largest = float(np.abs(step).max(initial=0.0))
        last = step * min(1.0, LARGEST_STEP / max(largest, 1e-300))
        q[free] += last
        if largest < TOLERANCE:
            return q
    names = ", ".join(plant.settings.tree.joints[j].name for j in free)
    pose = np.round(axis_positions, 6).tolist()
    raise PlantError(f"no elastic equilibrium at axis positions {pose}: is one of {names} without stiffness?")


def _is_stable(gradient: np.ndarray) -> bool:
    """Return whether an effort brings every joint back from where it is moved to.

    A joint that rests anywhere counts as stable.
    """
    try:
        np.linalg.cholesky(gradient)
    except np.linalg.LinAlgError:
        return bool(np.linalg.eigvalsh(gradient)[0] >= 0.0)
    return True


def holding_effort(plant: CompiledPlant, model: np.ndarray, axis_positions: np.ndarray) -> np.ndarray:
    """Return the drive efforts (axes,) in the drives' units that hold the machine at rest at these positions."""
    return effort_at(plant, model, equilibrium(plant, model, axis_positions))


def effort_at(plant: CompiledPlant, model: np.ndarray, joint_positions: np.ndarray, pulls: np.ndarray | float = 0.0) -> np.ndarray:
    """Return the drive efforts (axes,) in the drives' units that standstill at these joint positions (n,) takes besides the springs.

    `pulls` (axes,) are efforts on the driven joints [Nm or N] beside the model's.
    """
    effort = static_effort(plant, model, joint_positions)[plant.driven_joints] - pulls
    return targets_at_rest(model, _drives_effort(effort, plant.drive_gains(model, joint_positions)))


def _drives_effort(effort: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Return efforts (axes,) in the drives' units.

    A drive without gain cannot hold a load: the effort it would take is infinite.
    """
    unheld = np.where(effort == 0.0, 0.0, np.copysign(np.inf, effort))
    needed: np.ndarray = np.divide(effort, gains, out=unheld, where=gains != 0.0)
    return needed


def resting_state(plant: CompiledPlant, model: np.ndarray, axis_positions: np.ndarray, held_by_brakes: bool) -> np.ndarray:
    """Return the plant state (state_size,) at rest in elastic equilibrium, with the IMUs' low passes settled.

    `held_by_brakes` says whether closed brakes carry the load (drive effort zero) or the drives do (their effort is `holding_effort`).
    """
    n = plant.joints
    q = equilibrium(plant, model, axis_positions)
    state = plant.new_state(q)
    held = plant.driven_joints
    if held_by_brakes:
        state[3 * n + held] = static_effort(plant, model, q)[held]
    else:
        drive_states = state[plant.first_drive_state :][: len(held) * DRIVE_STATES].reshape(len(held), DRIVE_STATES)
        needed = _drives_effort(static_effort(plant, model, q)[held], plant.drive_gains(model, q))
        drive_states[:] = targets_at_rest(model, needed)[:, None]
        drive_states[:, 1] = 0.0  # the currents' rates
    state[4 * n : plant.first_drive_state - 1] = plant.imu_motion(model, q, np.zeros(n), np.zeros(n))
    return state


def held_effort(plant: CompiledPlant, state: np.ndarray) -> np.ndarray:
    """Return the drive efforts (axes,) in a resting state that the drives hold.

    It is `holding_effort` without another search for the equilibrium.
    """
    drives = state[plant.first_drive_state :][: len(plant.settings.drives) * DRIVE_STATES]
    return drives.reshape(-1, DRIVE_STATES)[:, 0].copy()
