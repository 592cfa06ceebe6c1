"""Claims: the alarm says that what is published is worse than its variance; surprising innovations alone do not raise it."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from places import BENCHMARKS

from controllers.observers.consistency import FALSE_ALARM, WINDOW, CorrectionMonitor
from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, observe

sys.path.insert(0, str(BENCHMARKS))
from observer_alarms import SENSORS, AT_s, judged, spoilt
from observer_scan import shaken_scan
from observer_variances import own_design, scans, told

from hil.machine.drawn import drawn, typical
from hil.observing.true_scan import TrueScan

RATE_Hz = 256.0


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("carm-real")


@pytest.fixture(scope="module")
def design(machine: Machine) -> ObserverDesign:
    return own_design(typical(machine), (5, 9), told=True)


@pytest.fixture(scope="module", params=[0.0, 1.0], ids=["quiet", "shaken"])
def scan(machine: Machine, request: pytest.FixtureRequest) -> TrueScan:
    return shaken_scan(drawn(machine, 2, 5), scans(machine)["roll 30 deg/s, quiet"][0], 11, request.param)


def test_corrections_as_large_as_their_variances_raise_nothing_in_ten_minutes_and_larger_ones_do_at_once() -> None:
    generator, monitor = np.random.default_rng(5), CorrectionMonitor()
    deviation = np.array([1.0, 0.1, 0.0, 3.0, 0.3, 0.0, 1.0, 1.0, 1.0])  # most of two in one direction
    rows = deviation * generator.standard_normal((round(600 * RATE_Hz), 9))
    assert not any(monitor.step(row, deviation**2) for row in rows)
    late = [monitor.step(3.0 * row, deviation**2) for row in rows[: 2 * WINDOW]]
    assert any(late)
    assert FALSE_ALARM * 3.0 * 600.0 * RATE_Hz < 1.0


def test_sums_over_a_while_find_a_pull_that_no_single_correction_shows() -> None:
    generator, monitor = np.random.default_rng(6), CorrectionMonitor()
    raised = [monitor.step(generator.standard_normal(9) + 1.0, np.ones(9)) for _ in range(4 * WINDOW)]
    assert raised[-1]
    assert not raised[0]


@pytest.mark.nightly
def test_a_sound_machine_raises_none(machine: Machine, design: ObserverDesign, scan: TrueScan) -> None:
    assert not observe(scan.recording, design.observer())["estimate_alarm"].any()


@pytest.mark.nightly
@pytest.mark.parametrize("fault", [name for name in SENSORS if "motor" not in name])
def test_a_false_sensor_is_told_within_a_second_of_spoiling_the_estimate(
    machine: Machine, design: ObserverDesign, scan: TrueScan, fault: str
) -> None:
    found = judged(machine, design, scan, spoilt(scan.recording, SENSORS[fault]), AT_s)
    assert found.passed >= 1
    assert found.in_time == found.passed
    assert found.false == 0


def test_an_alarm_is_in_time_within_a_second_and_false_without_an_error_near_it() -> None:
    error, variance, alarm = np.zeros((2560, 9)), np.ones((2560, 9)), np.zeros(2560)
    error[1000:1100, 3:6] = 2.1
    alarm[1200] = alarm[2300] = 1.0
    assert told(error, variance, alarm, RATE_Hz) == told(error, variance, alarm, RATE_Hz, 900)
    found = told(error, variance, alarm, RATE_Hz)
    assert (found.rows, found.passed, found.in_time, found.false) == (2, 1, 1, 1)
    error[1000:1100, 3:6] = 1.9
    assert told(error, variance, alarm, RATE_Hz).passed == 0
