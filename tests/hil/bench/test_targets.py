"""Targets that the bench computes for drives that close loops of their own."""

from __future__ import annotations

import numpy as np
import pytest
from bench_machines import carm_text_in, edited

from hil.bench.control import Control
from hil.machine import Machine, machine_from_text
from hil.simulation.commands import commanded

POSITION_GAIN, TRACKING_ERROR, SPEED = 4.0, np.radians(3.0), np.radians(30.0)
AT_MOST = TRACKING_ERROR + SPEED / POSITION_GAIN


@pytest.fixture(scope="module")
def machine() -> Machine:
    text = edited(r"position_gain = [0-9.]+", f"position_gain = {POSITION_GAIN}", carm_text_in("position"))
    text = edited(r"^tracking_error_deg = .*$", "tracking_error_deg = 3.0", edited(r"^speed_deg_s = .*$", "speed_deg_s = 30.0", text))
    sections = r"position_sections = [[2.0, 0.0, 0.0, 1.0, 0.0, 0.0]]\nreference_sections = [[2.0, 0.0, 0.0, 1.0, 0.0, 0.0]]\n"
    return machine_from_text(edited(r"position_sections = .*\nreference_sections = .*\n", sections, text))


@pytest.mark.parametrize("reference", [-1.2, 0.0, 1.4])
@pytest.mark.parametrize("apart", [-9.0, -0.02, 0.0, 0.01, 9.0])
def test_a_correction_is_within_the_lag_at_full_speed_and_the_tracking_error(machine: Machine, reference: float, apart: float) -> None:
    sent: dict[int, float] = {}
    control = Control(machine.controllers, machine.commands, sent.__setitem__)
    at, nothing = np.full(2, reference), np.zeros(2)
    control.preload(nothing, at, nothing)
    assert sent == {0: reference, 1: reference}
    control.step(at, at - apart, nothing, nothing)
    expected = reference + np.clip(2.0 * apart, -AT_MOST, AT_MOST)
    assert [sent[0], sent[1], *control.command] == pytest.approx([expected] * 4)


def test_the_simulation_commands_the_same(machine: Machine) -> None:
    command = machine.commands[1]
    assert command is not None
    reference, position = np.full(5, 0.7), np.array([0.7, 0.69, 9.0, -9.0, np.nan])
    expected = [0.7, 0.72, 0.7 - AT_MOST, 0.7 + AT_MOST, 0.7 + AT_MOST]
    assert commanded(command, reference, position) == pytest.approx(expected)
