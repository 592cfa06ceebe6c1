"""The predicted periodic response is what the feedback and the plant do when they are stepped in time, sample by sample."""

from __future__ import annotations

import dataclasses

import control
import numpy as np
import pytest
import scipy.signal

from controllers import loop_shaping
from controllers.feedback import Feedback
from controllers.multisine import multisine
from controllers.settings import AxisController
from hil.errors import ExperimentError
from hil.experiments.prediction import ClosedLoop
from hil.machine import Machine, load_machine
from virtual_bus.physics import Physics


def closed_loop(machine: Machine, pose: np.ndarray) -> ClosedLoop:
    return ClosedLoop(machine, Physics(machine.plant, noise=False), pose)


def stepped(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, controllers: tuple[AxisController, ...], reference: np.ndarray, excitation: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Commands and positions of a closed loop with the machine's timing: the plant feels command k-1 between rows k and k+1."""
    feedback, state, applied = Feedback(controllers), np.zeros(len(a)), np.zeros(reference.shape[1])
    commands, positions = np.zeros_like(reference), np.zeros_like(reference)
    for k in range(len(reference)):
        positions[k] = c @ state
        feedback.step(reference[k], positions[k], excitation[k], np.zeros_like(applied), commands[k])
        state = a @ state + b @ applied
        applied = commands[k]
    return commands, positions


def test_a_carriage_answers_as_its_closed_form_stepped_in_time() -> None:
    machine = load_machine("emps")  # mass and viscous friction: gtau / (M s^2 + Fv s), Janot 2019
    free = tuple(dataclasses.replace(each, limit=1e9) for each in machine.controllers)
    machine = dataclasses.replace(machine, controllers=free)
    model = control.sample_system(control.ss(control.tf([35.15065], [95.1089, 203.5034, 0.0])), 1.0 / machine.sample_rate_Hz)
    period = 500
    w = multisine(np.array([2, 5, 12, 40]), np.array([0.5]), period).signals[0].T
    r = 1e-3 * np.sin(2 * np.pi * 3 * np.arange(period) / period)[:, None]
    predicted = closed_loop(machine, np.array([0.1])).steady(r, w)
    commands, positions = stepped(model.A, model.B, model.C, free, np.tile(r, (20, 1)), np.tile(w, (20, 1)))
    scale = np.abs(commands[-period:]).max(), np.abs(positions[-period:]).max()
    np.testing.assert_allclose(predicted.command, commands[-period:] - commands[-period:].mean(), atol=1e-3 * scale[0])
    np.testing.assert_allclose(predicted.position, positions[-period:] - positions[-period:].mean(), atol=1e-3 * scale[1])


def test_two_coupled_axes_answer_as_their_linearisation_stepped_in_time() -> None:
    machine, pose, period = load_machine("carm"), np.array([0.2, -0.6]), 1280
    free = tuple(dataclasses.replace(each, limit=1e9) for each in machine.controllers)
    machine = dataclasses.replace(machine, controllers=free)
    physics = Physics(machine.plant, noise=False)
    model = physics.linearise(pose)
    rows = [model.output_labels.index(f"position_{axis}") for axis in machine.axes]
    a, b, c, _, _ = scipy.signal.cont2discrete((model.A, model.B, model.C[rows], np.zeros((2, 2))), 1.0 / machine.sample_rate_Hz)
    w = multisine(np.arange(3, 200, 2), np.array([1.0, 0.5]), period).signals[0].T
    r = 0.01 * np.sin(2 * np.pi * np.arange(period) / period)[:, None] * np.array([1.0, 0.0])
    predicted = ClosedLoop(machine, physics, pose).steady(r, w)
    commands, positions = stepped(a, b, c, free, np.tile(r, (12, 1)), np.tile(w, (12, 1)))
    last = slice(-period, None)
    for found, expected in ((predicted.command, commands), (predicted.position, positions)):
        about = expected[last] - expected[last].mean(axis=0)
        np.testing.assert_allclose(found, about, atol=2e-3 * np.abs(about).max())
    speed = np.gradient(np.tile(predicted.position, (3, 1)), 1.0 / machine.sample_rate_Hz, axis=0)[period : 2 * period]
    np.testing.assert_allclose(predicted.speed, speed, atol=0.02 * np.abs(speed).max())


def test_a_controller_that_destabilises_is_refused() -> None:
    machine = load_machine("carm")
    wild = tuple(dataclasses.replace(each, position_sections=loop_shaping.gain(1e5)) for each in machine.controllers)
    with pytest.raises(ExperimentError, match=r"carm.*not stable.*lower the controller's gain"):
        closed_loop(dataclasses.replace(machine, controllers=wild), np.zeros(2))
