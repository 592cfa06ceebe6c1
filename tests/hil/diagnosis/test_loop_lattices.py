"""What rounding does in a loop is noise to a simulation without it, as far as repeats have it in common.

The truth is a recursion of its own (`pushed_mass.py`) that rounds what it reads and what it applies.
"""

from __future__ import annotations

import numpy as np
import pytest
from pushed_mass import NOISE, RAIL, pushed_mass

from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.machine import machine_from_text
from hil.recording import Channel, Recording, recording_metadata

COUNT_m, STEP_V, ZERO_m = 2e-5, 0.02, 6e-6
LATTICES = {"resolution_um = 0.0": "resolution_um = 20.0", "limit_V = 10.0": "limit_V = 10.0\ntarget_resolution_mV = 20.0"}
TEXT = RAIL.text
for smooth, rounded in LATTICES.items():
    TEXT = TEXT.replace(smooth, rounded)
CARRIAGE = machine_from_text(TEXT)
TIME_s = np.arange(3000) / CARRIAGE.sample_rate_Hz


def repeats(apart: float, slower: float = 1.0, count: int = 3) -> dict[str, Recording]:
    """Repeats that differ in the measured command, and in where within a count they are by `apart` rms.

    The encoder's zero is a part of a count off.
    """
    found = {}
    for seed in range(count):
        random = np.random.default_rng(seed)
        shaken = 0.0 if apart == 0.0 else apart * np.cumsum(random.standard_normal(len(TIME_s))) / 30.0
        way = 0.05 * (1.0 - np.cos(2.0 * np.pi * 0.2 * slower * TIME_s))
        position, command = pushed_mass(way + shaken, lambda time, position, speed: 0.0, count=COUNT_m, target_step=STEP_V, zero=ZERO_m)
        channels = {
            "time": Channel("s", TIME_s),
            "reference_carriage": Channel("m", way),
            "excitation_carriage": Channel("V", np.zeros(len(way))),
            "command_carriage": Channel("V", command + NOISE[0] * random.standard_normal(len(way))),
            "position_carriage": Channel("m", position),
        }
        found[f"run {seed}"] = Recording(channels, recording_metadata(CARRIAGE, experiment={"start_pose": [0.0]}))
    return found


def misfit(found) -> float:
    """|residual|^2 of the true machine over its expectation."""
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        return float(np.mean((runs.measured() - runs.run_one(Trial(runs.nominal))) ** 2))


@pytest.fixture(scope="module")
def together():
    return mismatch(CARRIAGE, repeats(apart=0.0))


def test_beside_the_true_machine_nothing_is_left_but_noise(together):
    assert 0.5 < misfit(together) < 1.5
    other = mismatch(CARRIAGE, repeats(apart=0.0, slower=0.7, count=1), channels=together.channels, noise=together.noise)
    assert 0.5 < misfit(other) < 1.5  # one recording, as held out


def test_repeats_that_are_counts_apart_have_errors_of_their_own(together):
    assert together.noise.shared is not None
    assert mismatch(CARRIAGE, repeats(apart=3.0 * COUNT_m, count=2)).noise.shared is None


def test_repeats_that_stand_within_a_count_share_what_the_loop_does_there():
    """The encoder that never changes is no channel then."""
    still = repeats(apart=0.0, count=2)
    zero = np.zeros(len(TIME_s))
    still = {
        name: Recording({**run.channels, "reference_carriage": Channel("m", zero), "position_carriage": Channel("m", zero)}, run.metadata)
        for name, run in still.items()
    }
    found = mismatch(CARRIAGE, still)
    assert found.channels == ("command_carriage",)
    assert found.noise.shared is not None
