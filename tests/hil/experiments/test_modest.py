"""Experiments are scaled to what the drives can give, and what even the least asks too much of is told as it was asked."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hil.errors import ExperimentError
from hil.experiments import Jog, Multisine, Scan
from hil.experiments.modest import Possible, possible_multisine, possible_scan
from hil.machine import Machine, load_machine

AT_THE_END = {"propeller": -2.122}
"""Where gravity and friction take 5.3 A of roll's 7.2 A."""


@pytest.fixture(scope="module")
def real() -> Machine:
    return load_machine("carm-real")


def with_limit(machine: Machine, effort: float) -> Machine:
    """Return the machine with weaker drives."""
    return dataclasses.replace(machine, controllers=tuple(dataclasses.replace(each, limit=effort) for each in machine.controllers))


def test_a_scan_that_asks_too_much_lies_in_its_ramps_before_it_slows(real: Machine) -> None:
    scan = Scan("roll", -1.598, 1.598, 0.75 * real.limits[1].speed, AT_THE_END, sweeps=2)
    with pytest.raises(ExperimentError, match=r"command of roll would reach 7\.24"):
        scan.plans(real)
    (plan,) = possible_scan(real, scan)
    roll = plan.reference[:, 1]
    assert np.ptp(roll) == pytest.approx(3.196)
    assert np.abs(np.diff(roll)).max() * real.sample_rate_Hz == pytest.approx(scan.speed, rel=1e-3)
    ramp = np.abs(np.diff(roll, 2)).max() * real.sample_rate_Hz**2
    assert ramp == pytest.approx(0.5 * real.limits[1].acceleration, rel=2e-2)


def test_a_scan_that_can_be_made_is_left_as_it_is(real: Machine) -> None:
    scan = Scan("roll", -1.0, 1.0, 0.5)
    np.testing.assert_array_equal(possible_scan(real, scan)[0].reference, scan.plans(real)[0].reference)
    np.testing.assert_array_equal(Possible(scan).plans(real)[0].reference, scan.plans(real)[0].reference)


def test_where_an_end_of_the_way_takes_all_effort_the_way_is_shorter(real: Machine) -> None:
    weaker = with_limit(real, 5.2)
    (plan,) = possible_scan(weaker, Scan("roll", -1.598, 1.598, 0.5))
    assert 1.5 < np.ptp(plan.reference[:, 1]) < 3.19


def test_what_no_lesser_scan_makes_possible_is_told_as_it_was_asked(real: Machine) -> None:
    scan = Scan("roll", -1.598, 1.598, 0.5, AT_THE_END)
    with pytest.raises(ExperimentError) as asked:
        scan.plans(with_limit(real, 2.0))
    with pytest.raises(ExperimentError) as told:
        possible_scan(with_limit(real, 2.0), scan)
    assert str(told.value) == str(asked.value)


def test_a_multisine_is_as_large_as_the_drives_can_give(real: Machine) -> None:
    asked = Multisine(AT_THE_END, amplitude_A=3.0, periods=1, settle_periods=1, jog=Jog())
    with pytest.raises(ExperimentError, match="amplitude"):
        asked.plans(real)
    given = possible_multisine(real, asked)[0].metadata["amplitude"]
    assert set(given) == {0.75} or set(given) == {1.5}
