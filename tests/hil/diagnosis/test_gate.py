"""What chance gains where an order or a frequency is searched, against noise that is searched, and what two recordings say together."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from hil.diagnosis.judging.gate import (
    ALIKE,
    AS_PREDICTED,
    ERROR_FREEDOM,
    HELD_OUT_LEVEL,
    IN_SAMPLE,
    LEVEL,
    PRIOR_FREEDOM,
    PRIOR_VARIANCE,
    SHORT,
    SIMULATOR_ERROR,
    TAIL_FREEDOM,
    Gate,
    Scatter,
    chance_held_out,
    chance_of_both,
    chance_of_gain,
    expected_by_chance,
    needed_gain,
)
from hil.diagnosis.judging.placebos import Beside
from hil.diagnosis.starting.start_waves import ONE_HARMONIC, TWO_HARMONICS
from hil.diagnosis.tuning.free_run import TRAIN

ROWS, PADDED = 128, 2048
DRAWS = 12000


def largest_gains(harmonics: int) -> np.ndarray:
    """(DRAWS,) energy of white noise along the best wave of a fine search over frequency, and how many cycles it spans."""
    random = np.random.default_rng(3)
    found = []
    for _ in range(DRAWS // 2000):
        lines = np.fft.rfft(random.standard_normal((2000, ROWS)), PADDED, axis=1)
        energy = 2.0 * np.abs(lines) ** 2 / ROWS
        low, high = 2 * PADDED // ROWS, PADDED // 2 // harmonics - PADDED // ROWS
        own = energy[:, low:high]
        found.append((own + (energy[:, 2 * low : 2 * high : 2] if harmonics == 2 else 0.0)).max(axis=1))
    return np.concatenate(found)


def trials(harmonics: int) -> float:
    """As `starts.shapes_of` counts them: range of the wave number times the rms of what it is a wave over."""
    low, high = 2 * PADDED // ROWS, PADDED // 2 // harmonics - PADDED // ROWS
    return (ONE_HARMONIC, TWO_HARMONICS)[harmonics - 1] * 2.0 * np.pi * (high - low) / PADDED * float(np.std(np.arange(ROWS)))


@pytest.mark.parametrize("harmonics", [1, 2])
def test_the_best_of_all_frequencies_passes_by_chance_as_often_as_asked(harmonics):
    needed = needed_gain(trials(harmonics), 2 * harmonics + 1, 0.0, 0)
    assert np.mean(largest_gains(harmonics) > needed) == pytest.approx(LEVEL, rel=0.35)
    uncounted = needed_gain(1, 2 * harmonics + 1, 0.0, 0)
    assert np.mean(largest_gains(harmonics) > uncounted) > 10.0 * LEVEL


def test_noise_above_the_model_asks_for_more_and_noise_below_it_for_no_less():
    assert needed_gain(50, 1, 2000.0, 1000) == pytest.approx(2.0 * needed_gain(50, 1, 1000.0, 1000))
    assert needed_gain(50, 1, 500.0, 1000) == needed_gain(50, 1, 1000.0, 1000)


def test_no_gain_below_the_simulator_s_own_error_counts():
    assert needed_gain(1, 1, 0.0, 10**6) == SIMULATOR_ERROR * 10**6


def recorded(repeats: list[np.ndarray], channels: int = 1, rate_Hz: float = 10.0) -> SimpleNamespace:
    """Runs with these whitened repeats (M,) of one experiment."""
    sets = {TRAIN: SimpleNamespace(channels=("a",) * channels)}
    return SimpleNamespace(repeats=lambda name: [repeats], sets=sets, noise=SimpleNamespace(rate_Hz=rate_Hz))


@pytest.mark.parametrize(("louder", "expected"), [(1.0, 1.0), (3.0, 9.0)])
def test_noise_that_is_louder_where_a_response_is_scatters_more_along_it_however_small_the_strengths_are(louder, expected):
    """Three repeats of 1000 rows, louder in a fifth of them, where the response is. Along it they happen to be the same."""
    random = np.random.default_rng(3)
    response = np.zeros((1000, 2))
    response[400:600, 0] = random.standard_normal(200)
    response /= np.linalg.norm(response)
    found = []
    for _ in range(20):
        noise = random.standard_normal((3, 1000, 2)) * np.sqrt(IN_SAMPLE)
        noise[:, 400:600] *= louder
        noise -= np.einsum("rij,ij->r", noise, response)[:, None, None] * response
        found.append(Scatter(recorded([row.ravel() for row in noise], channels=2, rate_Hz=40.0)).along(response.ravel()))
    assert np.mean(found) == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize(("rows", "freedom"), [(12, 2.0), (120, 20.0), (1200, 200.0)])
def test_what_comes_once_is_known_by_the_stretches_it_is_spread_over(rows, freedom):
    """Three repeats of 1200 rows at 40 Hz: twice as many degrees of freedom as stretches of 0.3 s, and the prior's."""
    random, response = np.random.default_rng(5), np.zeros((1200, 2))
    response[:rows] = 1.0
    runs = recorded([row.ravel() for row in random.standard_normal((3, 1200, 2))], channels=2, rate_Hz=40.0)
    assert Scatter(runs).known_along(response.ravel()).freedom == pytest.approx(min(PRIOR_FREEDOM + freedom, TAIL_FREEDOM))
    assert chance_of_gain(60.0, 3, 1.0, PRIOR_FREEDOM + 2.0) > 1e3 * chance_of_gain(60.0, 3, 1.0)


