"""Joints without an encoder begin as they do; axes whose effort nobody recorded are moved, not driven: beside own Runge-Kutta steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.observed.rows import observed
from hil.diagnosis.residuals.residuals import residuals_of
from hil.diagnosis.residuals.trajectory import FINE, Trajectory
from hil.errors import RecordingError
from hil.machine.load import machine_from_text
from hil.recording import Channel, Recording, recording_metadata

RATE_Hz = 100.0
TIME_s = np.arange(600) / RATE_Hz
HEAD = """
format = 1
name = "bench"
description = "two joints, the second one without a drive"
gravity_m_s2 = [0.0, 0.0, -9.81]

[timing]
sample_rate_Hz = 100.0
substeps = 4
"""
GANTRY = machine_from_text(
    HEAD
    + """
[[body]]
name = "cart"
parent = "world"
mass_kg = 4.0
[body.joint]
name = "cart"
type = "prismatic"
axis = [1.0, 0.0, 0.0]
damping_N_s_m = 5.0

[[body]]
name = "bob"
parent = "cart"
mass_kg = 1.0
center_of_mass_m = [0.0, 0.0, -0.5]
inertia_kg_m2 = [0.01, 0.01, 0.01, 0.0, 0.0, 0.0]
[body.joint]
name = "swing"
type = "revolute"
axis = [0.0, 1.0, 0.0]
damping_Nm_s_rad = 0.02

[drives.cart]
joint = "cart"
effort_unit = "N"
constant = 1.0
constant_unit = "N/N"
limit_N = 100.0

[sensors.position_cart]
type = "encoder"
joints = ["cart"]
kind = "absolute"
resolution_um = 10.0
""",
    label="gantry",
)
SHAFT = machine_from_text(
    HEAD
    + """
[[body]]
name = "motor"
parent = "world"
mass_kg = 1.0
inertia_kg_m2 = [0.02, 0.02, 0.02, 0.0, 0.0, 0.0]
[body.joint]
name = "motor"
type = "revolute"
axis = [0.0, 0.0, 1.0]

[[body]]
name = "load"
parent = "motor"
mass_kg = 1.0
inertia_kg_m2 = [0.05, 0.05, 0.05, 0.0, 0.0, 0.0]
[body.joint]
name = "shaft"
type = "revolute"
axis = [0.0, 0.0, 1.0]
stiffness_Nm_rad = 20.0
damping_Nm_s_rad = 0.05

[drives.motor]
joint = "motor"
effort_unit = "Nm"
constant = 1.0
constant_unit = "Nm/Nm"
limit_Nm = 10.0

[sensors.position_motor]
type = "encoder"
joints = ["motor"]
kind = "absolute"
resolution_rad = 1.0e-5

[sensors.link_position_motor]
type = "encoder"
joints = ["motor", "shaft"]
kind = "absolute"
resolution_rad = 1.0e-5
""",
    label="shaft",
)
BEGINS = np.array([0.0, 0.4, 0.0, 0.5])
"""Of cart and bob: positions, and speeds."""


def runge_kutta(slope: Callable[[np.ndarray, float], np.ndarray], begin: np.ndarray, inputs: np.ndarray, steps: int = 10) -> np.ndarray:
    """States (N, s) at the rows; an input is held from its row to the next."""
    state, found, h = np.array(begin, dtype=float), [], 1.0 / RATE_Hz / steps
    for given in inputs:
        found.append(state)
        for _ in range(steps):
            a = slope(state, given)
            b = slope(state + 0.5 * h * a, given)
            c = slope(state + 0.5 * h * b, given)
            state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + slope(state + h * c, given))
    return np.array(found)


def gantry(state: np.ndarray, push: float) -> np.ndarray:
    """Lagrange's equations of a cart and a bob that hangs from it."""
    _, angle, speed, rate = state
    coupling = -0.5 * np.cos(angle)
    inertia = np.array([[5.0, coupling], [coupling, 0.26]])
    effort = np.array([push - 5.0 * speed - 0.5 * np.sin(angle) * rate**2, -0.5 * 9.81 * np.sin(angle) - 0.02 * rate])
    return np.concatenate([state[2:], np.linalg.solve(inertia, effort)])


