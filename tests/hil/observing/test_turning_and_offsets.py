"""Claims: the drives' friction and what turning pushes are found from measurements, and offsets are states that images tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_models import DenseModel, drawn_rows, small_model, small_noise
from scipy.linalg import expm

from controllers.errors import DesignError
from controllers.models.modal import ModalModel, basis_values
from controllers.observers.modal_observer import ModalObserver
from hil.errors import RecordingError, UnusableInputError
from hil.experiments import Scan, Static
from hil.machine import Machine
from hil.observing import ObserverDesign, design_observer, observe
from hil.observing.modal_fit import drive_friction
from hil.observing.noise import effort_gain
from hil.observing.observability import observability
from hil.observing.over_poses import axis_grid, harmonics_for, untold_note
from hil.observing.simulated_recordings import emulated_recording, emulated_responses
from hil.observing.turning import moments_of, with_turning
from hil.recording import Recording

OFFSETS = {"offset_walk": np.full(8, 1e-7), "initial_offset": np.full(8, 1e-3)}
ROLL_rad = 0.6
EVEN_rad_s = 0.95


@pytest.fixture(scope="module")
def sweep(machine: Machine) -> Recording:
    return emulated_recording(machine, Scan("roll", -ROLL_rad, ROLL_rad, np.radians(45.0), sweeps=2).plans(machine)[0], 71)


def test_the_drives_friction_is_read_from_responses_below_the_modes(machine: Machine) -> None:
    joints = {body.joint.name: body.joint for body in machine.plant.tree.bodies if body.joint is not None}
    per_speed = [joints[drive.joint].damping / (drive.constant * drive.ratio) for drive in machine.plant.drives]
    found = drive_friction(emulated_responses(machine, [{"roll": 0.4}], seed=8)[0])
    assert found == pytest.approx(per_speed, rel=0.08)


def test_friction_couples_the_modes_in_the_step_as_in_the_matrices() -> None:
    model = replace(small_model(), coefficients=small_model().coefficients.copy())
    model.coefficients[4 * 14 + 4 : 4 * 14 + 6, 0] = [2.0, 3.0]
    observer = ModalObserver(model, small_noise(), "ekf")
    A, *_ = model.frozen(np.zeros(2))
    step, _ = observer.linearised(np.zeros(2))
    order = np.array([0, 1, 6, 7, 2, 3, 4, 5, 8, 9, 10, 11])  # [q, q', η, η'] of [q, η, q', η']
    exact = expm(A / model.sample_rate_Hz)[np.ix_(order, order)]
    free = replace(model, coefficients=model.coefficients.copy())
    free.coefficients[4 * 14 + 4 : 4 * 14 + 6] = 0.0
    without = expm(free.frozen(np.zeros(2))[0] / model.sample_rate_Hz)[np.ix_(order, order)]
    assert np.abs(step[:12, :12] - exact).max() < 0.04 * np.abs(exact - without).max()


def test_what_turning_bends_is_found_from_a_sweep_and_holds_at_another_speed(
    machine: Machine, design: ObserverDesign, sweep: Recording
) -> None:
    turned = with_turning(design.model, design.noise.bias, [sweep], effort_gain(machine))
    still = replace(design.model, turning=None)
    faster = emulated_recording(machine, Scan("roll", -ROLL_rad, ROLL_rad, np.radians(58.0), sweeps=2).plans(machine)[0], 72)
    left = [_bend_left(model, faster) for model in (still, turned)]
    assert left[1] < 0.3 * left[0], left
    assert turned.turning is not None
    assert not turned.turning[:, :2].any()  # the propeller stands still: its wobble tells nothing of what its turning pushes


def _bend_left(model: ModalModel, recording: Recording) -> float:
    """Rms of what gravity, drive and turning leave of the propeller's gear [rad] where roll moves evenly."""
    left, basis = [], np.zeros(model.coefficients.shape[1])
    for moment in moments_of(recording, model, np.zeros(6)):
        if np.abs(moment.speed[1]) > EVEN_rad_s:
            basis_values(np.array(model.harmonics), moment.pose, basis)
            turning = np.zeros((model.modes, 3)) if model.turning is None else (model.turning @ basis)[2:]
            speeds = np.array([moment.speed[0] ** 2, moment.speed[0] * moment.speed[1], moment.speed[1] ** 2])
            left.append(moment.left[0] - moment.by_modes[0] @ turning @ speeds)
    return float(np.sqrt(np.mean(np.square(left))))


def test_sweeps_that_tell_nothing_are_refused_in_one_line(machine: Machine, design: ObserverDesign, sweep: Recording) -> None:
    gain = effort_gain(machine)
    with pytest.raises(RecordingError, match="too short"):
        with_turning(design.model, design.noise.bias, [sweep.part(slice(0, 60))], gain)
    with pytest.raises(RecordingError, match="no axis moves"):
        with_turning(design.model, design.noise.bias, [sweep.part(slice(0, 200))], gain)
    with pytest.raises(RecordingError, match="the model has none"):
        with_turning(replace(design.model, directions=None, places=()), design.noise.bias, [sweep], gain)
    with pytest.raises(UnusableInputError, match="standing records"):
        design_observer(machine, [None], sweeps=[sweep], modes=4)  # type: ignore[list-item]


