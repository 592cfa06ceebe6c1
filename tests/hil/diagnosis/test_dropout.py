"""Lost samples, seen in recordings whose losses are known."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from hil.diagnosis.recorded.dropout import by_sensor, without_lost_samples
from hil.diagnosis.recorded.stood_alone import stood_alone

CHANNELS = ("link_position_arm", "imu_x", "gyro_x")
ROWS = 4000


def recorded(share, length, channels, seed=0):
    """(R, N, C) noisy channels of which some hold their last reading, and the (N, C) simulation."""
    random = np.random.default_rng(seed)
    time_s = np.arange(ROWS) / 200.0
    simulated = np.column_stack([np.sin(2.0 * np.pi * f * time_s) for f in (1.0, 3.0, 2.0)])
    measured = simulated + 1e-3 * random.standard_normal((3, ROWS, 3))
    for r in range(3):
        for c in channels:
            lost = np.repeat(random.random(ROWS // length) < share, length)
            for k in np.flatnonzero(lost[1:]) + 1:
                measured[r, k, c] = measured[r, k - 1, c]
    return measured, simulated


def test_the_share_that_is_lost_is_measured_and_taken_out():
    measured, simulated = recorded(0.06, 1, [0])
    kept, lost = without_lost_samples(measured, simulated, CHANNELS)
    assert set(lost) == {"link_position_arm"}
    found = lost["link_position_arm"]
    assert found.ci95[0] < 0.06 < found.ci95[1]
    assert found.length == pytest.approx(1.0, abs=0.15)
    repeats = np.diff(measured[:, :, 0], axis=1) == 0.0
    assert np.isnan(kept[:, 1:, 0][repeats]).all()
    assert np.isfinite(kept[:, :, 1:]).all()


def test_bursts_have_their_length():
    _, lost = without_lost_samples(*recorded(0.05, 4, [1]), CHANNELS)
    assert lost["imu_x"].length == pytest.approx(4.0, rel=0.3)


def test_what_an_encoder_repeats_at_rest_is_neither_lost_nor_part_of_a_burst():
    """To and fro on a lattice, at rest for a fifth of the time."""
    random = np.random.default_rng(0)
    phase = np.arange(ROWS) / 800.0 % 1.0
    way = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.clip(phase / 0.8, 0.0, 1.0))
    simulated = np.repeat(way[:, None], 3, axis=1)
    measured = np.round(np.stack([simulated] * 3) / 1e-5) * 1e-5
    drawn = random.random((3, ROWS)) < 0.005
    drawn[:, 0] = False
    for repeat, row in np.argwhere(drawn):
        measured[repeat, row, 0] = measured[repeat, row - 1, 0]
    kept, lost = without_lost_samples(measured, simulated, CHANNELS)
    found = lost["link_position_arm"]
    assert found.ci95[0] < 0.005 < found.ci95[1]
    assert found.length == pytest.approx(1.0, abs=0.1)
    at_rest = np.broadcast_to(phase > 0.81, drawn.shape)
    assert np.isfinite(kept[:, :, 0][at_rest]).all()
    blank = np.isnan(kept[:, :, 0])
    assert not np.any(blank & ~drawn) and blank.sum() > 0.9 * (drawn & ~at_rest).sum()


def test_an_imu_that_loses_samples_is_named_once():
    _, lost = without_lost_samples(*recorded(0.05, 1, [1, 2]), CHANNELS)
    assert set(by_sensor(lost)) == {"imu"}


def test_a_lattice_and_noise_repeat_readings_without_a_loss():
    measured, simulated = recorded(0.0, 1, [])
    coarse = np.round(measured / 5e-3) * 5e-3
    kept, lost = without_lost_samples(coarse, simulated, CHANNELS)
    assert not lost
    np.testing.assert_array_equal(kept, coarse)


def test_a_joint_that_sticks_while_its_simulation_moves_loses_nothing():
    _, simulated = recorded(0.0, 1, [])
    lattice = 1e-5
    stuck = np.round(np.clip(simulated, -0.6, 0.6) / lattice) * lattice
    kept, lost = without_lost_samples(np.stack([stuck] * 3), simulated, CHANNELS)
    assert not lost
    assert np.isfinite(kept).all()


def in_noise(rows=3000, *, count=0.05, runs=(), seed=0):
    """(3, N, 3) of an IMU at rest on a lattice, with (repeat, row, length) of readings that repeat the one before, and the simulation."""
    random = np.random.default_rng(seed)
    measured = np.round(random.standard_normal((3, rows, 3)) / count) * count
    for repeat, row, length in runs:
        measured[repeat, row : row + length, 1] = measured[repeat, row - 1, 1]
    return measured, np.zeros((rows, 3))


RUNS = ((0, 300, 5), (1, 1200, 7), (2, 1500, 2), (2, 2200, 6))


def test_few_losses_show_in_noise_that_repeats_no_reading_so_often_in_a_row():
    measured, simulated = in_noise(runs=RUNS)
    kept, lost = without_lost_samples(measured, simulated, CHANNELS)
    assert set(lost) == {"imu_x"}
    found = lost["imu_x"]
    low, high = found.ci95
    assert low < 20 / 9000 < high
    assert low < found.share < high < 0.02
    assert found.length == pytest.approx(5.0, abs=2.0)
    for repeat, row, length in RUNS:
        assert length < 3 or np.isnan(kept[repeat, row : row + length, 1]).all()
    assert np.isnan(kept).sum() <= 20 + 3


@pytest.mark.parametrize(("length", "held"), [(7, True), (3, False)])
def test_a_single_burst_in_all_recordings_shows_where_noise_would_have_changed_it(length, held):
    """Three in a row come about by themselves in one of many recordings."""
    for seed in range(5):
        print(f"seed {seed}")
        measured, simulated = in_noise(runs=((1, 1200, length),), seed=seed)
        kept, lost = without_lost_samples(measured, simulated, CHANNELS)
        assert set(lost) == ({"imu_x"} if held else set())
        if held:
            low, high = lost["imu_x"].ci95
            assert low < length / 9000 < high < 0.01 and lost["imu_x"].length == length
            assert np.isnan(kept[1, 1200 : 1200 + length, 1]).all() and np.isnan(kept).sum() <= length + 1


@pytest.mark.parametrize(("value", "lost"), [(-1.5, False), (0.0, False), (1.5, False), (0.55, True), (-0.8, True)])
def test_a_single_stay_at_a_limit_or_without_effort_is_no_burst(value, lost):
    measured, simulated = in_noise()
    measured[np.abs(measured) >= 1.5] = np.round(measured[np.abs(measured) >= 1.5] * 6.0) * 0.05
    measured[1, 1200:1208, 1] = value
    assert bool(without_lost_samples(measured, simulated, CHANNELS)[1]) == lost


@pytest.mark.parametrize(("share", "count"), [(0.1, 0.05), (0.1, 0.1), (0.4, 0.05), (0.4, 0.15)])
def test_many_bursts_of_losses_of_a_channel_that_does_not_move_are_measured(share, count):
    """The largest reading of all among them."""
    random = np.random.default_rng(2)
    measured, simulated = in_noise(count=count)
    lost = np.zeros((3, 3000), dtype=bool)
    for r in range(3):
        for k in range(1, 3000):
            lost[r, k] = random.random() < (0.75 if lost[r, k - 1] else 0.25 * share / (1.0 - share))
            if lost[r, k]:
                measured[r, k, 1] = measured[r, k - 1, 1]
    measured[0, 1000:1003, 1] = measured[:, :, 1].max()
    found = without_lost_samples(measured, simulated, CHANNELS)[1]["imu_x"]
    assert found.share == pytest.approx(lost.mean(), rel=0.15)


@pytest.mark.nightly
@pytest.mark.parametrize(("radius", "angle"), [(0.0, 0.0), (0.9, 0.0), (0.9, 1.0), (0.95, 2.7), (0.98, 2.9), (0.9, np.pi)])
def test_noise_alone_loses_nothing_slow_or_fast(radius, angle):
    """Autoregressive, a pair of poles there."""
    for seed in range(20):
        print(f"seed {seed}")
        random = np.random.default_rng(seed)
        poles = [1.0, -2.0 * radius * np.cos(angle), radius**2]
        noise = scipy.signal.lfilter([1.0], poles, random.standard_normal((3, 3000, 3)), axis=1)
        measured = 0.2 * np.round(5.0 * noise / noise.std())
        assert not without_lost_samples(measured, np.zeros((3000, 3)), CHANNELS)[1]


def test_a_reading_that_stands_still_or_at_its_limit_is_not_lost():
    measured, simulated = in_noise()
    standing = measured.copy()
    standing[:, 1000:1400, 1] = 0.15
    limited = np.clip(measured, -1.5, 1.5)
    assert not without_lost_samples(standing, simulated, CHANNELS)[1]
    assert not without_lost_samples(limited, simulated, CHANNELS)[1]


def test_an_encoder_that_repeats_itself_is_at_rest():
    measured, simulated = in_noise(runs=RUNS)
    encoder = measured[:, :, [1, 0, 2]]
    assert not without_lost_samples(encoder, simulated, CHANNELS)[1]


@pytest.mark.nightly
@pytest.mark.parametrize("period", [4, 8, 12, 20, 30, 40, 60, 100])
@pytest.mark.parametrize("quiet", [0.2, 0.3, 0.6])
@pytest.mark.parametrize("around", [0.0, 7.0])
def test_a_channel_that_is_quiet_and_lively_by_turns_loses_nothing(period, quiet, around):
    """Ten counts of noise and a fraction of one, in all repeats in the same rows or in each in its own, about zero or not."""
    for seed in range(4):
        print(f"seed {seed}")
        random = np.random.default_rng(seed)
        together = np.tile(np.arange(3000) % period < 0.65 * period, (3, 1))
        apart = np.repeat(random.random((3, 3000 // period + 1)) < 0.65, period, axis=1)[:, :3000]
        for lively in (together, apart):
            readings = around + np.round(np.where(lively, 10.0, quiet) * random.standard_normal((3, 3000)))
            measured = np.repeat(0.01 * readings[:, :, None], 3, axis=2)
            assert not without_lost_samples(measured, np.zeros((3000, 3)), CHANNELS)[1]


@pytest.mark.parametrize("rows", [slice(0, 20), slice(-20, None), slice(1500, 1510)])
def test_a_stretch_that_is_constant_in_all_repeats_is_not_lost(rows):
    measured, simulated = in_noise()
    measured[:, rows, 1] = 0.15
    assert not without_lost_samples(measured, simulated, CHANNELS)[1]


@pytest.mark.parametrize("rows", [slice(0, 20), slice(-20, None)])
def test_a_sensor_that_begins_late_or_ends_early_in_one_repeat_loses_nothing(rows):
    measured, simulated = in_noise()
    measured[0, rows, 1] = 0.15
    assert not without_lost_samples(measured, simulated, CHANNELS)[1]


@pytest.mark.parametrize("limits", [(-np.inf, np.inf), (-0.7, 0.7)])
def test_a_dead_band_is_not_lost(limits):
    """Nor one between limits, where no value has most of the runs."""
    measured, simulated = in_noise()
    measured[np.abs(measured) < 0.4] = 0.0
    assert not without_lost_samples(np.clip(measured, *limits), simulated, CHANNELS)[1]


def test_a_motion_that_turns_in_little_noise_loses_nothing():
    for seed in range(4):
        print(f"seed {seed}")
        random = np.random.default_rng(seed)
        angle = 2.0 * np.pi * np.arange(3000) / 120.0 + random.uniform(0.0, 2.0 * np.pi, (3, 1))
        readings = np.round(400.0 * np.sin(angle) + 0.4 * random.standard_normal((3, 3000)))
        measured = np.repeat(0.01 * readings[:, :, None], 3, axis=2)
        assert not without_lost_samples(measured, np.zeros((3000, 3)), CHANNELS)[1]


def test_what_has_no_lattice_or_no_second_repeat_says_nothing():
    measured, simulated = in_noise(runs=RUNS)
    assert not without_lost_samples(measured[:1], simulated, CHANNELS)[1]
    smooth = np.random.default_rng(0).standard_normal(measured.shape)
    smooth[0, 700:703, 1] = smooth[0, 699, 1]
    assert not without_lost_samples(smooth, simulated, CHANNELS)[1]


ROWS_QUIET = 2000


def quiet(stays=(), sticks=(), repeats=3, noise=1e-6, offset=0.0, at_rest=None, rate_Hz=200.0, count=5e-6):
    """(R, N) readings of an encoder, and the motion; `stays` (repeat, row, length) are lost. In `sticks` (repeat, row, length) a joint
    stays, and catches up within ten rows. In the rows `at_rest` nothing moves.
    """
    random = np.random.default_rng(7)
    time_s = np.arange(ROWS_QUIET) / rate_Hz
    motion = 0.036 * np.sin(2.0 * np.pi * 0.9 * time_s) + 0.004 * np.sin(2.0 * np.pi * 2.3 * time_s)
    steps = np.diff(motion, prepend=motion[0])
    steps[at_rest if at_rest is not None else slice(0, 0)] = 0.0
    motion = np.cumsum(steps)
    passed = np.stack([motion + offset * r + noise * random.standard_normal(ROWS_QUIET) for r in range(repeats)])
    if at_rest is not None:
        passed[:, at_rest] = passed[:, at_rest][:, :1]
    for repeat, row, length in sticks:
        left = np.clip((np.arange(ROWS_QUIET) - row - length) / 10.0, 0.0, 1.0)
        passed[repeat, row:] += ((1.0 - left) * (passed[repeat, row] - passed[repeat]))[row:]
    readings = count * np.round(passed / count)
    for repeat, row, length in stays:
        readings[repeat, row : row + length] = readings[repeat, row - 1]
    return readings, motion


def lost_of(readings, motion):
    kept, lost = without_lost_samples(readings[:, :, None], motion[:, None], ("position_cart",))
    return np.isnan(kept[:, :, 0]), lost.get("position_cart")


@pytest.mark.parametrize(("repeats", "offset"), [(2, 0.0), (3, 0.0), (2, 1e-3), (4, 1e-3)])
@pytest.mark.parametrize("length", [8, 17])
def test_a_burst_of_one_repeat_shows_where_no_noise_changes_readings(length, repeats, offset):
    """Seventeen readings of an encoder are lost over its turning point, in one of three recordings."""
    rows, found = lost_of(*(made := quiet(stays=((1, 1290, length),), repeats=repeats, offset=offset)))
    expected = np.zeros(made[0].shape, dtype=bool)
    expected[1, 1290 : 1290 + length] = True
    assert np.array_equal(rows, expected)
    assert found.length == length and str(length) in found.seen
    low, high = found.ci95
    assert low < length / rows.size < high < 0.02


@pytest.mark.parametrize("repeats", [3, 8])
def test_a_burst_of_one_repeat_shows_by_coarse_counts_as_well(repeats):
    """Counts a sixth of the largest step: of seven others one or another always stays for a row."""
    found = sum(
        lost_of(*quiet(stays=((1, row, 17),), repeats=repeats, count=2e-4, noise=4e-5))[1] is not None for row in range(100, 1900, 100)
    )
    assert found > 11


def test_a_burst_of_one_repeat_needs_not_all_others_to_move_in_every_row():
    """In each of its rows another one of seven stays."""
    readings, motion = quiet(stays=((1, 1290, 8),), repeats=8)
    for row, other in enumerate((0, 2, 3, 4, 5, 6, 7, 0), start=1290):
        readings[other, row] = readings[other, row - 1]
    rows, _ = lost_of(readings, motion)
    assert np.flatnonzero(rows[1]).tolist() == list(range(1290, 1298)) and not np.delete(rows, 1, axis=0).any()


def test_where_the_others_stand_for_most_of_a_run_none_has_lost_anything():
    """They move in its first two rows of eight."""
    readings, _ = quiet(stays=((0, 1292, 6), (1, 1290, 8), (2, 1292, 6)))
    assert stood_alone(readings) is None


def test_bursts_of_one_repeat_have_their_own_lengths():
    lengths = ((1, 1290, 5), (0, 510, 3), (2, 770, 3))
    rows, found = lost_of(*quiet(stays=lengths))
    assert rows.sum() == 11 and all(rows[repeat, row : row + length].all() for repeat, row, length in lengths)
    assert found.length == pytest.approx(11 / 3) and "3 bursts" in found.seen


@pytest.mark.parametrize("dithers", [False, True])
def test_readings_at_rest_before_a_burst_of_one_repeat_stay(dithers):
    readings, motion = quiet(stays=((1, 1270, 45),), at_rest=slice(1260, 1300))
    readings[0, 1275:1300] += 5e-6 * dithers
    rows, found = lost_of(readings, motion)
    assert np.flatnonzero(rows[1]).tolist() == list(range(1300, 1315)) and found.length == 15


@pytest.mark.parametrize("repeats", [2, 3])
@pytest.mark.parametrize("row", [160, 1000, 1266])
def test_a_joint_that_sticks_in_one_repeat_alone_and_catches_up_loses_nothing(row, repeats):
    readings, motion = quiet(sticks=((1, row, 12),), repeats=repeats)
    assert (np.diff(readings[1, row : row + 12]) == 0.0).all()
    assert lost_of(readings, motion)[1] is None


@pytest.mark.parametrize(
    "made",
    [
        {"stays": ((0, 1290, 17), (1, 1290, 17), (2, 1290, 17))},
        {"stays": ((1, 1290, 17),), "noise": 1e-3},
        {"stays": ((1, 1290, 3),)},
        {"stays": ((1, 129, 4),), "rate_Hz": 20.0},
    ],
    ids=["all repeats stay", "repeats differ by as much", "three readings", "a motion of twenty samples a turn"],
)
def test_what_may_be_something_else_is_no_burst_of_one_repeat(made):
    assert stood_alone(quiet(**made)[0]) is None


@pytest.mark.parametrize("hit", [False, True])
def test_where_a_joint_is_hit_it_may_have_been_as_fast_as_it_comes_back(hit):
    readings, motion = quiet(stays=((1, 1290, 4),))
    readings[:, 600:] += 3e-3 * hit
    assert (lost_of(readings, motion)[1] is None) is hit


def test_a_channel_that_is_read_seldom_for_a_while_in_all_repeats_has_no_burst():
    readings, _ = quiet()
    rows = np.arange(1000, ROWS_QUIET)
    for repeat in range(3):
        readings[repeat, rows] = readings[repeat, rows - (rows + repeat) % 6]
    assert stood_alone(readings) is None


def test_a_repeat_that_ends_elsewhere_than_before_it_stayed_has_lost_nothing():
    """A slip: the others' way is not its own."""
    readings, motion = quiet(stays=((1, 1290, 17),))
    readings[1, 1307:] += 4e-3
    assert lost_of(readings, motion)[1] is None
