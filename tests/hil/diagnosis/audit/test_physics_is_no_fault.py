"""Physics that the file leaves out is named: recordings are called wrong for a unit, a sign, an axis or another machine alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hil.diagnosis.audit.recordings import faults
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata

MOTOR, TURNTABLE = load_machine("laas_anti_cogging"), load_machine("turntable")
INERTIA, DAMPING = 2.49e-4, 0.0185
TIME_s = np.arange(6000) / 1000.0
Law = Callable[[np.ndarray, np.ndarray], np.ndarray]


def moved(law: Law, *lines: tuple[float, float]) -> Recording:
    """The motor on a motion of some lines (amplitude [rad], frequency [Hz]), driven by what that takes and a further law's effort [Nm]."""
    waves = [(a, 2.0 * np.pi * f, np.sin(2.0 * np.pi * f * TIME_s), np.cos(2.0 * np.pi * f * TIME_s)) for a, f in lines]
    position = np.sum([a * sine for a, _, sine, _ in waves], axis=0)
    speed = np.sum([a * w * cosine for a, w, _, cosine in waves], axis=0)
    change = np.sum([-a * w**2 * sine for a, w, sine, _ in waves], axis=0)
    effort = INERTIA * change + DAMPING * speed + law(position, speed)
    step = MOTOR.plant.encoders[0].resolution
    channels = {
        "time": Channel("s", TIME_s),
        "command_rotor": Channel("A", effort),
        "position_rotor": Channel("rad", step * np.round(position / step)),
    }
    return Recording(channels, recording_metadata(MOTOR))


def hysteresis(position: np.ndarray, width_rad: float = 0.2, most_Nm: float = 1.0, stiffness: float = 4.0) -> np.ndarray:
    """A spring beside a friction that winds up over a width (Dahl 1968)."""
    held, found = 0.0, []
    for by in np.diff(position, prepend=position[0]):
        held = (held + by / width_rad) / (1.0 + abs(by) / width_rad)
        found.append(held)
    return most_Nm * np.array(found) + stiffness * position


@pytest.mark.parametrize("lines", [[(1.0, 0.5)], [(1.0, 0.5), (1.0, 0.6)], [(1.0, 2.0)]])
@pytest.mark.parametrize(
    "law",
    [
        lambda q, v: hysteresis(q),
        lambda q, v: 4.0 * q,
        lambda q, v: 4.0 * q + 4.0 * q * np.abs(q),
        lambda q, v: 4.0 * q**3,
        lambda q, v: 2.0 * np.sin(q - 0.6) + 0.1 * np.tanh(v / 0.01),
    ],
    ids=["hysteresis", "spring", "quadratic spring", "cubic spring", "gravity"],
)
def test_an_effort_over_position_is_no_other_machine_s(law: Law, lines: list[tuple[float, float]]) -> None:
    assert faults(MOTOR, {"a": moved(law, *lines)}) == []


def test_a_wrong_sign_is_told_beside_friction() -> None:
    """Where the inertia is seen apart from all that depends on position."""
    recording = moved(lambda q, v: 0.02 * np.tanh(v / 0.01), (2.5, 0.5), (0.16, 8.0))
    assert faults(MOTOR, {"a": recording}) == []
    turned = {**recording.channels, "command_rotor": Channel("A", -recording["command_rotor"])}
    (found,) = faults(MOTOR, {"a": Recording(turned, recording.metadata)})
    assert "of the opposite sign" in found.said


def test_a_constant_effort_is_no_other_recording_s() -> None:
    recording = moved(lambda q, v: 0.0 * q, (1.0, 0.5))
    still = {**recording.channels, "command_rotor": Channel("A", np.full(len(TIME_s), 0.25))}
    assert faults(MOTOR, {"a": Recording(still, recording.metadata)}) == []


def stepped(stands: bool) -> Recording:
    """A table's encoder, read every tenth row, before and after a step at 3 s; without `stands` the reference moves from the start."""
    time = np.arange(1200) / 200.0
    late = np.maximum(time - 3.0, 0.0)
    there = 0.5 * (1.0 - np.exp(-20.0 * late) * (1.0 + 20.0 * late))
    position = np.repeat(np.round(there[::10] / 1e-4) * 1e-4, 10)
    asked = np.where(time > 3.0, 0.5, 0.0) if stands else 0.5 * np.clip(time / 3.0, 0.0, 1.0)
    channels = {
        "time": Channel("s", time),
        "reference_turn": Channel("rad", asked),
        "position_turn": Channel("rad", position),
    }
    return Recording(channels, recording_metadata(TURNTABLE))


def test_a_rest_before_a_step_is_not_stuck() -> None:
    assert not any("stuck" in fault.said for fault in faults(TURNTABLE, {"a": stepped(stands=True)}))


def test_a_reading_that_stands_while_its_reference_moves_is_stuck() -> None:
    assert any("stuck" in fault.said for fault in faults(TURNTABLE, {"a": stepped(stands=False)}))
