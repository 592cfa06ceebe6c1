"""Noise from repeats, against noise of known spectrum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from carriage import MACHINE, RATE_Hz

from hil.diagnosis.residuals.noise import noise_model, sensor_floor
from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.diagnosis.residuals.whitened import in_noise_units
from hil.machine import load_machine
from hil.simulation import Inputs

CHANNELS = ("command_carriage", "position_carriage")
ROWS = 6000


def coloured(count, seed):
    """(R, N, 2): one disturbance in both channels, and white noise in each."""
    random = np.random.default_rng(seed)
    slow = scipy.signal.lfilter([1.0], [1.0, -0.98], random.standard_normal((count, ROWS + 2000)), axis=1)[:, 2000:]
    lagged = scipy.signal.lfilter([0.05], [1.0, -0.95], slow, axis=1)
    white = random.standard_normal((2, count, ROWS))
    return np.stack([slow + 0.3 * white[0], 1e-6 * (lagged + 0.05 * white[1])], axis=-1)


def group_of(noise):
    rows = noise.shape[1]
    still = np.zeros((rows, 1))
    inputs = Inputs(still, still, still, None, np.zeros(1))
    labels = tuple(f"r{number}" for number in range(len(noise)))
    simulated = np.zeros(noise.shape[1:])
    time_s = np.arange(rows) / RATE_Hz
    return RepeatGroup(labels, MACHINE, inputs, (slice(0, rows),), time_s, noise, simulated, still, still, still, still)


def with_gaps(noise, lost, length, repeats, seed=3):
    """A group of a motion whose simulation is of another machine, its repeats apart by offsets, and what it would be without its gaps."""
    random = np.random.default_rng(seed)
    time_s = np.arange(2000) / RATE_Hz
    motion = np.sin(2.0 * np.pi * time_s * RATE_Hz / 60.0)
    offsets = np.array([0.0, 0.1, 0.3, 0.35])[:repeats, None]
    measured = (motion + offsets + noise * random.standard_normal((repeats, len(motion))))[:, :, None]
    gone = np.zeros(measured.shape, dtype=bool)
    for r, begin in np.argwhere(random.random(measured.shape[:2]) < lost / length):
        gone[r, max(begin, 1) : min(begin + length, len(motion) - 1)] = True
    whole = replace(group_of(measured), simulated=0.95 * motion[:, None])
    return replace(whole, measured=np.where(gone, np.nan, measured)), whole, gone


@pytest.mark.parametrize("repeats", [2, 3, 4])
@pytest.mark.parametrize(("lost", "length"), [(0.03, 1), (0.1, 3), (0.05, 20)])
def test_gaps_are_filled_with_what_was_read_there(repeats, lost, length):
    """By simulation and line alone gaps of 20 rows, a third of a turn, are off by 0.02."""
    group, whole, gone = with_gaps(0.0, lost, length, repeats)
    off = np.abs(group.complete - whole.measured)[gone]
    assert np.median(off) < 1e-3
    assert off.max() < (2e-3 if length < 5 else 0.05), "where all others miss a part of it as well, the line is what there is"


def test_what_was_filled_in_passes_for_no_reading():
    """Gaps that overlap, and a repeat that reads nothing, whichever comes first."""
    _, whole, _ = with_gaps(0.0, 0.0, 1, 3)
    for order in ((0, 1, 2), (2, 1, 0), (1, 2, 0)):
        measured = whole.measured.copy()
        measured[order[0]] = np.nan
        measured[order[1], 100:120] = np.nan
        assert replace(whole, measured=measured).complete[order[1]] == pytest.approx(whole.measured[order[1]], abs=1e-6)
        measured[order[2], 110:130] = np.nan
        straight = replace(whole, measured=measured[[order[1]]]).complete[0]
        assert replace(whole, measured=measured).complete[order[1]] == pytest.approx(straight)


@pytest.mark.parametrize("cut_off", [0.1, 0.03])
def test_slow_noise_of_another_repeat_is_not_followed_over_a_gap(cut_off):
    _, whole, _ = with_gaps(0.0, 0.0, 1, 2)
    random = np.random.default_rng(4)
    slow = scipy.signal.lfilter(*scipy.signal.butter(2, cut_off), random.standard_normal((2, 4000, 1)), axis=1)[:, 2000:]
    measured = np.repeat(whole.simulated[None], 2, axis=0) + slow
    lost = measured.copy()
    for begin in range(50, 1950, 60):
        lost[0, begin : begin + 20] = np.nan
    straight = replace(whole, measured=lost[:1]).complete[0]
    assert replace(whole, measured=lost).complete[0] == pytest.approx(straight, abs=1e-9)


@pytest.mark.parametrize("repeats", [2, 3])
@pytest.mark.parametrize("lost", [0.1, 0.3])
def test_gaps_are_filled_without_the_noise_of_the_others(repeats, lost):
    """Noise is judged by what repeats differ by: what copies another repeat has none."""
    group, whole, _ = with_gaps(1.0, lost, 1, repeats)
    spread = [each - each.mean(axis=0) for each in (group.complete - group.complete.mean(axis=1, keepdims=True), whole.measured)]
    means = [group.complete.mean(axis=0), whole.measured.mean(axis=0)]
    assert np.std(means[0]) < 1.1 * np.std(means[1])
    assert np.std(spread[0]) > 0.85 * np.std(spread[1] - spread[1].mean(axis=1, keepdims=True))


def test_a_first_repeat_that_loses_many_readings_hides_no_bend():
    _, whole, _ = with_gaps(0.0, 0.0, 1, 3)
    random = np.random.default_rng(5)
    measured = whole.measured.copy()
    measured[0, 1:-1][random.random((1998, 1)) < 0.05] = np.nan
    measured[1, 100:160] = np.nan
    for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):
        filled = replace(whole, measured=measured[order]).complete[order.index(1)]
        assert filled == pytest.approx(whole.measured[1], abs=1e-6)


def test_noise_is_what_it_is_around_a_gap():
    """Fifty times as strong in motion as at rest, where most readings are; or one reading of another repeat that is off."""
    _, whole, _ = with_gaps(0.0, 0.0, 1, 2)
    random = np.random.default_rng(6)
    still = np.zeros_like(whole.measured)
    strong = np.where((np.arange(2000) >= 970) & (np.arange(2000) < 1030), 1.0, 0.02)[:, None]
    followed = 0
    for _ in range(20):
        measured = still + strong * random.standard_normal(still.shape)
        lost = measured.copy()
        lost[0, 998:1003] = np.nan
        group = replace(whole, simulated=still[0], measured=lost)
        straight = replace(group, measured=lost[:1]).complete[0]
        followed += not np.allclose(group.complete[0], straight)
    assert followed <= 2
    measured = whole.measured.copy()
    measured[0, 100:120] = np.nan
    measured[1, 400] += 1.0
    assert replace(whole, measured=measured).complete[0] == pytest.approx(whole.measured[0], abs=1e-6)


def test_a_repeat_without_a_channel_reads_what_is_simulated():
    group, *_ = with_gaps(0.1, 0.1, 1, 2)
    measured = group.measured.copy()
    measured[0] = np.nan
    assert replace(group, measured=measured).complete[0] == pytest.approx(group.simulated)


def test_whitened_noise_of_other_repeats_is_white_at_every_frequency():
    model = noise_model([group_of(coloured(4, 0))], CHANNELS, MACHINE)
    powers = []
    for fresh in coloured(12, 1):
        frequencies, lines = model.spectrum(fresh)
        powers.append(np.abs(lines) ** 2)
    power = np.mean(powers, axis=0)
    for low, high in ((0.0, 1.0), (1.0, 5.0), (5.0, 20.0), (20.0, 100.0), (100.0, 500.0)):
        band = (frequencies >= low) & (frequencies < high)
        assert 0.7 < power[band].mean() < 1.5, (low, high)


def test_a_channel_s_density_is_its_own_however_steep():
    """Noise that falls with frequency and noise that rises, against their closed forms averaged over the same lines."""
    random = np.random.default_rng(8)
    filters = ([1.0], [1.0, -0.95]), ([1.0, -1.0], [1.0])

    def read(count):
        rows = [scipy.signal.lfilter(b, a, random.standard_normal((count, ROWS + 500)), axis=1)[:, 500:] for b, a in filters]
        return np.stack([rows[0], rows[1]], axis=-1)

    model = noise_model([group_of(read(40))], CHANNELS, MACHINE)
    lines = np.fft.rfftfreq(ROWS, 1.0 / RATE_Hz)
    for c, (b, a) in enumerate(filters):
        power = np.abs(scipy.signal.freqz(b, a, 2.0 * np.pi * lines / RATE_Hz)[1]) ** 2
        near = [(np.abs(lines - f) < 10.5 * lines[1]) & (lines > 0.0) for f in model.grid_Hz]
        assert model.density[:, c] == pytest.approx([power[each].mean() for each in near], rel=0.3)
    fresh = np.mean([in_noise_units(model, one).power.mean(axis=0) for one in read(12)], axis=0)
    assert fresh == pytest.approx([1.0, 1.0], abs=0.1)


def test_what_rounding_adds_to_a_channel_counts_once():
    """Repeats differ by it already, and the machine's lattice is no second noise beside theirs."""
    (encoder,) = MACHINE.plant.encoders
    random = np.random.default_rng(4)
    place = 0.02 * np.linspace(0.0, 1.0, ROWS)

    def read(count):
        noisy = place + 0.2 * encoder.resolution * random.standard_normal((count, ROWS))
        rounded = encoder.resolution * np.round(noisy / encoder.resolution) - place
        return np.stack([random.standard_normal((count, ROWS)), rounded], axis=-1)

    model = noise_model([group_of(read(4))], CHANNELS, MACHINE)
    power = np.mean([in_noise_units(model, fresh).power.mean(axis=0) for fresh in read(12)], axis=0)
    assert power == pytest.approx([1.0, 1.0], abs=0.1)


