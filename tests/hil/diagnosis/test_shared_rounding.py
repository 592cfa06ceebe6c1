"""Repeats of an open loop that are within a count share how their readings are rounded, and a mean of them keeps it.

The truth is the closed form of a mass on a damper that a held voltage pushes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from pushed_mass import GAIN_N_V, RAIL, DAMPING_N_s_m, MASS_kg, rounded

from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.residuals.shared_rounding import shared_power, shared_rounding
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.machine import machine_from_text
from hil.recording import Channel, Recording, recording_metadata

COUNT_m = 2e-5
LOOP = RAIL.text[RAIL.text.index("[controller.carriage]") : RAIL.text.index("[limits.carriage]")]
OPEN = machine_from_text(RAIL.text.replace(LOOP, "").replace("resolution_um = 0.0", "resolution_um = 20.0"))
TIME_s = np.arange(3000) / OPEN.sample_rate_Hz
VOLTS = sum(amplitude * np.sin(2.0 * np.pi * f * TIME_s) for amplitude, f in ((0.6, 0.3), (1.0, 0.9), (1.5, 2.1)))


def repeats(apart: float, count: int = 4, **experiment: int) -> dict[str, Recording]:
    """Repeats that are apart by so many counts rms, of an experiment with these metadata."""
    friction, push = -DAMPING_N_s_m / MASS_kg, GAIN_N_V / MASS_kg
    damped = np.array([[0.0, 1.0], [0.0, friction]]), np.array([[0.0], [push]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))
    held = scipy.signal.cont2discrete(damped, 1.0 / OPEN.sample_rate_Hz)
    rows = scipy.signal.dlsim(held, np.append(0.0, VOLTS[:-1]))[1][:, 0]  # a drive applies what it was told a sample ago
    found = {}
    for seed in range(count):
        strays = apart * COUNT_m * np.random.default_rng(seed).standard_normal(len(rows))
        channels = {
            "time": Channel("s", TIME_s),
            "command_carriage": Channel("V", VOLTS),
            "position_carriage": Channel("m", np.array([rounded(value, COUNT_m) for value in rows + strays])),
        }
        found[f"run {seed}"] = Recording(channels, recording_metadata(OPEN, experiment={"start_pose": [0.0], **experiment}))
    return found


@pytest.mark.parametrize("count", [2, 3, 4, 8])
@pytest.mark.parametrize("apart", [0.0, 0.05, 0.15])
def test_beside_the_true_machine_nothing_is_left_but_noise(apart, count):
    assert (0.6 if count == 2 else 0.75) < left(repeats(apart, count)) < 1.2


@pytest.mark.parametrize("experiment", [{"settle_rows": 500}, {"period_samples": 1000}])
def test_periods_and_rows_after_settling_share_it_as_well(experiment):
    assert 0.5 < left(repeats(0.05, **experiment)) < 1.3


def left(recordings) -> float:
    """|residual|^2 of the true machine over its expectation."""
    found = mismatch(OPEN, recordings)
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        return float(np.mean((runs.measured() - runs.run_one(Trial(runs.nominal))) ** 2))


def test_encoders_round_independently_of_each_other():
    group = mismatch(OPEN, repeats(0.0)).groups[0]
    plant = group.machine.plant
    both = replace(plant, encoders=(plant.encoders[0], replace(plant.encoders[0], channel="link_position_carriage")))
    group = replace(group, machine=replace(group.machine, plant=both), measured=np.repeat(group.measured, 2, axis=2))
    records, shares = shared_rounding([group], ("position_carriage", "link_position_carriage"))
    power = np.mean([record.T @ record / len(record) for _, record in records], axis=0)
    assert list(shares.values()) == pytest.approx([1.0, 1.0], abs=0.02)
    assert np.diag(power) == pytest.approx(COUNT_m**2 / 12.0, rel=0.05)
    assert power[0, 1] == 0.0


def test_what_counts_as_a_coarser_lattice_counts_once():
    group = mismatch(OPEN, repeats(0.0)).groups[0]
    assert shared_rounding([group], ("position_carriage",), {"position_carriage": None}) == ([], {})


def test_repeats_that_are_counts_apart_share_nothing():
    assert mismatch(OPEN, repeats(2.0)).noise.shared is None
    assert mismatch(OPEN, repeats(0.05)).noise.shared is not None


@pytest.mark.nightly
@pytest.mark.parametrize("apart", [0.0, 0.1, 0.2, 0.4, 1.0])
def test_what_two_readings_share_is_the_correlation_of_their_rounding_errors(apart):
    """Drawn: places anywhere within a count, two readings that scatter about each."""
    random = np.random.default_rng(1)
    places = 1000.0 * random.random(400_000)
    exact = places + apart * random.standard_normal((2, len(places)))
    readings = np.round(exact)
    errors = readings - exact
    drawn = np.mean(errors[0] * errors[1]) * 12.0
    assert shared_power(readings, 1.0, len(places)) == pytest.approx(drawn, abs=0.02)


def test_repeats_that_come_near_for_a_while_share_it_for_a_while():
    apart = np.repeat([3.0, 0.0], 500)
    random = np.random.default_rng(2)
    readings = np.round(100.0 * random.random(1000) + apart * random.standard_normal((3, 1000)))
    share = shared_power(readings, 1.0, 50)
    assert np.all(share[:500] < 0.1) and np.all(share[500:] > 0.95)


def test_lost_samples_are_not_taken_for_equal_ones():
    random = np.random.default_rng(4)
    readings = np.round(100.0 * random.random(2000) + 3.0 * random.standard_normal((3, 2000)))
    readings[2, 500:1000] = np.nan
    readings[:, 1500:] = np.nan
    readings[random.random(readings.shape) < 0.3] = np.nan
    assert np.all(shared_power(readings, 1.0, 50) < 0.1)


def test_one_recording_shares_nothing_with_itself():
    assert not np.any(shared_power(np.zeros((1, 200)), 1.0, 50))
