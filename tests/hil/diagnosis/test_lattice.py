"""Lattices coarser than the machine file's, found in drawn readings whose lattice is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from carriage import MACHINE
from carriage import repeats as carriages
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.diagnosis.recorded.lattice import coarser_lattice
from hil.diagnosis.residuals.mismatch import mismatch
from hil.recording import Channel

OWN = 1e-5


def motion(seed, noise, repeats=3, rows=1500):
    """(R, N) a slow motion of about 3000 of the encoder's own steps to and fro, and what repeats differ by."""
    random = np.random.default_rng(seed)
    time_s = np.arange(rows) / 200.0
    moved = 0.03 * np.sin(2.0 * np.pi * random.uniform(0.2, 0.5) * time_s + random.uniform(0.0, 6.0))
    differs = scipy.signal.lfilter(*scipy.signal.butter(1, 0.1), random.standard_normal((repeats, rows)), axis=1)
    return moved + noise * differs / differs.std()


def read(position, step, offset=0.0):
    """On the lattice, then on the encoder's own, as a file keeps it."""
    seen = step * np.floor((position + offset) / step + 0.5) if step else position
    own = OWN * np.floor(seen / OWN + 0.5)
    return np.array([float(f"{value:.9g}") for value in own.ravel()]).reshape(own.shape)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.floats(4.0, 60.0), st.floats(0.0, 1.0), st.floats(0.3, 3.0))
def test_a_lattice_of_any_step_and_offset_is_found(seed, times, offset, share):
    step = times * OWN
    found = coarser_lattice([read(motion(seed, share * step), step, offset)], OWN)
    if share > 1.2:  # its rounding is a fifth of what repeats differ by, or less
        return
    assert found is not None
    assert found.step == pytest.approx(step, rel=1e-4)
    assert found.ci95[0] <= step * (1.0 + 1e-5)
    assert found.ci95[1] >= step * (1.0 - 1e-5)


@pytest.mark.nightly
@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.sampled_from([2.0, 3.0]), st.floats(0.1, 0.9), st.floats(0.0, 1.0), st.floats(0.3, 1.0))
def test_a_lattice_between_counts_is_found_by_the_counts_that_are_never_read(seed, whole, beyond, offset, share):
    step = (whole + beyond) * OWN
    found = coarser_lattice([read(motion(seed, share * step), step, offset)], OWN)
    assert found is not None
    assert found.step == pytest.approx(step, rel=1e-3)
    assert found.ci95[0] <= step <= found.ci95[1]


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.floats(4.1, 4.9), st.integers(8, 300))
def test_readings_next_to_those_of_a_lattice_lie_on_none(seed, times, every):
    """One reading in so many is a count off."""
    seen = read(motion(seed, times * OWN), times * OWN)
    seen[:, every::every] += OWN
    assert coarser_lattice([seen], OWN) is None


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 1e-6, 1e-5, 1e-4]), st.sampled_from([0.0, OWN]))
def test_the_encoders_own_lattice_is_none(seed, noise, step):
    assert coarser_lattice([read(motion(seed, noise), step)], OWN) is None


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.floats(20.0, 400.0))
def test_a_constant_speed_without_noise_is_no_lattice(seed, steps_per_row):
    """Readings are then equally spaced but for the beginning and the turn."""
    random = np.random.default_rng(seed)
    speed = np.concatenate([np.linspace(0.0, 1.0, 60), np.ones(900), np.linspace(1.0, -1.0, 90), -np.ones(900)])
    position = steps_per_row * OWN * np.cumsum(speed) + random.uniform(0.0, 1.0) * OWN
    assert coarser_lattice([read(np.stack([position] * 3), 0.0)], OWN) is None


@pytest.mark.parametrize("counts_per_row", [1.0, 2.0, 3.0, 4.0, 20.0])
@pytest.mark.parametrize("turns", [1, 4])
def test_a_constant_speed_of_whole_counts_is_no_lattice(counts_per_row, turns):
    """Readings are then equally spaced, all of them: a start and the turns say where."""
    there = np.arange(900.0)
    position = counts_per_row * OWN * np.concatenate([there, there[::-1][1:]] * turns)
    assert len(np.unique(position)) > 800
    assert coarser_lattice([read(np.stack([position] * 3), 0.0)], OWN) is None


def test_samples_that_are_missing_are_no_surprise():
    position = 2.0 * OWN * np.arange(1500.0)
    seen = read(np.stack([position] * 3), 0.0)
    seen[:, ::7] = np.nan
    assert coarser_lattice([seen], OWN) is None


def test_a_lattice_far_below_what_repeats_differ_by_is_not_named():
    step, white = 10.3 * OWN, np.random.default_rng(0).standard_normal((3, 1500))
    assert coarser_lattice([read(motion(0, 0.0) + 40.0 * OWN * white, step)], OWN) is None
    assert coarser_lattice([read(motion(0, 0.0) + 10.0 * OWN * white, step)], OWN) is not None