@pytest.fixture(scope="module")
def swung() -> tuple[np.ndarray, dict[str, Channel]]:
    push = 8.0 * np.sin(2.0 * np.pi * 0.3 * TIME_s) + 6.0 * np.sin(2.0 * np.pi * 0.9 * TIME_s)
    states = runge_kutta(gantry, BEGINS, np.append(push[0], push[:-1]))
    channels = {
        "time": Channel("s", TIME_s),
        "command_cart": Channel("N", push),
        "position_cart": Channel("m", 1e-5 * np.round(states[:, 0] / 1e-5)),
    }
    return states, channels


def test_a_bob_that_nobody_measures_begins_in_its_swing(swung: tuple[np.ndarray, dict[str, Channel]]) -> None:
    states, channels = swung
    trajectory = Trajectory(observed(GANTRY, "swung", Recording(channels, recording_metadata(GANTRY))))
    np.testing.assert_allclose(trajectory.begins[:2, 1], BEGINS[[1, 3]], rtol=0.25)
    motion = trajectory.base(trajectory.model(fine=True)).every(FINE)
    print(f"off by {np.std(motion.position[:, 1] - states[:, 1]):.3g} of {np.std(states[:, 1]):.3g} rad")
    assert np.std(motion.position[:, 1] - states[:, 1]) < 0.1 * np.std(states[:, 1])


def test_a_run_of_the_bench_begins_at_rest(swung: tuple[np.ndarray, dict[str, Channel]]) -> None:
    metadata = recording_metadata(GANTRY, experiment={"start_pose": [0.0]})
    trajectory = Trajectory(observed(GANTRY, "bench", Recording(swung[1], metadata)))
    assert not trajectory.begins.any()


def turned(late_rows: float = 0.0) -> dict[str, Channel]:
    """A motor that moves as it is told, the load behind its shaft, and the load's encoder late by so many rows."""
    lines = [(0.3, 2.0 * np.pi * 0.5), (0.1, 2.0 * np.pi * 1.3), (0.03, 2.0 * np.pi * 2.9)]
    position = np.sum([a * np.sin(w * TIME_s) for a, w in lines], axis=0)
    state, found, steps = np.zeros(2), [], 200
    for row in TIME_s:  # of the twist and its rate, by Euler's half-implicit steps
        found.append(state[0])
        for k in range(steps):
            motor = sum(-a * w**2 * np.sin(w * (row + k / steps / RATE_Hz)) for a, w in lines)
            state[1] += ((-20.0 * state[0] - 0.05 * state[1]) / 0.05 - motor) / RATE_Hz / steps
            state[0] += state[1] / RATE_Hz / steps
    load = np.interp(TIME_s - late_rows / RATE_Hz, TIME_s, position + np.array(found))
    noise = 1e-5 * np.random.default_rng(5).standard_normal((2, len(TIME_s)))
    return {
        "time": Channel("s", TIME_s),
        "position_motor": Channel("rad", position + noise[0]),
        "link_position_motor": Channel("rad", load + noise[1]),
    }


def test_an_axis_without_effort_is_moved_and_lacks_nothing() -> None:
    residuals = residuals_of(SHAFT, {"a": Recording(turned(), recording_metadata(SHAFT))})
    assert residuals.trajectories[0].observed.imposed == ("motor",)
    assert residuals.missing() == []
    assert not residuals.is_still


def test_without_effort_sensors_are_judged_by_each_other_and_that_is_said() -> None:
    """A load's encoder that is late, and no word on the motor's friction."""
    found = diagnose(SHAFT, {"a": Recording(turned(late_rows=2.0), recording_metadata(SHAFT))}).diagnosis
    assert "no effort of motor was recorded" in found.reason
    assert [one.effect.at for one in found.findings] == ["link_position_motor"], found.reason
    assert found.findings[0].effect.effect == "clock_offset"


def test_without_effort_and_another_sensor_there_is_nothing_to_judge() -> None:
    alone = {name: channel for name, channel in turned().items() if not name.startswith("link")}
    with pytest.raises(RecordingError, match="one of them is needed, or another sensor beside position_motor"):
        residuals_of(SHAFT, {"a": Recording(alone, recording_metadata(SHAFT))})
