"""Runs under an observer's damping, which adds something else to the command in every run, are repeats of one experiment."""

from __future__ import annotations

import numpy as np
import pytest
from pushed_mass import NOISE, RAIL, pushed_mass

from hil.diagnosis.residuals.mismatch import mismatch
from hil.recording import Channel, Recording, recording_metadata

TIME_s = np.arange(1200) / RAIL.sample_rate_Hz
WAY = 0.05 * (1.0 - np.cos(2.0 * np.pi * 0.5 * TIME_s))
LARGEST_V = 0.5


def damped(seed: int) -> Recording:
    """One run: what damping added is smooth and its own."""
    random = np.random.default_rng(seed)
    added = LARGEST_V * np.sin(2.0 * np.pi * random.uniform(0.5, 3.0) * TIME_s + random.uniform(0.0, 6.0))
    position, command = pushed_mass(WAY, lambda time, position, speed: -6.0 * speed, added)  # which the machine file lacks
    rows = random.standard_normal((len(WAY), 2)) * NOISE
    channels = {
        "time": Channel("s", TIME_s),
        "reference_carriage": Channel("m", WAY),
        "excitation_carriage": Channel("V", np.zeros(len(WAY))),
        "damping_carriage": Channel("V", added),
        "command_carriage": Channel("V", command + rows[:, 0]),
        "position_carriage": Channel("m", position + rows[:, 1]),
    }
    return Recording(channels, recording_metadata(RAIL, experiment={"start_pose": [0.0]}))


@pytest.fixture(scope="module")
def beside():
    return mismatch(RAIL, {f"run {seed}": damped(seed) for seed in range(3)})


def test_they_are_one_group_whose_noise_comes_from_repeats(beside):
    (group,) = beside.groups
    assert group.repeats == 3 and beside.noise.kind == "repeats"


def test_what_damping_added_is_not_taken_for_noise(beside):
    """It is ten times the noise of the command; a tenth of it, or less, is left where the machine file's damper is a tenth too weak."""
    assert LARGEST_V / np.sqrt(2.0) > 10.0 * NOISE[0]
    assert beside.noise.std[0] < 2.0 * NOISE[0]