def test_of_several_experiments_the_one_counts_that_shows_the_response():
    """Five times as loud in one second of the first, where the response is; hardly any of it in the quiet minute of the second."""
    random = np.random.default_rng(4)
    shown = np.zeros(400)
    shown[200:240] = random.standard_normal(40)
    faint = random.standard_normal(2400)
    response = np.concatenate([shown / np.linalg.norm(shown), 0.12 * faint / np.linalg.norm(faint)])
    found = []
    for _ in range(30):
        one, other = random.standard_normal((3, 400)), random.standard_normal((3, 2400))
        one[:, 200:240] *= 5.0
        one -= np.outer(one @ response[:400], response[:400])
        sets = {TRAIN: SimpleNamespace(channels=("a",))}
        runs = SimpleNamespace(repeats=lambda name: [list(one), list(other)], sets=sets, noise=SimpleNamespace(rate_Hz=40.0))  # noqa: B023
        found.append(IN_SAMPLE * Scatter(runs).along(response))
    assert np.mean(found) > 10.0


@pytest.mark.parametrize("size", [0.2, 2.0, 6.0])
def test_the_scatter_along_a_response_is_the_variance_expected_after_the_repeats_were_seen(size):
    response = np.array([0.0, 3.0, 4.0])
    along = size * np.array([1.0, -0.5, -0.5])
    runs = recorded([np.array([9.0, 0.0, 0.0]) + a * response / 5.0 for a in along])
    seen = float(along @ along) / IN_SAMPLE

    def weight(variance):
        prior = scipy.stats.chi2.pdf(PRIOR_FREEDOM * PRIOR_VARIANCE / variance, PRIOR_FREEDOM) / variance**2
        return prior * scipy.stats.chi2.pdf(seen / variance, len(along) - 1) / variance

    mean, whole = (scipy.integrate.quad(lambda v, k=k: v**k * weight(v), 0.0, np.inf)[0] for k in (1, 0))
    assert Scatter(runs).along(response) == pytest.approx(max(1.0, mean / whole), rel=1e-3)


def test_without_repeats_the_noise_model_stands_alone():
    runs = recorded([np.array([1.0, 2.0])])
    assert Scatter(runs).along(np.array([1.0, 0.0])) == 1.0


@pytest.mark.parametrize(("tried", "asked"), [(10, 8), (60, 11), (1000, 8)])
def test_where_there_is_nothing_one_of_all_sets_comes_through_both_as_often_as_asked(tried, asked):
    random = np.random.default_rng(5)
    rounds = 40000 if tried < 200 else 10000
    best = np.sort(np.partition(random.random((rounds, tried)), asked - 1, axis=1)[:, :asked], axis=1)  # those asked about held out
    held_out = random.random(best.shape)
    for level in (0.01, 0.1):
        x = np.minimum(tried * best, asked) * held_out
        worth = x < 2.0 * level  # no chance is less than twice its x
        passed = [any(chance_of_both(tried * t, h, asked) < level for t, h in zip(best[n][worth[n]], held_out[n][worth[n]], strict=True))
                  for n in np.flatnonzero(worth.any(axis=1))]  # fmt: skip
        assert 0.75 * level < sum(passed) / rounds < 1.15 * level


