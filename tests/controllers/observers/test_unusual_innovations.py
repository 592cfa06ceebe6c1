"""Claims: means of whitened innovations that leave what is usual raise the alarm, at any window; corrections then do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_models import DenseModel, drawn_rows, small_model, small_noise

from controllers.errors import DesignError
from controllers.observers.consistency import CorrectionMonitor, WINDOWS_s, is_unusual, means
from controllers.observers.modal_observer import ModalObserver
from controllers.observers.settings import ObserverNoise

RATE_Hz, ROWS = 256.0, 400


def whitened_and_alarms(noise: ObserverNoise, measured: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    observer, rows, alarms = ModalObserver(small_model(), noise), [], []
    for k in range(len(measured)):
        observer.step_measured(measured[k], commands[max(k - 1, 0)])
        rows.append(observer.memory.whitened.copy())
        alarms.append(observer.estimate[-1] > 0.5)
    return np.array(rows), np.array(alarms)


@pytest.mark.slow
def test_the_compiled_alarm_is_that_of_the_means_which_a_design_is_held_to() -> None:
    measured, commands, _ = drawn_rows(DenseModel(small_model(), small_noise()), small_noise(), ROWS, seed=5)
    measured[0] = measured[20:30] = measured[50:60, 4:] = np.nan
    measured[200:, 2:4] += 2e-5
    rate_Hz = small_model().sample_rate_Hz
    rows, _ = whitened_and_alarms(small_noise(), measured, commands)
    nis = np.nansum(rows**2, axis=1)
    observer = ModalObserver(small_model(), small_noise())
    for k in range(ROWS):
        observer.step_measured(measured[k], commands[max(k - 1, 0)])
        assert observer.estimate[-4] == pytest.approx(nis[k], rel=1e-9, abs=1e-12), "whitened innovations have NIS for their square"
    sizes = np.sum(means(rows, rate_Hz) ** 2, axis=2)
    usual = np.full((len(WINDOWS_s), measured.shape[1]), 1.0) * np.max(sizes[:200], axis=0)[:, None] * 1.001
    again, alarms = whitened_and_alarms(replace(small_noise(), usual=usual), measured, commands)
    assert np.array_equal(rows, again, equal_nan=True)
    expected = (np.sum(means(rows, rate_Hz) ** 2 / usual, axis=2) > 1.0).any(axis=1)
    assert np.array_equal(alarms, expected)
    assert not alarms[:200].any()
    assert alarms[200:].any()


def test_a_weak_lasting_pull_is_seen_by_the_long_window_alone_and_a_jump_by_the_short_one_first() -> None:
    generator = np.random.default_rng(3)
    white = generator.standard_normal((round(60 * RATE_Hz), 16))
    usual = np.full((len(WINDOWS_s), 16), 58.0)  # one in 1e6 of chi-square with 16 degrees
    assert not (np.sum(means(white, RATE_Hz) ** 2 / usual, axis=2) > 1.0).any()
    pulled = np.sum(means(white + 0.06, RATE_Hz) ** 2 / usual, axis=2) > 1.0
    assert pulled[:, 2].any()
    assert not pulled[:, 0].any()
    jumped = white + 0.6 * (np.arange(len(white)) >= 5120)[:, None]
    first = [int(np.argmax(window)) for window in (np.sum(means(jumped, RATE_Hz) ** 2 / usual, axis=2) > 1.0).T]
    assert 5120 <= first[0] < first[2] < 5120 + RATE_Hz


def test_a_gap_in_the_measurements_tells_nothing_new_and_after_two_windows_a_silent_channel_is_forgotten() -> None:
    monitor = CorrectionMonitor(usual=np.full((len(WINDOWS_s), 2), 20.0), rate_Hz=RATE_Hz)
    raised = [is_unusual(monitor.recent, np.array([1.0, np.nan])) for _ in range(64)]
    assert raised[-1]
    assert not raised[0]
    silent = [is_unusual(monitor.recent, np.full(2, np.nan)) for _ in range(round(30 * RATE_Hz))]
    assert silent == [k < 2 * WINDOWS_s[-1] * RATE_Hz for k in range(len(silent))]
    monitor.reset()
    assert not is_unusual(monitor.recent, np.array([1.0, np.nan]))


def test_what_a_silent_channel_showed_does_not_outlive_it_beside_others_and_its_return_begins_anew() -> None:
    """A minute and a half of silence makes its weights so small that they cannot be divided by: no window goes blind."""
    generator = np.random.default_rng(4)
    rows = generator.standard_normal((round(150 * RATE_Hz), 2))
    rows[: round(5 * RATE_Hz), 1] += 3.0
    lost, back = round(5 * RATE_Hz), round(140 * RATE_Hz)
    rows[lost:back, 1] = np.nan
    rows[back - 400 : back - 300, 0] = np.nan  # a shorter gap is carried over
    usual = np.array([[60.0, 60.0], [60.0, 60.0], [60.0, 1e-6 * 60.0]])
    monitor = CorrectionMonitor(usual=usual, rate_Hz=RATE_Hz)
    alarms, forgotten = np.array([is_unusual(monitor.recent, row) for row in rows]), lost + round(2 * WINDOWS_s[-1] * RATE_Hz)
    found = means(rows, RATE_Hz)
    assert np.array_equal(alarms, (np.sum(found**2 / usual, axis=2) > 1.0).any(axis=1))
    assert alarms[lost:forgotten].all()
    assert not alarms[forgotten:back].any()
    assert found[back, :, 1] == pytest.approx(rows[back, 1], rel=1e-12)
    assert alarms[back:].any()


def test_an_observer_that_adapts_modes_compares_corrections_as_what_is_usual_was_seen_without() -> None:
    measured, commands, _ = drawn_rows(DenseModel(small_model(), small_noise()), small_noise(), 60, seed=5)
    usual = np.full((len(WINDOWS_s), measured.shape[1]), 1e-6)
    for adapted, share in (((), 1.0), ((0,), 0.0)):
        observer = ModalObserver(small_model(), replace(small_noise(adapted_walk=1e-3), usual=usual), adapted=adapted)
        alarms = []
        for k in range(len(measured)):
            observer.step_measured(measured[k], commands[max(k - 1, 0)])
            alarms.append(observer.estimate[-1])
        assert np.mean(alarms) == share


def test_a_table_of_what_is_usual_that_does_not_fit_is_refused() -> None:
    for usual in (np.ones((3, 2)), np.zeros((3, 10))):
        with pytest.raises(DesignError, match="usual must be 3 times"):
            ModalObserver(small_model(), replace(small_noise(), usual=usual))


def test_an_alarm_lasts_when_it_outlasts_twice_its_own_window() -> None:
    """A push is forgotten by then: the long window's alarm of eight seconds is no sign of a false model yet, the short one's is."""
    large = np.full((len(WINDOWS_s), 1), 1e9)
    for w, window_s in enumerate(WINDOWS_s):
        usual = large.copy()
        usual[w] = 1e-9
        monitor = CorrectionMonitor(usual=usual, rate_Hz=RATE_Hz)
        lasting = [(is_unusual(monitor.recent, np.ones(1)), monitor.is_lasting)[1] for _ in range(round(2.5 * window_s * RATE_Hz))]
        assert sum(not lasts for lasts in lasting) == round(2.0 * window_s * RATE_Hz)
        assert lasting[-1]
    corrections = CorrectionMonitor()
    lasting = [(corrections.step(np.full(9, 9.0), np.ones(9)), corrections.is_lasting)[1] for _ in range(200)]
    assert sum(not lasts for lasts in lasting) == 128
    corrections.reset()
    assert not corrections.is_lasting
