"""Windows of a recording in one simulation, each from a state of its own: against the closed form of a mass on a damper."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.machine import load_machine
from hil.simulation import Inputs, Simulator
from hil.simulation.inputs import Restarts
from hil.simulation.several import Own
from hil.simulation.smooth import smooth

RAIL = load_machine(Path(__file__).parents[1] / "diagnosis" / "rail.toml")
MASS_kg, DAMPING_N_s_m, RATE_Hz = 20.0, 60.0, 200.0
ROWS, WINDOW = 300, 60


def test_every_window_begins_at_its_state_and_coasts_as_the_closed_form() -> None:
    simulator = Simulator(smooth(replace(RAIL, controllers=()), 8))
    rows = np.arange(0, ROWS, WINDOW)
    position, speed = 0.1 * np.arange(len(rows))[:, None], np.array([[0.4], [-0.3], [0.0], [0.2], [1.0]])
    none = np.zeros((ROWS, 1))
    inputs = Inputs(None, none, none, none, np.zeros(1), restarts=Restarts(rows, np.array([0]), position, speed))
    damping = [p.quantity for p in simulator.plant.parameters].index("damping")
    for factor, outputs in zip(
        (1.0, 3.0), simulator.run_all(inputs, [(_with(simulator, damping, f), ()) for f in (1.0, 3.0)]), strict=True
    ):
        time_s = np.tile(np.arange(WINDOW) / RATE_Hz, len(rows))
        decay = MASS_kg / (factor * DAMPING_N_s_m)
        x0, v0 = np.repeat(position[:, 0], WINDOW), np.repeat(speed[:, 0], WINDOW)
        assert outputs.position[:, 0] == pytest.approx(x0 + v0 * decay * (1.0 - np.exp(-time_s / decay)), abs=2e-6)  # type: ignore[union-attr]


def test_machines_beside_each_other_begin_apart_by_what_is_their_own() -> None:
    simulator = Simulator(smooth(replace(RAIL, controllers=())))
    none = np.zeros((ROWS, 1))
    restarts = Restarts(np.array([0, 100]), np.array([0]), np.array([[0.0], [1.0]]), np.zeros((2, 1)))
    own = [Own(np.ones(1), np.full(1, shift), np.zeros(1), np.zeros(1)) for shift in (0.0, 0.25, -0.5)]
    found = simulator.run_all(Inputs(None, none, none, none, np.zeros(1), restarts=restarts), [(None, ())] * 3, own)
    assert [one.position[50, 0] for one in found] == pytest.approx([0.0, 0.25, -0.5])  # type: ignore[union-attr]
    assert [one.position[150, 0] for one in found] == pytest.approx([1.0, 1.25, 0.5])  # type: ignore[union-attr]


def test_a_controller_of_twice_the_gain_runs_as_one_whose_file_says_so() -> None:
    rng = np.random.default_rng(4)
    reference = np.cumsum(0.01 * rng.standard_normal((ROWS, 1)), axis=0)
    none = np.zeros_like(reference)
    inputs = Inputs(reference, none, none, None, reference[0])
    (controller,) = RAIL.controllers
    sections = controller.position_sections.copy()
    sections[0, :3] *= 2.0
    filed = Simulator(smooth(replace(RAIL, controllers=(replace(controller, position_sections=sections),))))
    (twice,) = Simulator(smooth(RAIL)).run_all(inputs, [(None, ())], [Own(np.full(1, 2.0), np.zeros(1), np.zeros(1), np.zeros(1))])
    (wanted,) = filed.run_all(inputs, [(None, ())])
    assert twice.command == pytest.approx(wanted.command, rel=1e-9, abs=1e-12)  # type: ignore[union-attr]


def _with(simulator: Simulator, number: int, factor: float) -> np.ndarray:
    values = simulator.plant.nominal
    values[number] *= factor
    return values
