"""Check of active damping before it runs on a machine: plant, position loops, observer and damping as one linear loop.

The loop is examined at poses of the machine's range. The plant is the machine file's, the observer and the law are those that will run, so
the check includes the errors of the observer's model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from controllers.damping import ModalDamping
from controllers.observers.extended_kalman import next_and_read
from controllers.observers.modal_observer import ModalObserver
from hil.errors import UnusableInputError
from hil.machine import Machine
from hil.machine.check import GAIN_MARGIN_dB, PHASE_MARGIN_deg, pose_grid
from hil.machine.closed_loop import Margins, cascade_state_space, frequency_grid, margins_of_axes
from hil.machine.finding import shown_pose
from virtual_bus.linear.left_out import without
from virtual_bus.physics import Physics

POSES = 25
SETTLED_ROWS = 1024
"""After so many rows at rest the filter's gain is settled to a per cent, except for biases that cannot be separated from tilt."""


@dataclass(frozen=True)
class DampedPose:
    """The loop at one pose.

    Attributes
    ----------
    pose : (n_axes,) rad or m
    pole_radius : of the whole loop; below 1 it is stable.
    margins : of every axis at its drive, the other closed.
    ratio, ratio_before : damping ratio of the damped mode in closed loop, with and without.
    """

    pose: tuple[float, ...]
    pole_radius: float
    margins: tuple[Margins, ...]
    ratio: float
    ratio_before: float


class DampedLoop:
    """Plant, position loops, observer and damping at one pose, in the order in which they step.

    In row k the loop receives z_k, updates the observer, which knows the commands k-1 and k-2, and gives command k = -C_y y_k + damping.
    The plant receives command k-1 from row k to k+1.

    Parameters
    ----------
    machine : Machine
    physics : Physics
        Of this machine, without noise.
    observer : ModalObserver
    damping : ModalDamping or None
        None: position loops alone.
    pose : (n_axes,) array
    """

    def __init__(self, machine: Machine, physics: Physics, observer: ModalObserver, damping: ModalDamping | None, pose: np.ndarray) -> None:
        self._rate_Hz = machine.sample_rate_Hz
        axes, model = len(machine.axes), observer.model
        plant = physics.sampled(pose, model.channels())
        self._plant_poles, self._late_s = plant.poles, plant.late_s
        cascades = [cascade_state_space(controller.position_sections) for controller in machine.controllers]
        controller = scipy.linalg.block_diag(*(cascade[0] for cascade in cascades))
        entering, leaving = (scipy.linalg.block_diag(*(np.reshape(cascade[k], shape) for cascade in cascades)) for k, shape in
                             ((1, (-1, 1)), (2, (1, -1))))  # fmt: skip
        through = np.diag([cascade[3] for cascade in cascades])
        F, G, H, J, K = _observer_at(observer, physics, pose)
        law_x, law_u = _law_at(damping, observer, pose) if damping is not None else (np.zeros((axes, len(F))), np.zeros((axes, axes)))
        # states: plant with what waits for it, commands k-1 and k-2, observer, controllers; inputs: commands k on their way to the plant
        sizes = [len(plant.a), axes, axes, len(F), len(controller)]
        first = np.concatenate(([0], np.cumsum(sizes)))
        x, last, before, seen, own = (slice(first[k], first[k + 1]) for k in range(5))
        total = first[-1]
        measured = np.zeros((len(plant.c), total))
        measured[:, x] = plant.c
        predicted = np.zeros((len(F), total))
        predicted[:, seen], predicted[:, before] = F, G
        expected = H @ predicted
        expected[:, before] += J
        updated = predicted + K @ (measured - expected)
        command = law_x @ updated
        command[:, last] += law_u
        command -= through @ measured[:axes]
        command[:, own] += leaving
        step = np.zeros((total, total))
        step[x, x] = plant.a
        step[last], step[before, last], step[seen] = command, np.eye(axes), updated
        step[own, own] = controller
        step[own] -= entering @ measured[:axes]
        self._open, self._command = step, command
        self._entering = np.zeros((total, axes))
        self._entering[x] = plant.b

    def poles(self) -> np.ndarray:
        """Return the poles of the closed loop, in z."""
        return self._poles(np.ones(len(self._command)))

    def _poles(self, factors: np.ndarray) -> np.ndarray:
        """Return the poles of the loop closed with each drive's command times its factor."""
        return np.linalg.eigvals(self._open + (self._entering * factors) @ self._command)

    def margins(self) -> tuple[Margins, ...]:
        """Return the margins of every axis, cut at its drive, the others closed."""
        frequencies = frequency_grid(self._plant_poles, self._rate_Hz, self._late_s)
        z = np.exp(2j * np.pi * frequencies / self._rate_Hz)
        triangular, unitary = scipy.linalg.schur(self._open, output="complex")
        right = unitary.conj().T @ self._entering
        gain = np.array([-self._command @ unitary @ scipy.linalg.solve_triangular(_shifted(triangular, at), right) for at in z])
        return margins_of_axes(frequencies, gain, self._poles)

    def damping_ratio(self, near_Hz: float) -> float:
        """Return the damping ratio of the slowest-decaying pole within a quarter of a frequency."""
        poles = self.poles()
        s = np.log(poles[np.abs(poles) > 1e-6]) * self._rate_Hz
        near = s[(s.imag > 0.0) & (np.abs(np.abs(s) / (2.0 * np.pi * near_Hz) - 1.0) < 0.25)]
        return float(np.min(-near.real / np.abs(near))) if near.size else float("nan")


