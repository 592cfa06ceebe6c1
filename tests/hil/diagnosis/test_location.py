"""Where a mismatch is said to be, against mismatches that were put there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from carriage import repeats

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.location.location import Mismatch, locate
from hil.diagnosis.result import Location
from hil.diagnosis.verdict.values import Outcome
from hil.machine import load_machine

EMPS = load_machine("emps")
RATE_Hz = 1000.0
ROWS = 8000
TIME = np.arange(ROWS) / RATE_Hz
POSITION = 0.1 - 0.1 * np.cos(2.0 * np.pi * 0.5 * TIME)  # to and fro over 0.2 m, 0.31 m/s
SPEED = 0.1 * np.pi * np.sin(2.0 * np.pi * 0.5 * TIME)


def located(added: np.ndarray, repeats: int = 4) -> Location:
    """Of white noise of the mean of some repeats, in one of two channels with `added` (N,) in units of one repeat's."""
    white = np.random.default_rng(0).standard_normal((ROWS, 2)) / np.sqrt(repeats)
    white[:, 1] += added
    columns = [values[:, None] for values in (POSITION, SPEED, SPEED)]
    begins = tuple((f"repeat {number}", 0.0) for number in range(repeats))
    found = Mismatch(begins, TIME, white, 1.0 / repeats, *columns)
    return locate(["carriage"], [found], {"a": 0.0, "b": 1.0})


def overlap(spans: Sequence[tuple[float, float]], low: float, high: float) -> float:
    """Intersection over union of intervals with one interval."""
    inside = sum(max(0.0, min(b, high) - max(a, low)) for a, b in spans)
    return inside / (sum(b - a for a, b in spans) + (high - low) - inside)


def test_a_burst_is_found_in_its_time_and_its_frequency() -> None:
    envelope = np.where((TIME > 3.0) & (TIME < 4.0), np.sin(np.pi * (TIME - 3.0)) ** 2, 0.0)
    location = located(8.0 * np.sin(2.0 * np.pi * 40.0 * TIME) * envelope)
    assert set(location.time_s) == {f"repeat {number}" for number in range(4)}
    assert overlap(location.time_s["repeat 0"], 3.1, 3.9) > 0.6
    assert overlap(location.frequency_hz, 38.5, 41.5) > 0.5
    assert location.shares["time_s"]["all"] > 0.9


def test_a_force_at_one_place_is_found_at_that_place() -> None:
    location = located(np.where((POSITION > 0.12) & (POSITION < 0.14), 4.0, 0.0))
    assert overlap(location.position["carriage"], 0.12, 0.14) > 0.6


def test_what_one_direction_alone_has_is_found_in_that_direction() -> None:
    location = located(np.where(SPEED > 0.02, 3.0, 0.0))
    assert location.direction == {"carriage": "positive"}
    assert located(np.full(ROWS, 3.0)).direction == {"carriage": "both"}


def test_what_is_everywhere_is_localised_nowhere() -> None:
    location = located(4.0 * np.random.default_rng(1).standard_normal(ROWS))
    assert not location.time_s
    assert not location.position
    assert not location.speed
    assert not location.frequency_hz


def test_periods_are_times_of_their_recording() -> None:
    white = np.random.default_rng(0).standard_normal((2000, 1)) / np.sqrt(2.0)
    white[500:700] += 5.0
    still = np.zeros((2000, 1))
    found = Mismatch((("run", 2.0), ("run", 4.0)), TIME[:2000], white, 0.5, still, still, still)
    spans = locate(["carriage"], [found], {"a": 1.0}).time_s["run"]
    assert len(spans) == 2
    assert spans[0] == pytest.approx((2.5, 2.7), abs=0.15)
    assert spans[1] == pytest.approx((4.5, 4.7), abs=0.15)


def test_friction_is_located_in_the_drives_effort(friction: Outcome) -> None:
    assert friction.diagnosis.location.channels["effort_carriage"] > 0.95


@pytest.mark.nightly
def test_a_stop_is_located_where_it_is_met() -> None:
    """From 0.046 m on, of a way of 0.056 m."""
    found = diagnose(EMPS, repeats(4, 3.0, at=lambda x: -20000.0 * max(x - 0.046, 0.0))).diagnosis
    assert found.findings
    low, _ = found.location.position["carriage"][0]
    assert low > 0.04