@pytest.mark.parametrize(("trained", "followed", "asked"), [(0.02, 1e-3, 8), (3.0, 1e-4, 8), (400.0, 1e-5, 11)])
def test_the_chance_of_both_counts_all_sets_that_come_as_far(trained, followed, asked):
    """Drawn above; here integrated. A set beyond those asked about counts as the last of them."""
    x = min(trained, asked) * followed
    as_far = scipy.integrate.quad(lambda u: min(1.0, x / u), 0.0, asked, points=[x])[0]
    assert chance_of_both(trained, followed, asked) == pytest.approx(as_far + x, rel=1e-6)


def test_what_repeats_say_of_the_noise_along_a_response_widens_what_chance_gains_in_both():
    assert chance_of_gain(30.0, 2, 2.0) == pytest.approx(chance_of_gain(15.0, 2, 1.0))
    assert chance_held_out(30.0, 2.0) == pytest.approx(chance_held_out(15.0, 1.0))


@pytest.mark.parametrize(("trials", "gain", "erring"), [(50.0, 60.0, 4.0), (300.0, 100.0, 4.0), (30.0, 1000.0, 100.0), (300.0, 50.0, 1.0)])
def test_what_noise_and_an_error_of_unknown_size_gain_together_is_no_rarer_than_said(trials, gain, erring):
    """Drawn: sets of one number each in noise, and among them ALIKE whose responses are along one error besides."""
    random = np.random.default_rng(5)
    error = np.sqrt(erring) * random.standard_t(ERROR_FREEDOM, 100_000)

    def noise(sets: int) -> np.ndarray:
        return random.standard_normal((sets, len(error))) / np.sqrt(random.chisquare(TAIL_FREEDOM, (sets, len(error))) / TAIL_FREEDOM)

    of_noise = (trials - ALIKE) * scipy.stats.f.sf(gain, 1, TAIL_FREEDOM)
    drawn = of_noise + ALIKE * float(np.mean((noise(int(ALIKE)) + error) ** 2 > gain))
    assert 0.9 * drawn < expected_by_chance(trials, gain, 1, 1.0, erring) < 4.0 * drawn


def test_an_error_of_equations_is_not_searched():
    """A ripple that gains 505 beside a compliance whose equation errs by 25 along it, as one of 60 000 sets with five numbers."""
    assert expected_by_chance(6e4, 505.0, 5, 1.5, 25.0) < 0.2
    assert expected_by_chance(6e4, 505.0, 5, 1.5, 500.0) > 2.0
    assert expected_by_chance(1e12, 2000.0, 5, 1.5, 1e5) == pytest.approx(ALIKE, rel=0.1)
    assert expected_by_chance(100.0, 30.0, 2, 1.5, np.inf) == 100.0


def test_without_errors_of_equations_noise_alone_gains_by_chance():
    assert expected_by_chance(100.0, 30.0, 2, 1.5, 0.0) == 100.0 * chance_of_gain(30.0, 2, 1.5)
    assert expected_by_chance(100.0, 3.0, 2, 1.5, 1e-9) == pytest.approx(100.0 * chance_of_gain(3.0, 2, 1.5), rel=1e-3)
    assert expected_by_chance(100.0, -3.0, 2, 1.5, 5.0) == 100.0


def test_the_tail_of_a_gain_is_that_of_a_variance_known_with_few_degrees_of_freedom():
    assert scipy.stats.chi2.sf(20.0, 1) < 0.2 * chance_of_gain(20.0, 1, 1.0)
    assert chance_of_gain(1.0, 3, 1.0) == pytest.approx(scipy.stats.chi2.sf(1.0, 3), rel=0.02)


