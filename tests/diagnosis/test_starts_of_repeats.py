"""Repeats stand a count or two from their start pose, each its own: they are one group, simulated from the mean of where they stood."""

from __future__ import annotations

import numpy as np
from pushed_mass import RAIL, recorded

from hil.diagnosis.mismatch import mismatch
from hil.recording import Recording

TIME_s = np.arange(400) / RAIL.sample_rate_Hz
WAY = 0.05 * (1.0 - np.cos(2.0 * np.pi * 0.5 * TIME_s))


def stood(deviation: float, held: float, seed: int) -> Recording:
    """A run that stood off its pose while its integrator held something."""
    states = {"carriage": {"position": [[held, 0.0], [0.0, 0.0]]}}
    initial = {"standing": {"deviation": [deviation], "speed": [0.0]}, "controller_states": states}
    return recorded(WAY, lambda time, position, speed: 0.0, seed).with_metadata(initial=initial)


def test_they_are_one_group_that_starts_at_the_mean():
    (group,) = mismatch(RAIL, {"a": stood(2e-6, 0.1, 1), "b": stood(-1e-6, 0.1, 2), "c": stood(5e-6, 0.4, 3)}).groups
    assert group.repeats == 3
    np.testing.assert_allclose(group.inputs.standing_pose, [2e-6])
    np.testing.assert_allclose(group.inputs.controller_states["carriage"]["position"], [[0.2, 0.0], [0.0, 0.0]])


def test_the_simulation_beside_them_starts_there_too():
    found = mismatch(RAIL, {"a": stood(1e-5, 0.0, 1), "b": stood(3e-5, 0.0, 2)})
    assert found.groups[0].simulated[0, found.channels.index("position_carriage")] == 2e-5