def test_an_offset_of_a_motor_counter_is_found_and_those_that_only_images_tell_are_named() -> None:
    noise = small_noise()
    measured, commands, _ = drawn_rows(DenseModel(small_model(), noise), noise, 600, seed=5)
    motor = 4e-4
    measured[:, 1] += motor  # roll's motor encoder
    observer = ModalObserver(small_model(), replace(noise, **OFFSETS), "ukf")
    for k in range(600):
        observer.step_measured(measured[k], commands[max(k - 1, 0)])
    at = observer.state_names.index("offset_motor_roll")
    spread = np.sqrt(observer.covariance[at, at])
    assert abs(observer.state[at] - motor) < 4.0 * spread
    assert spread < 0.2 * 1e-3
    blind = {name for group in observability(observer, [np.zeros(2)]).blind for name in group}
    assert {f"offset_detector_{name}" for name in ("x", "y", "z", "rx", "ry", "rz")} <= blind


def test_a_counter_set_a_fraction_of_a_count_off_at_homing_raises_no_alarm(machine: Machine, design: ObserverDesign) -> None:
    still = emulated_recording(machine, Static(4.0, {"roll": 0.15}).plans(machine)[0], 73)
    count = next(encoder.resolution for encoder in machine.plant.encoders if encoder.channel == "position_roll")
    position = still.channels["position_roll"]
    still.channels["position_roll"] = replace(position, values=position.values + 0.75 * count)
    without = replace(design.noise, offset_walk=np.zeros(0), initial_offset=np.zeros(0))
    told, held = (observe(still, replace(design, noise=noise).observer()) for noise in (design.noise, without))
    settled = slice(128, None)
    assert told["estimate_nis"][settled].sum() / told["estimate_measured"][settled].sum() == pytest.approx(1.0, abs=0.1)
    assert not told["estimate_alarm"].any()
    assert held["estimate_nis_window"][settled].mean() > 1.2, "and it is the offset that takes it up"
    assert not held["estimate_alarm"].any(), "without it the innovations are too large, yet what is published is right"
    offset = told.states[-1, told.state_names.index("offset_motor_roll")]
    assert offset == pytest.approx(0.75 * count, abs=0.5 * count)


def test_an_offset_that_nothing_measures_fades_and_is_as_uncertain_as_ever() -> None:
    walk, spread, seconds = 2e-4, 2e-4, 2.0
    offsets = {"offset_walk": np.full(2, walk), "initial_offset": np.full(2, spread)}
    observer, nothing = ModalObserver(small_model(), replace(small_noise(), **offsets)), np.full(10, np.nan)
    observer.step_measured(nothing, np.zeros(2))
    at = observer.state_names.index("offset_motor_roll")
    observer.state[at] = 3e-4
    for _ in range(round(seconds * observer.model.sample_rate_Hz)):
        observer.step_measured(nothing, np.zeros(2))
    assert observer.state[at] == pytest.approx(3e-4 * np.exp(-seconds * walk**2 / (2.0 * spread**2)), rel=1e-9)
    assert observer.covariance[at, at] == pytest.approx(spread**2, rel=1e-9)


def test_offsets_that_do_not_fit_are_one_clear_line() -> None:
    with pytest.raises(DesignError, match="must both be 2 numbers, 8, 10 or none"):
        ModalObserver(small_model(), replace(small_noise(), offset_walk=np.zeros(8)))


def test_positions_to_measure_at_are_those_between_which_polynomials_do_not_swing(machine: Machine) -> None:
    for axis, count in ((0, 5), (0, 9), (1, 11)):
        positions, limit = np.array(axis_grid(machine, axis, count)), machine.limits[axis]
        assert limit.lower < positions[0] < limit.lower + 0.1
        assert limit.upper - 0.1 < positions[-1] < limit.upper
        between = np.linspace(positions[0], positions[-1], 1001)
        weights = _functions(between, count) @ np.linalg.inv(_functions(positions, count))
        assert np.abs(weights).sum(axis=1).max() < 2.5  # Lebesgue's constant


def test_poses_along_a_line_or_a_cross_are_warned_of_and_a_grid_is_not() -> None:
    along = np.linspace(-1.0, 1.0, 9)
    line = np.column_stack((along, along + 1e-4 * np.sin(40.0 * along)))  # as exactly as a machine is placed
    cross = np.concatenate((np.outer(along[::2], [1.0, 0.0]), np.outer(along[::2], [0.0, 1.0])))
    grid = np.array([[first, second] for first in along[::4] for second in along[::4]])
    for poses in (line, cross):
        (warning,) = untold_note(poses, harmonics_for(poses), "responses")
        assert warning.startswith("WARNING")
        assert "do not tell how the axes act together" in warning
        assert "\n" not in warning
    assert untold_note(grid, harmonics_for(grid), "responses") == ()


def _functions(positions: np.ndarray, count: int) -> np.ndarray:
    """1, cos, sin, cos 2, ... at positions: as many as positions can tell."""
    return np.column_stack([np.ones_like(positions), *(f(k * positions) for k in range(1, count // 2 + 1) for f in (np.cos, np.sin))])