def test_a_speed_sensor_is_no_better_than_its_resolution():
    """Rounding is uniform over a step, of which the rms is a twelfth's root."""
    machine = load_machine("laas_anti_cogging")
    (speed,) = machine.plant.speeds
    counted = replace(machine, plant=replace(machine.plant, speeds=(replace(speed, resolution=0.6),)))
    assert sensor_floor((speed.channel,), counted) == pytest.approx([0.6 / np.sqrt(12.0)])


def test_of_a_short_record_that_does_not_fade_nothing_goes_lost_at_its_ends():
    """Of 92 rows the filters reach over the ends of the record: they go around."""
    model = noise_model([group_of(coloured(1, 0))], CHANNELS, MACHINE)
    for fresh in coloured(3, 1)[:, :100]:
        _, lines = model.spectrum(fresh)
        inner = np.sum(np.abs(lines[1:-1]) ** 2)
        whole = 2.0 * inner + np.sum(np.abs(lines[[0, -1]]) ** 2)
        assert np.sum(model.whiten(fresh) ** 2) == pytest.approx(whole)


def test_whitened_channels_are_uncorrelated():
    model = noise_model([group_of(coloured(4, 0))], CHANNELS, MACHINE)
    lines = np.concatenate([model.spectrum(fresh)[1][1:-1] for fresh in coloured(6, 2)])
    coherence = abs(np.mean(lines[:, 0] * lines[:, 1].conj())) / np.sqrt(np.prod(np.mean(np.abs(lines) ** 2, axis=0)))
    assert coherence < 0.15


