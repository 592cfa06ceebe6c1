"""When the emulator on the wall clock expects the next SYNC, before which it wakes and measures ahead."""

from __future__ import annotations

import numpy as np
import pytest

from virtual_bus.emulator import Tick

PERIOD_s, SYNC, STEP_s = 1.0 / 256.0, 0x80, 2e-5
AHEAD_s = 400e-6  # four times what measuring takes, a tenth of a period


def heard(syncs: tuple[float, ...]) -> tuple[Tick, list[object]]:
    """A tick that has heard these, at multiples of the period, and when it measures ahead."""
    measured = []
    tick = Tick(SYNC, PERIOD_s, lambda: measured.append(True))
    for k in syncs:
        tick.heard(SYNC, k * PERIOD_s)
    return tick, measured


def due(syncs: tuple[float, ...]) -> float:
    """When the next SYNC is expected, in periods: so long after it measures ahead."""
    tick, measured = heard(syncs)
    for now_s in np.arange(syncs[-1] * PERIOD_s, (syncs[-1] + 2.0) * PERIOD_s, STEP_s):
        tick.patience(now_s)
        if measured:
            return (now_s + AHEAD_s) / PERIOD_s
    return None


@pytest.mark.parametrize(
    ("syncs", "expected"),
    [
        ((0, 1, 2, 3), 4.0),
        ((0, 1, 2, 3.4), 4.05),  # ticks are absolute: the next comes when it would have
        ((0, 1, 2, 2.9), 3.9),  # nobody sends too early: so the ones before were late
        ((0, 1, 2, 5.6), 6.6),  # a new beginning
        ((0, *(k + 0.2 for k in range(1, 60))), 60.2),  # what is always late is on time
    ],
)
def test_a_late_sync_says_little_of_the_next(syncs: tuple[float, ...], expected: float) -> None:
    assert due(syncs) == pytest.approx(expected, abs=0.02)


def test_it_sleeps_after_a_sync_and_for_no_longer_than_until_the_next_comes_near() -> None:
    tick, _ = heard((0, 1))
    assert [tick.patience((1.0 + share) * PERIOD_s) == 0.0 for share in (0.05, 0.2, 0.3, 0.4, 0.9, 1.4, 1.6)] == [
        *(True, False, False, True, True, True, False)
    ]
    assert tick.patience(1.34 * PERIOD_s) == pytest.approx(0.01 * PERIOD_s)


def test_it_measures_ahead_once_and_by_nothing_but_syncs() -> None:
    tick, measured = heard((0, 1))
    tick.heard(0x181, 1.3 * PERIOD_s)
    times = []
    for now_s in np.arange(PERIOD_s, 3.0 * PERIOD_s, STEP_s):
        tick.patience(now_s)
        times += [now_s] * len(measured)
        measured.clear()
    assert times == pytest.approx([2.0 * PERIOD_s - AHEAD_s], abs=0.02 * PERIOD_s)


def test_before_the_first_sync_nothing_is_expected() -> None:
    tick, measured = heard(())
    assert tick.patience(0.0) > 0.0
    assert not measured
    assert due((0,)) == pytest.approx(1.0, abs=0.02)
