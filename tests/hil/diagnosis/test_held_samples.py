"""Samples held before the sensor's noise came on top, found in drawn recordings whose held rows are known."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from carriage import disturbance, reference, run
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.diagnosis.recorded.dropout import without_lost_samples
from hil.diagnosis.recorded.held_samples import held_samples

ROWS = 1000
NOISE = 1e-3


def repeats(seed, holding, moved=8.0, length=3, repeats=3, coloured=True):
    """(R, N) readings of a motion that a sample takes `moved` noises further, rms, and which rows are held."""
    random = np.random.default_rng(seed)
    shape = scipy.signal.lfilter(*scipy.signal.butter(2, 0.1), random.standard_normal(ROWS))
    motion = shape / np.std(np.diff(shape)) * moved * NOISE
    drift = scipy.signal.lfilter(*scipy.signal.butter(1, 0.02), random.standard_normal((repeats, ROWS)), axis=1)
    passed = motion + 20.0 * NOISE * coloured * drift
    held = np.zeros((repeats, ROWS), dtype=bool)
    for begin in np.argwhere(random.random((repeats, ROWS)) < holding / length):
        held[begin[0], max(begin[1], 1) : begin[1] + length] = True
    for row in range(1, ROWS):
        passed[:, row] = np.where(held[:, row], passed[:, row - 1], passed[:, row])
    return passed + NOISE * random.standard_normal(passed.shape), held


@pytest.mark.slow
@settings(max_examples=8, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.03, 0.1]), st.booleans())
def test_the_share_of_held_samples_is_measured(seed, share, coloured):
    readings, held = repeats(seed, share, coloured=coloured)
    found = held_samples(readings)
    assert found is not None
    assert found.ci95[0] < 1.2 * held.mean()
    assert found.ci95[1] > 0.8 * held.mean()
    assert np.mean(held[found.rows]) > 0.6, "most rows that are taken out were held"


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.sampled_from([0.3, 8.0, 50.0]), st.booleans(), st.sampled_from([3, 4]))
def test_where_nothing_is_held_nothing_is_found(seed, moved, coloured, count):
    readings, _ = repeats(seed, 0.0, moved, repeats=count, coloured=coloured)
    assert held_samples(readings) is None


@pytest.mark.parametrize("seed", range(4))
def test_a_disturbance_near_reversals_is_no_held_sample(seed):
    readings, _ = repeats(seed, 0.0)
    random = np.random.default_rng(seed + 100)
    near = np.zeros(ROWS)
    for centre in random.integers(100, ROWS - 100, 8):
        near[centre - 30 : centre + 30] = np.hanning(60)
    pushed = scipy.signal.lfilter(*scipy.signal.butter(1, 0.1), random.standard_normal(readings.shape), axis=1)
    assert held_samples(readings + 40.0 * NOISE * near * pushed) is None


@pytest.mark.parametrize("seed", [0, 1, 4, 5])
@pytest.mark.parametrize("strength", [20.0, 40.0])
def test_a_machine_that_rings_when_recordings_begin_loses_no_samples(seed, strength):
    """At rest, under a disturbance that the first motion ends: louder than elsewhere from the first row on."""
    readings, _ = repeats(seed, 0.0)
    resonance = scipy.signal.butter(1, [0.14, 0.18], btype="bandpass")
    random = np.random.default_rng(seed + 100)
    ringing = scipy.signal.lfilter(*resonance, random.standard_normal((len(readings), ROWS + 500)), axis=1)[:, 500:]
    ringing *= strength * NOISE / ringing.std()
    ringing[:, 60:] = 0.0
    assert held_samples(readings + ringing) is None


def test_one_burst_is_enough():
    readings, _ = repeats(1, 0.0, repeats=4)
    moved = np.abs(np.diff(np.median(readings, axis=0)))
    row = int(np.argmax(np.convolve(moved[100:-100], np.ones(4), "valid"))) + 100
    readings[0, row + 1 : row + 5] = readings[0, row]
    found = held_samples(readings)
    assert found is not None
    assert set(np.argwhere(found.rows)[:, 0]) == {0}


@pytest.mark.parametrize(("channel", "is_lost"), [("imu_x", True), ("position_arm", False)])
def test_a_burst_of_one_reading_that_noise_would_change_stays_though_not_where_the_others_were(channel, is_lost):
    """Two lost samples after a reading at a motion's turn, which noise had put near where the others went: an encoder may have stuck."""
    readings, _ = repeats(18, 0.0, moved=20.0, repeats=3)
    others, row = np.median(readings[1:], axis=0), 487
    assert abs(others[row + 2] - others[row]) > 3.0 * abs(others[row] - others[row - 1])
    readings[0, row] += 0.25 * (others[row + 2] - others[row])
    readings[0, row + 1 : row + 3] = readings[0, row]
    _, lost = without_lost_samples(readings[:, :, None], readings.mean(axis=0)[:, None], (channel,))
    assert bool(lost) is is_lost