def _shifted(triangular: np.ndarray, z: complex) -> np.ndarray:
    shifted = -triangular
    shifted[np.diag_indices_from(shifted)] += z
    return shifted


def _observer_at(observer: ModalObserver, physics: Physics, pose: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the filter at rest in a pose: x̂⁻ = F x̂ + G u, ẑ = H x̂⁻ + J u, x̂ = x̂⁻ + K (z - ẑ), with its settled gain."""
    model, n = observer.model, len(pose)
    physics.place(pose)
    latched = physics.latch_exactly()
    z = np.concatenate((latched.position, latched.link_position, latched.imu))[: len(model.channels())]
    holding = physics.holding_effort(pose)
    observer.restart()
    for _ in range(SETTLED_ROWS):
        observer.step_measured(z, holding)
    # P Hᵀ R⁻¹ is the gain when P is the covariance after the update
    covariance, at_rest = observer.covariance, observer.state[:n].copy()
    F, H = observer.linearised(at_rest)
    K = covariance @ H.T / observer.noise.measurement**2
    constants, scheduled, states = observer.constants, observer.scheduled, len(F)  # at rest since `linearised`
    rest = np.zeros(states)
    rest[:n] = at_rest

    def answer(effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        after, read = np.zeros(states), np.zeros(len(H))
        next_and_read(constants, scheduled, rest, effort, after, read)
        return after, read

    still = answer(np.zeros(n))
    moved = [answer(unit) for unit in np.eye(n)]
    G, J = (np.column_stack([each[k] - still[k] for each in moved]) for k in (0, 1))
    return F, G, H, J, K


def _law_at(damping: ModalDamping, observer: ModalObserver, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the law's slopes by state and by the command on the wire, at rest in a pose.

    The law is linear there, so the difference over one unit is exact. Call after `_observer_at`, which leaves the model at that pose.
    """
    n, states = len(pose), len(observer.state)
    rest, still = np.zeros(states), np.zeros(n)
    rest[:n] = pose
    base, moved = np.zeros(n), np.zeros(n)
    damping.law(rest, still, base)
    by_state, by_command = np.zeros((n, states)), np.zeros((n, n))
    for k in range(n, states):  # the pose schedules; it is frozen
        if observer.state_names[k].startswith("log_frequency"):
            continue
        shifted = rest.copy()
        shifted[k] = 1.0
        damping.law(shifted, still, moved)
        by_state[:, k] = moved - base
    for k in range(n):
        damping.law(rest, np.eye(n)[k], moved)
        by_command[:, k] = moved - base
    return by_state, by_command


def examine_damping(machine: Machine, damping: ModalDamping, observer: ModalObserver) -> list[DampedPose]:
    """Examine the loop over a grid of poses of the machine's range."""
    physics = Physics(machine.plant, noise=False)
    results = []
    for pose in pose_grid(machine, POSES):
        at = np.array(pose)
        near_Hz = float(observer.model.frequencies_Hz(at)[damping.settings.mode])
        with_it, plain = (DampedLoop(machine, physics, observer, law, at) for law in (damping, None))
        radius = float(np.abs(with_it.poles()).max())
        results.append(DampedPose(pose, radius, with_it.margins(), with_it.damping_ratio(near_Hz), plain.damping_ratio(near_Hz)))
    return results


def accept_damping(machine: Machine, results: list[DampedPose]) -> str:
    """Return the result of the check in one line.

    Raises
    ------
    UnusableInputError
        Some pose is not stable, or has less than the margins that `isocenter machine check` asks for.
    """
    worst = max(results, key=lambda result: result.pole_radius)
    if worst.pole_radius >= 1.0:
        unstable = sum(result.pole_radius >= 1.0 for result in results)
        raise UnusableInputError(
            f"--damping: the loop would be unstable in {unstable} of {len(results)} poses,"
            f" worst at {shown_pose(machine, worst.pose)}; ask for less"
        )
    for axis, name in enumerate(machine.axes):
        for what, unit, least, value in (("phase", "deg", PHASE_MARGIN_deg, "phase_deg"), ("gain", "dB", GAIN_MARGIN_dB, "gain_dB")):
            worst = min(results, key=lambda result: getattr(result.margins[axis], value))
            margin, at_Hz = getattr(worst.margins[axis], value), getattr(worst.margins[axis], f"{what}_at_Hz")
            if margin < least:
                raise UnusableInputError(
                    f"--damping: {name} would have {margin:.1f} {unit} of {what} margin at {at_Hz:.1f} Hz"
                    f" ({shown_pose(machine, worst.pose)}); at least {least:g} {unit} is right; ask for less"
                )
    phase = min(margin.phase_deg for result in results for margin in result.margins)
    gain = min(margin.gain_dB for result in results for margin in result.margins)
    before, after = min(result.ratio_before for result in results), min(result.ratio for result in results)
    return (
        f"damping: the mode's ratio in closed loop at least {after:.1%} instead of {before:.1%} over {len(results)} poses;"
        f" margins at least {phase:.0f} deg and {gain:.1f} dB{without(machine.plant.effects)}"
    )