@pytest.mark.parametrize(("slow", "fast", "named"), [(30.0, 0.0, True), (0.0, 1.0, True), (0.0, 8.0, False)])
def test_an_encoder_without_its_last_bit_reads_even_counts_alone(slow, fast, named):
    """However far repeats differ slowly: only what they differ by from sample to sample hides a rounding."""
    random = np.random.default_rng(3)
    way = np.cumsum(scipy.signal.lfilter([0.02], [1.0, -0.98], random.standard_normal((3, 1500)), axis=1), axis=1)
    white = random.standard_normal((3, 1500))
    position = motion(3, 0.0) + OWN * (slow * way / way.std() + fast * white)
    found = coarser_lattice([read(position, 2.0 * OWN)], OWN)
    assert (found is not None) == named
    assert found is None or found.step == pytest.approx(2.0 * OWN, rel=1e-9)
    assert coarser_lattice([read(position, 0.0)], OWN) is None


def test_whole_counts_that_do_not_matter_are_not_named_by_another_rule():
    """Six counts: 0.16 of what fast disturbances would be as white noise, 0.21 of what they are. Eight counts: 0.20 and 0.28."""
    random = np.random.default_rng(5)
    fast = np.diff(np.diff(random.standard_normal((3, 1502)), axis=1), axis=1)
    position = motion(5, 0.0) + 8.0 * OWN * fast / fast.std()
    assert coarser_lattice([read(position, 8.0 * OWN)], OWN) is not None
    assert coarser_lattice([read(position, 6.0 * OWN)], OWN) is None


def test_a_lattice_holds_in_all_recordings_or_is_none():
    coarse, fine = read(motion(1, 10.0 * OWN), 10.0 * OWN), read(motion(2, 10.0 * OWN), 0.0)
    assert coarser_lattice([coarse, coarse], OWN) is not None
    assert coarser_lattice([coarse, fine], OWN) is None


@pytest.mark.parametrize(("times", "amplitude", "named"), [(2.3, 29, False), (2.3, 80, True), (4.5, 86, True)])
def test_few_readings_may_lie_on_a_lattice_by_chance(times, amplitude, named):
    """26 of 2.3 own steps each do with 4e-10 where lattices of 58 counts are 2e5 at most, 70 with 5e-26, 39 of 4.5 with 3e-26."""
    step = times * OWN
    time_s = np.arange(4000) / 200.0
    moved = amplitude * OWN * np.sin(2.0 * np.pi * 0.3 * time_s) + step * np.random.default_rng(4).standard_normal((3, 4000))
    seen = read(np.clip(moved, -amplitude * OWN, amplitude * OWN), step)
    assert len(np.unique(seen)) == pytest.approx(2.0 * amplitude * OWN / step, abs=2.0)
    assert (coarser_lattice([seen], OWN) is not None) == named


@pytest.mark.parametrize(("amplitude", "named"), [(86, False), (800, True)])
def test_few_readings_off_the_encoders_own_counts_may_lie_on_a_lattice_by_chance(amplitude, named):
    """Three of 4.5 own steps are near enough to such a lattice: 39 readings are with 1e-7 and 39 steps were tried, 356 with 1e-63."""
    step = 4.5 * OWN
    time_s = np.arange(4000) / 200.0
    moved = amplitude * OWN * np.sin(2.0 * np.pi * 0.3 * time_s) + step * np.random.default_rng(4).standard_normal((3, 4000))
    seen = read(np.clip(moved, -amplitude * OWN, amplitude * OWN), step)
    seen += 0.1 * OWN * (seen > 0.0)
    assert (coarser_lattice([seen], OWN) is not None) == named


def test_readings_that_a_file_keeps_with_nine_digits_lie_on_their_lattice():
    step = np.pi / 3000.0
    written = read(1000.0 + motion(5, step), step)
    found = coarser_lattice([written], 0.0)
    assert found is not None
    assert found.step == pytest.approx(step, rel=1e-4)


@pytest.mark.parametrize("count", [2, 4])
def test_repeats_of_one_motion_share_a_lattices_rounding_so_their_mean_keeps_it(count):
    step = 2e-5

    def on_steps(recording):
        position = step * np.round(recording["position_carriage"] / step)
        return replace(recording, channels={**recording.channels, "position_carriage": Channel("m", position)})

    found = mismatch(MACHINE, {label: on_steps(run) for label, run in carriages(count, 1.5, disturbance_N=3.0).items()})
    assert set(found.lattices) == {"position_carriage"}
    std = dict(zip(found.channels, found.noise.std, strict=True))["position_carriage"]
    assert std >= np.sqrt(count / 12.0) * step