@pytest.mark.parametrize("readings_apart", [0.0, NOISE], ids=["two of one reading", "three, of other readings each"])
def test_what_stays_elsewhere_for_less_or_with_noise_of_its_own_is_no_burst(readings_apart):
    readings, _ = repeats(18, 0.0, moved=20.0, repeats=3)
    others, row = np.median(readings[1:], axis=0), 487
    readings[0, row] += 0.25 * (others[row + 2] - others[row])
    last = row + 3 if readings_apart else row + 2
    readings[0, row + 1 : last] = readings[0, row] + readings_apart * np.arange(1, last - row)
    assert held_samples(readings, is_never_still=True) is None


@pytest.mark.parametrize(("between", "found"), [(130, True), (6, False)], ids=["over the recording", "at one time"])
def test_samples_are_lost_at_any_time_and_not_all_at_one(between, found):
    """A motion that begins differently in every repeat stays behind the others' there, and nowhere else."""
    readings, _ = repeats(3, 0.0, repeats=4)
    for burst in range(6):
        row = 200 + between * burst
        readings[burst % 4, row + 1 : row + 4] = readings[burst % 4, row]
    assert (held_samples(readings) is not None) is found


def test_readings_that_run_ahead_are_not_held():
    readings, _ = repeats(1, 0.05)
    assert held_samples(readings) is not None
    assert held_samples(readings[:, ::-1].copy()) is None


def test_two_repeats_say_nothing():
    readings, _ = repeats(2, 0.05)
    assert held_samples(readings[:2]) is None


def test_held_samples_are_named_and_taken_out():
    readings, held = repeats(3, 0.05)
    measured = np.stack([readings, readings + np.random.default_rng(9).standard_normal(readings.shape) * 10.0], axis=2)
    kept, lost = without_lost_samples(measured, measured.mean(axis=0), ("current_arm", "imu_x"))
    assert set(lost) == {"current_arm"}
    assert np.isnan(kept[:, :, 0]).sum() > 0.4 * held.sum()
    assert np.isfinite(kept[:, :, 1]).all()


@pytest.mark.slow
@pytest.mark.parametrize("stiction_N", [0.0, 250.0], ids=["slides", "sticks, and comes free at another time in every repeat"])
@pytest.mark.parametrize("disturbance_N", [10.0, 30.0])
@pytest.mark.parametrize("seed", range(2))
def test_disturbances_that_repeats_do_not_share_are_no_held_samples(stiction_N, disturbance_N, seed):
    wanted = reference(2.0, seed)
    runs = [
        run(wanted, coulomb_N=stiction_N, force_N=disturbance(len(wanted), disturbance_N, 100 * seed + k), noise_seed=k) for k in range(4)
    ]
    for channel in (0, 1):
        assert held_samples(np.stack([one[channel] for one in runs])) is None