def test_three_deviations_held_out_come_five_times_as_often_as_of_a_normal_law():
    """As those of sets fitted where nothing is hidden: 0.5 % of them beyond 2.5, the farthest of 185 at 3.5."""
    assert chance_held_out(9.0, 1.0) == pytest.approx(5.0 * scipy.stats.norm.sf(3.0), rel=0.2)


def test_held_out_recordings_that_fit_worse_confirm_nothing():
    assert chance_held_out(-3.0, 1.0) == 1.0


def gate(trained: float, followed: float | None) -> Gate:
    return Gate(
        gain=30.0,
        needed=20.0,
        scatter=1.0,
        trained=trained,
        over_simulator=5.0,
        asked=8,
        held_out_deviations=None if followed is None else 8.0,
        held_out_gain=None if followed is None else 25.0,
        followed=followed,
        placebo_gain=3.0,
        share=0.5,
        is_first=True,
    )


def test_what_training_shows_weakly_and_another_motion_strongly_is_there():
    assert gate(0.3, 1e-4).passed
    assert gate(0.3, 0.015).passed
    assert not gate(0.3, 0.02).passed
    assert gate(1e-9, 0.049).passed
    assert not gate(1e-9, 0.051).passed  # training alone does not do where a held-out recording does not agree
    assert not gate(0.3, None).passed
    assert gate(1e-3, None).passed


def test_beside_another_effect_training_must_show_it_too():
    one = gate(3.0, 1e-7)
    assert one.passed
    assert not Gate(**{**vars(one), "is_first": False}).passed


def test_beside_another_effect_both_motions_together_must_show_it_twice_as_surely():
    for followed, passes in ((0.007, True), (0.012, False)):
        assert gate(0.3, followed).passed
        assert Gate(**{**vars(gate(0.3, followed)), "is_first": False}).passed is passes


def test_a_gain_that_the_simulator_s_own_error_may_be_is_none():
    one = gate(1e-6, 1e-6)
    assert one.passed
    assert not Gate(**{**vars(one), "over_simulator": 0.9}).passed


@pytest.mark.parametrize(
    ("placebo", "effect", "passes"), [(1.0, 21.0, True), (15.0, 21.0, False), (1.0, 19.0, False)], ids=["stands", "no better", "too little"]
)
def test_a_gain_that_a_placebo_has_by_its_likeness_must_show_beside_it(placebo, effect, passes):
    """It needs 20 to show."""
    one = {**vars(gate(1e-6, 1e-6)), "placebo_gain": 21.0}
    assert not Gate(**one).passed
    assert Gate(**one | {"beside": Beside(placebo, effect)}).passed is passes


def test_a_gain_that_a_response_run_backwards_nearly_has_is_none():
    one = gate(1e-6, 1e-6)  # it gains 30
    assert Gate(**{**vars(one), "placebo_gain": 19.0}).passed
    assert not Gate(**{**vars(one), "placebo_gain": 21.0}).passed
    followed = {**vars(one), "placebo_gain": 21.0, "held_out_gain": 32.0}
    assert Gate(**followed).passed  # nothing was searched there
    assert not Gate(**followed | {"held_out_beyond": 30.0}).passed
    assert not Gate(**followed | {"followed": 1.0, "trained": 1e-9}).passed
    assert not Gate(**followed | {"trained": 1e-9}).training_shows_something


def test_a_first_effect_explains_a_share_and_a_further_one_need_not():
    one = gate(1e-6, 1e-6)
    assert Gate(**{**vars(one), "share": 0.021}).passed
    assert not Gate(**{**vars(one), "share": 0.019}).passed
    assert Gate(**{**vars(one), "share": 0.001, "is_first": False}).passed


def test_of_a_gain_what_chance_gains_more_where_repeats_scatter_is_not_certain():
    one = gate(1e-6, 1e-6)  # chance gains 20 where they do not
    assert one.certain_gain == 30.0
    assert Gate(**{**vars(one), "gain": 100.0, "scatter": 2.0}).certain_gain == pytest.approx(80.0)
    assert Gate(**{**vars(one), "scatter": 2.0}).certain_gain == pytest.approx(15.0)