def test_rms_is_the_noise_s_own_and_its_kind_is_said():
    noise = coloured(4, 3)
    model = noise_model([group_of(noise)], CHANNELS, MACHINE)
    np.testing.assert_allclose(model.std, noise.std(axis=(0, 1)), rtol=0.15)
    assert model.kind == "repeats"
    assert noise_model([group_of(noise[:1])], CHANNELS, MACHINE).kind == "assumed"


def test_a_mean_of_repeats_keeps_what_they_share():
    """White noise, 1 of each repeat and 2 of all of them: of their mean 1 / R + 4, and in units of one repeat's 1 + 4 R."""
    random = np.random.default_rng(7)
    group = group_of(random.standard_normal((4, ROWS, 2)))
    shared = [(group, 2.0 * random.standard_normal((ROWS, 2))) for _ in range(8)]
    model = noise_model([group], CHANNELS, MACHINE, shared)
    fresh = random.standard_normal((ROWS, 2))
    for repeats in (1, 4, 9):
        assert 1.0 / np.mean(model.of_mean(repeats).whiten(fresh) ** 2) == pytest.approx(1.0 + 4.0 * repeats, rel=0.15)
    np.testing.assert_allclose(model.std, np.sqrt(5.0), rtol=0.1)
    alone = noise_model([group], CHANNELS, MACHINE)
    assert alone.of_mean(4) is alone


