"""A library that takes columns from another one of the same machine is the one that would be made without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from carriage import MACHINE, RATE_Hz, disturbance, recording, reference, run

from hil.diagnosis.model_choice.convergence import converged
from hil.diagnosis.model_choice.search import library
from hil.diagnosis.residuals.residuals import residuals_of
from hil.diagnosis.retuning.linear_model import nominal_offset

DURATION_s, REPEATS = 3.0, 2
PUSH_N, PUSH_Hz = 8.0, 7.0


def test_only_what_is_sought_in_what_is_left_is_made_anew() -> None:
    wanted = reference(DURATION_s)
    push = PUSH_N * np.sin(2.0 * np.pi * PUSH_Hz * np.arange(len(wanted)) / RATE_Hz)
    forces = [push + disturbance(len(wanted), 1.0, seed) for seed in range(REPEATS)]
    residuals = residuals_of(
        MACHINE, {f"run_{seed}": recording(wanted, *run(wanted, force_N=force, noise_seed=seed)) for seed, force in enumerate(forces)}
    )
    linear, plain = converged(residuals.trajectories, residuals.levels, nominal_offset(residuals.trajectories))
    of = library(linear, plain)
    noise = np.random.default_rng(1).standard_normal(plain.innovations[0].shape)
    other = replace(plain, innovations=(noise,))  # nothing of the push is left: other lines are sought
    found, right = library(linear, other, of), library(linear, other)
    keys = [law.key for law in found.laws]
    assert keys == [law.key for law in right.laws]
    assert 0 < len({law.key for law in of.laws} & set(keys)) < len(keys)
    np.testing.assert_array_equal(found.columns[0], right.columns[0])
    for one, another in zip(found.squares, right.squares, strict=True):
        np.testing.assert_allclose(one, another, rtol=1e-12)