@pytest.mark.parametrize(
    ("predicted", "seen", "passes"),
    [
        (0.0, 0.0, True),  # nothing of it would show
        (1.0, -0.5, True),  # too short to be confirmed by anything
        (3.0, 1.5, True),  # no more behind than noise is
        (3.0, 0.4, False),
        (4.5, 1.9, False),
        (6.0, 4.1, True),  # followed by itself
        (6.0, 3.1, False),  # a recording that would show it shows half of it
    ],
)
def test_held_out_recordings_that_show_little_of_an_effect_need_only_show_as_much_as_was_predicted(predicted, seen, passes):
    followed = chance_held_out(2.0 * predicted * seen - predicted**2, 1.0)
    one = Gate(**{**vars(gate(1e-5, followed)), "predicted": predicted, "seen": seen})
    assert one.passed is passes
    assert not Gate(**{**vars(one), "trained": 0.3, "followed": max(followed, 0.06)}).passed  # it is there by both chances together


@pytest.mark.parametrize(("held_out_gain", "passes"), [(-9.0, True), (-19.0, True), (-21.0, False), (-250.0, False)])
def test_what_leaves_more_of_held_out_recordings_than_chance_gains_does_not_agree_with_them(held_out_gain, passes):
    """Errors of the first effect may make what was predicted small beside what they do; the rise is in units of noise."""
    agreeing = Gate(**{**vars(gate(1e-5, 1.0)), "predicted": 2.0, "seen": 0.2, "needed": 20.0})
    assert Gate(**{**vars(agreeing), "held_out_gain": held_out_gain}).passed is passes
    assert Gate(**{**vars(agreeing), "held_out_gain": -250.0, "held_out_beyond": held_out_gain}).passed is passes
    assert Gate(**{**vars(agreeing), "held_out_gain": 2.0 * held_out_gain, "scatter": 2.0}).passed is passes


def test_what_another_motion_cannot_confirm_must_be_certain_in_training():
    """One in a thousand."""
    agreeing = Gate(**{**vars(gate(9e-4, 0.3)), "predicted": 2.0, "seen": 1.2})
    assert agreeing.passed
    assert not Gate(**{**vars(agreeing), "trained": 1.1e-3}).passed


@pytest.mark.parametrize(
    ("trained", "beyond", "passes"),
    [(9e-4, 1.0, True), (1.1e-3, 1.0, False), (9e-4, 0.8, False), (1.1e-4, 0.8, False), (9e-5, 0.8, True)],
)
def test_beside_others_what_an_error_of_theirs_may_explain_must_be_more_certain(trained, beyond, passes):
    """What their equations err by looks like effects that are not there."""
    second = vars(gate(trained, 0.3)) | {"predicted": 2.0, "seen": 1.2, "is_first": False}
    assert Gate(**second | {"beyond": beyond * second["gain"]}).passed is passes
    assert Gate(**second | {"beyond": None}).passed is (trained < 1e-4)
    assert Gate(**second | {"is_first": True, "beyond": beyond * second["gain"]}).passed is (trained < 1e-3)


@pytest.mark.parametrize(
    ("change", "shows"),
    [
        ({}, True),
        ({"trained": 1.1e-6}, False),
        ({"placebo_gain": 21.0}, False),  # of 30
        ({"over_simulator": 0.9}, False),
        ({"share": 0.01}, False),
    ],
)
def test_what_training_shows_beyond_any_chance_is_something_though_no_held_out_recording_follows_it(change, shows):
    one = Gate(**{**vars(gate(0.9e-6, 1.0)), **change})
    assert not one.passed
    assert one.training_shows_something is shows


@pytest.mark.parametrize("predicted", [SHORT, 6.5, 10.0])
def test_where_enough_is_predicted_what_agrees_is_followed_as_well(predicted):
    seen = predicted - AS_PREDICTED
    assert chance_held_out(2.0 * predicted * seen - predicted**2, 1.0) < HELD_OUT_LEVEL


def test_what_only_agrees_is_said_to_be_no_confirmation():
    one = Gate(**{**vars(gate(1e-5, 0.3)), "predicted": 2.0, "seen": 1.2})
    for_it, _ = one.evidence()
    assert any("1.2 standard deviations of it where 2 were predicted; too little to confirm it" in text for text in for_it)