def test_whitening_is_linear_and_of_unit_variance():
    model = noise_model([group_of(coloured(4, 0))], CHANNELS, MACHINE)
    one, other = coloured(2, 5)
    np.testing.assert_allclose(model.whiten(one + 2.0 * other), model.whiten(one) + 2.0 * model.whiten(other), rtol=1e-8, atol=1e-9)
    assert 0.85 < np.mean(model.whiten(one) ** 2) < 1.15


def ringing(count, seed):
    """(R, N, 2): a disturbance that wanders slowly and rings at 7 Hz in both channels, and white noise in each; rows at 200 Hz."""
    random = np.random.default_rng(seed)
    slow = scipy.signal.lfilter([0.05], [1.0, -0.997], random.standard_normal((count, 5000)), axis=1)
    b, a = scipy.signal.butter(1, [6.7, 7.3], btype="bandpass", fs=200.0)
    both = (slow + 3.0 * scipy.signal.lfilter(b, a, random.standard_normal((count, 5000)), axis=1))[:, 3000:]
    white = random.standard_normal((2, count, 2000))
    return np.stack([both + 0.02 * white[0], 1e-6 * (2.0 * both + 0.1 * white[1])], axis=-1)


def bumps():
    """(B, N, 2) signals of 0.2 and 0.6 s in both channels along the record, its ends among them."""
    rows = np.arange(2000)
    times = [np.exp(-0.5 * ((rows - centre) / width) ** 2) for centre in np.linspace(0, 1999, 15) for width in (20.0, 60.0)]
    return np.stack([np.outer(bump, (1.0, 2e-6)) for bump in times])


def test_noise_is_no_larger_along_signals_at_the_ends_of_a_record_than_elsewhere():
    machine = replace(MACHINE, sample_rate_Hz=200.0)
    ratios = []
    for seed in range(4):
        model = noise_model([group_of(ringing(4, seed))], CHANNELS, machine)
        fresh = np.stack([model.whiten(rows) for rows in ringing(30, 100 + seed)])
        signals = [model.whiten(signal) for signal in bumps()]
        ratios.append([np.mean((fresh @ signal) ** 2) / (signal @ signal) for signal in signals])
    variance = np.mean(ratios, axis=0)
    assert variance.min() > 0.7
    assert variance.max() < 2.5


def test_what_two_channels_have_in_common_is_told_from_what_they_have_not():
    """Two channels read one slow disturbance, each on a lattice: their difference is known to the lattices."""
    step = MACHINE.plant.encoders[0].resolution

    def read(count, seed):
        random = np.random.default_rng(seed)
        both = scipy.signal.lfilter(*scipy.signal.butter(2, 0.02), random.standard_normal((count, ROWS + 2000)), axis=1)[:, 2000:]
        return step * (both[:, :, None] / both.std() + random.uniform(-0.5, 0.5, (count, ROWS, 2)))

    model = noise_model([group_of(read(4, 0))], CHANNELS, MACHINE)
    pairs = [model.spectrum(fresh) for fresh in read(12, 1)]
    slow = np.concatenate([lines[(frequencies > 0.0) & (frequencies < 5.0)] for frequencies, lines in pairs])
    powers = np.linalg.eigvalsh(slow.T @ slow.conj() / len(slow))
    assert powers[0] > 0.5, "a difference of the channels is taken for more noise than it has"
    assert powers[1] < 1.6
