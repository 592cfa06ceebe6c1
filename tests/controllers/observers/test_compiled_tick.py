"""Claims: what a tick computes in compiled code is, to the last digit, the laws as NumPy writes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_models import DenseModel, drawn_rows, small_model, small_noise
from scipy.stats import norm

from controllers.damping import LIMIT_SHARE, SLEW, DampingSettings, ModalDamping
from controllers.filtering.square_root import triangularise
from controllers.observers.consistency import FALSE_ALARM, WINDOW
from controllers.observers.modal_observer import ModalObserver

ROWS = 200


class NumpyMonitors:
    """Mean normalised innovation over the window, and the alarm, as NumPy writes them."""

    def __init__(self) -> None:
        self.nis, self.measured = np.zeros(WINDOW), np.zeros(WINDOW)
        self.total, self.variance = np.zeros(9), np.zeros(9)
        self.row = 0

    def step(self, nis: float, measured: float, corrected: np.ndarray) -> tuple[float, bool]:
        """Mean and alarm of a row."""
        self.nis[self.row % WINDOW], self.measured[self.row % WINDOW] = nis, measured
        self.row += 1
        kept = np.exp(-1.0 / WINDOW)
        self.total = self.total * kept + corrected[0]
        self.variance = self.variance * kept**2 + corrected[1]
        sizes, spreads = (self.total**2).reshape(3, 3).sum(axis=1), self.variance.reshape(3, 3).sum(axis=1)
        freedom = self.measured.sum()
        mean = self.nis.sum() / freedom if freedom else np.nan
        return mean, bool((sizes > norm.isf(0.5 * FALSE_ALARM) ** 2 * spreads).any())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["kf", "ukf"])
def test_a_samples_consistency_is_what_numpy_makes_of_innovations_and_corrections(kind: str) -> None:
    measured, commands, _ = drawn_rows(DenseModel(small_model(), small_noise()), small_noise(), ROWS, seed=5)
    measured[0] = measured[20:30] = measured[50:60, 4:] = np.nan
    measured[100:, 2:4] += 1e-3  # so that the alarm is raised, too
    observer = ModalObserver(small_model(), small_noise(), kind)  # type: ignore[arg-type]
    monitors, alarms = NumpyMonitors(), []
    for k in range(ROWS):
        observer.step_measured(measured[k], commands[max(k - 1, 0)])
        nis, count, mean, alarm = observer.estimate[-4:]
        assert count == np.isfinite(measured[k]).sum()
        expected = monitors.step(nis, count, observer.memory.corrected)
        assert np.array_equal((mean, bool(alarm)), expected, equal_nan=True), f"row {k}"
        alarms.append(alarm)
    assert not any(alarms[:100])
    assert any(alarms[100:])


@pytest.mark.slow
def test_the_damping_of_a_row_is_the_law_limited_slewed_and_ramped() -> None:
    model = replace(small_model(), effort_step=np.array([0.01, 0.0]))
    observer = ModalObserver(model, small_noise())
    observer.linearised(np.zeros(2))
    damping = ModalDamping(observer, DampingSettings(0.2))
    limit = LIMIT_SHARE * model.effort_limit
    slew = SLEW * 2.0 * np.pi * float(model.frequencies_Hz(np.zeros(2))[0]) / model.sample_rate_Hz * limit
    generator, good, wanted, limited = np.random.default_rng(2), np.zeros(2), np.zeros(2), 0
    damping.restart(1000)
    for tick in range(1000):
        state, command = 0.05 * generator.normal(size=24), generator.normal(size=2)
        if tick in (400, 700):
            state[8] = (np.nan, np.inf)[tick // 700]
        damping.step(state, command, tick != 500, tick)
        damping.law(state, np.array([0.01 * np.rint(command[0] / 0.01), command[1]]), wanted)
        share = np.abs(wanted / limit).max()
        if np.isfinite(share):
            good += np.clip(wanted / max(share, 1.0) - good, -slew, slew)
            limited += share > 1.0
        else:
            assert tick in (400, 700)
        assert np.array_equal(damping.effort, good * damping.share), f"tick {tick}"
    assert 0 < limited < 998
    assert damping.share == 0.0


@pytest.mark.parametrize(("count", "columns"), [(7, 5), (44, 31), (56, 34), (5, 9)])
def test_a_triangle_is_that_of_the_same_sums_one_element_at_a_time(count: int, columns: int) -> None:
    rows = np.random.default_rng(count).normal(size=(60, 44))
    rows[3:7, :4] = rows[5, :] = 0.0
    plain, whole = rows.copy(), rows.copy()
    triangularise(rows, count, columns)
    triangularise.py_func(plain, count, columns)  # type: ignore[attr-defined]
    assert np.array_equal(rows, plain)
    theirs = np.linalg.qr(whole[:count, :columns]).R
    theirs = theirs * np.where(np.diag(theirs) < 0.0, -1.0, 1.0)[:, None]
    assert np.abs(rows[: len(theirs), :columns] - theirs).max() < 1e-12
    assert not rows[len(theirs) : count, :columns].any()
    assert np.array_equal(rows[count:], whole[count:])
    assert np.array_equal(rows[:, columns:], whole[:, columns:])
