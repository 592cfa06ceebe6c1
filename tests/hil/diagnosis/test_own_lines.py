"""Disturbances in a narrow band that only held-out recordings have: drawn here, and on a carriage beside which a pump runs."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from carriage import MACHINE, RATE_Hz, recording, reference, repeats, run

from hil.diagnosis.judging.held_out import HeldOut
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.residuals.own_lines import own_lines, weighted
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN, FreeRuns
from hil.diagnosis.tuning.retune import retune

RATE, ROWS, CHANNELS = 256.0, 2560, 3
SHAPE = (ROWS, CHANNELS)


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(SHAPE)


def pump(centre_Hz: float, rms: float, seed: int = 1, width: float = 0.08) -> np.ndarray:
    """It moves the channels of one axis together."""
    band = scipy.signal.butter(1, [(1.0 - 0.5 * width) * centre_Hz, (1.0 + 0.5 * width) * centre_Hz], btype="bandpass", fs=RATE)
    shaken = scipy.signal.lfilter(*band, np.random.default_rng(seed).standard_normal(ROWS + 4000))[4000:]
    return rms * np.outer(shaken / shaken.std(), [1.0, 0.5, -0.8])


def weights(*sets: np.ndarray, training: np.ndarray | None = None, most: int = 2) -> np.ndarray | None:
    (found,) = own_lines([list(sets)], [[noise(99) if training is None else training]], RATE, most)
    return found


@pytest.mark.parametrize("seed", range(20))
def test_noise_has_no_lines_of_its_own(seed):
    assert weights(noise(seed)) is None


@pytest.mark.parametrize("rms", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("centre_Hz", [3.5, 7.0, 18.0])
def test_a_pump_that_training_did_not_have_counts_by_its_own_power(centre_Hz, rms):
    residual = noise(2) + pump(centre_Hz, rms)
    own = weights(residual)
    frequencies = np.fft.rfftfreq(ROWS, 1.0 / RATE)
    assert np.all(own[np.abs(frequencies / centre_Hz - 1.0) > 0.65] == 1.0)
    assert own[np.argmin(np.abs(frequencies - centre_Hz))] < 0.7
    before, left = np.mean(residual**2), np.mean(weighted(residual, own) ** 2)
    assert before > 1.1
    assert left == pytest.approx(1.0, abs=0.06 + 0.05 * (before - 1.0))


def test_two_pumps_of_two_axes_are_two_bands():
    residual = noise(3) + pump(5.0, 1.0, 4) + pump(14.0, 1.0, 5)
    assert np.mean(weighted(residual, weights(residual)) ** 2) - 1.0 < 0.15 * (np.mean(residual**2) - 1.0)
    assert weights(noise(3) + sum(pump(f, 1.0, 4) for f in (4.0, 7.0, 11.0, 17.0)), most=1) is None  # most of it would be left


def test_what_a_set_of_effects_explains_is_no_disturbance():
    assert weights(noise(2) + pump(7.0, 1.0), noise(2)) is None


def test_what_training_shows_as_well_is_missing_physics():
    residual = noise(2) + pump(7.0, 1.0)
    assert weights(residual, training=noise(6) + pump(7.0, 0.5, 7)) is None
    assert weights(residual, training=noise(6) + pump(12.0, 0.5, 7)) is not None


def test_what_spans_more_than_bands_is_missing_physics():
    assert weights(noise(2) + pump(6.0, 2.0, width=1.2), most=1) is None


def test_what_is_slower_than_floors_shake_is_missing_physics():
    """A load, or a friction of a slow jog that training has at other frequencies."""
    slow = np.sign(np.sin(2.0 * np.pi * 0.5 * np.arange(ROWS) / RATE))
    assert weights(noise(2) + 0.6 * np.outer(slow, np.ones(CHANNELS))) is None
    assert weights(noise(2) + 0.5) is None


def test_a_short_record_has_no_bands():
    rows = 120
    (found,) = own_lines([[noise(2)[:rows] + pump(18.0, 3.0)[:rows]]], [[noise(99)]], RATE, 2)
    assert found is None


def test_a_band_that_training_has_too_is_none_of_the_axes_own():
    shared, own = pump(7.0, 3.0), pump(16.0, 1.0, 5)
    found = weights(noise(2) + shared + own, training=noise(6) + pump(7.0, 1.0, 7), most=1)
    assert found is None  # most of what stands out is the shared one
    strong = weights(noise(2) + 0.3 * shared + 3.0 * own, training=noise(6) + pump(7.0, 1.0, 7), most=1)
    assert strong[np.argmin(np.abs(np.fft.rfftfreq(ROWS, 1.0 / RATE) - 16.0))] < 0.7


def test_weighting_is_linear_and_one_where_nothing_stands_out():
    own = weights(noise(2) + pump(7.0, 2.0))
    a, b = noise(7), noise(8)
    assert weighted(a + 2.0 * b, own) == pytest.approx(weighted(a, own) + 2.0 * weighted(b, own), abs=1e-9)
    assert weighted(a, np.ones(ROWS // 2 + 1)) == pytest.approx(a, abs=1e-12)


def shaken_carriage(seconds: float, centre_Hz: float, experiment: int, seed: int):
    """A carriage with nothing missing, pushed by a pump of 4 N in a band of 8 %."""
    wanted = reference(seconds, experiment)
    band = scipy.signal.butter(1, [0.96 * centre_Hz, 1.04 * centre_Hz], btype="bandpass", fs=RATE_Hz)
    force = scipy.signal.lfilter(*band, np.random.default_rng(seed).standard_normal(len(wanted) + 4000))[4000:]
    quiet = np.random.default_rng(seed + 50).standard_normal(len(wanted))
    return recording(wanted, *run(wanted, force_N=4.0 * force / force.std() + 0.3 * quiet, noise_seed=seed))


def test_a_pump_at_another_frequency_in_the_held_out_recording_is_noise_there():
    """Its misfit is 9 % above what repeats say. It would be 30 % if these lines, a hundredth of all, counted as the others do. Numbers stay
    where they were.
    """
    train = {f"run_{k}": shaken_carriage(4.0, centre, 0, k) for k, centre in enumerate((4.0, 9.0, 11.0, 6.0))}
    held_out = {"other": shaken_carriage(4.0, 16.0, 1, 9)}
    found = mismatch(MACHINE, train)
    sets = {TRAIN: found, HELD_OUT: mismatch(MACHINE, held_out, channels=found.channels, noise=found.noise)}
    with FreeRuns(sets, found.noise) as runs:
        tuning = retune(runs)
        judged = HeldOut(runs, tuning)
        before = judged.follow(tuning.offset, ())
        assert before.misfit > 1.25 * len(before.predicted)
        assert judged.leave_out_own_lines(())
        after = judged.follow(tuning.offset, ())
        assert after.misfit - len(after.predicted) < 0.4 * (before.misfit - len(before.predicted))
        assert np.max(np.abs(after.moved - before.moved)) < 0.1
        assert not judged.leave_out_own_lines(())
        runs.weigh_lines(HELD_OUT, None)  # as for another tuning
        again = HeldOut(runs, tuning)
        assert again.follow(tuning.offset, ()).misfit == pytest.approx(before.misfit)
        assert again.leave_out_own_lines(())


def test_a_held_out_recording_like_the_repeats_is_taken_as_it_is():
    train, held_out = repeats(4, duration_s=2.0), repeats(1, duration_s=2.0, experiment=1)
    found = mismatch(MACHINE, train)
    sets = {TRAIN: found, HELD_OUT: mismatch(MACHINE, held_out, channels=found.channels, noise=found.noise)}
    with FreeRuns(sets, found.noise) as runs:
        judged = HeldOut(runs, retune(runs))
        measured = judged.measured.copy()
        assert not judged.leave_out_own_lines(())
        assert np.array_equal(measured, judged.measured)
