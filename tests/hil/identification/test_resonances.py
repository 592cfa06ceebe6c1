"""Claims of the resonances that a frequency response supports, held against plants whose modes are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, experiment, two_mode_loop

from hil.figures.frf import frf_figure
from hil.identification import FrequencyResponse, Resonance, periodic_records, resonances, robust_bla
from hil.identification.report import resonance_lines
from hil.machine import load_machine
from hil.simulation.linear import sampled_response
from hil.verbs.identify import ResponseAnswer
from virtual_bus.physics import Physics

FREQUENCIES_Hz, DAMPING = (3.0, 7.0), (0.03, 0.02)
PERIOD, SETTLE = 512, 4
POSE = np.radians([10.0, 30.0])
OUTPUTS = ("imu_x", "imu_y", "imu_z", "position_propeller", "position_roll")
NOISE = np.array((5e-3, 5e-3, 5e-3, 2e-5, 2e-5))


def measured(seed: int, lines: np.ndarray, periods: int = 4) -> FrequencyResponse:
    """A robust BLA of a machine with two modes."""
    data = experiment(
        two_mode_loop(FREQUENCIES_Hz, DAMPING),
        np.random.default_rng(seed),
        realisations=3,
        periods=periods,
        settle_periods=SETTLE,
        period=PERIOD,
        lines=lines,
        noise=(0.05, 0.005, 0.005),
    )
    records = periodic_records(
        **data,
        period_samples=PERIOD,
        sample_rate_Hz=SAMPLE_RATE_HZ,
        settle_periods=SETTLE,
        output_names=("imu_x", "position_propeller", "position_roll"),
        input_names=("command_propeller", "command_roll"),
    )
    return robust_bla(records)


def held(found: Sequence[Resonance], truth: Sequence[tuple[float, float]]) -> list[bool]:
    """Whether the bounds of the nearest resonance hold each true frequency and damping ratio; there must be no other resonance."""
    assert len(found) == len(truth)
    inside = []
    for one, (frequency_Hz, damping) in zip(found, truth, strict=True):
        inside.append(one.frequency_ci95_Hz[0] <= frequency_Hz <= one.frequency_ci95_Hz[1])
        inside.append(one.damping_ci95[0] <= damping <= one.damping_ci95[1])
    return inside


def test_both_modes_are_found_and_told() -> None:
    response = measured(1, np.arange(5, 160))
    found = resonances(response)
    assert [one.frequency_Hz for one in found.found] == pytest.approx(FREQUENCIES_Hz, rel=2e-3)
    assert [one.damping for one in found.found] == pytest.approx(DAMPING, rel=0.1)
    head, *lines = resonance_lines(found)
    assert head.startswith("2 resonances with 95 % bounds")
    assert "maximum-likelihood fit of common pole pairs" in lines[-1]
    assert max(map(len, lines)) <= 120
    assert lines[0].startswith("  3.0")
    assert " Hz ± 0.0" in lines[0]
    assert "damping 3." in lines[0] or "damping 2.9" in lines[0]
    answer = ResponseAnswer.of(None, False, response, found)
    assert answer.modes[1].frequency_Hz == found.found[1].frequency_Hz
    assert answer.no_modes == ""


@pytest.mark.slow
def test_the_bounds_hold_what_they_promise() -> None:
    truth = list(zip(FREQUENCIES_Hz, DAMPING, strict=True))
    inside = [each for seed in range(25) for each in held(resonances(measured(100 + seed, np.arange(5, 160))).found, truth)]
    assert 0.88 <= np.mean(inside) <= 1.0


@pytest.mark.nightly
def test_the_modes_of_the_emulated_c_arm_are_its_plants_eigenvalues() -> None:
    """Monte Carlo: the response of the plant with errors drawn from a known covariance, against the eigenvalues of its linearisation."""
    machine, rng = load_machine("carm"), np.random.default_rng(3)
    lines = np.arange(20, 401)
    frequencies_Hz = lines / 10.0
    truth = sampled_response(machine, POSE, frequencies_Hz, OUTPUTS)
    poles = np.linalg.eigvals(Physics(machine.plant, noise=False).linearise(POSE).A)
    poles = poles[(poles.imag > 0.0) & (np.abs(poles) < 2.0 * np.pi * 38.0) & (np.abs(poles) > 2.0 * np.pi * 3.0)]
    modes = sorted((abs(pole) / (2.0 * np.pi), -pole.real / abs(pole)) for pole in poles if -pole.real < 0.3 * abs(pole))
    deviation = np.repeat(NOISE[:, None], 2, axis=1) * 3.0
    variance = np.tile(np.diag(deviation.T.ravel() ** 2).astype(complex), (len(lines), 1, 1))
    template = replace(
        measured(1, np.arange(5, 60)),
        lines=lines,
        frequencies_Hz=frequencies_Hz,
        noise_covariance=variance,
        total_covariance=None,
        nonlinear_covariance=None,
        noise_dof=np.full(len(lines), 50.0),
        output_names=OUTPUTS,
        output_units=("m/s^2",) * 3 + ("rad",) * 2,
        sample_rate_Hz=machine.sample_rate_Hz,
        period_samples=2560,
        pose=tuple(POSE),
    )
    inside = []
    for _ in range(12):
        error = deviation / np.sqrt(2.0) * (rng.standard_normal(truth.shape) + 1j * rng.standard_normal(truth.shape))
        inside += held(resonances(replace(template, G=truth + error)).found, modes)
    assert 0.85 <= np.mean(inside) <= 1.0


def test_where_the_data_support_none_it_says_why() -> None:
    one_period = resonances(measured(2, np.arange(5, 160), periods=1))
    assert one_period.found == ()
    assert "two periods" in resonance_lines(one_period)[0]
    few = resonances(measured(2, np.array([20, 30, 40, 50])))
    assert few.found == ()
    assert "4 lines are too few" in resonance_lines(few)[0]
    below = resonances(measured(2, np.arange(4, 18)))  # 0.5 to 2.1 Hz: the modes are at 3 and 7 Hz
    assert below.found == ()
    assert "no resonance between 0.5 and 2.125 Hz stands out" in resonance_lines(below)[0]


def test_the_figure_marks_them_with_frequency_and_damping() -> None:
    response = measured(1, np.arange(5, 160))
    found = resonances(response).found
    figure = frf_figure(response, modes=found, title="two modes")
    assert "1: 3 Hz, 3" in figure.get_suptitle()
    assert "2: 7 Hz, 2" in figure.get_suptitle()
    numbers = {text.get_text(): text.xy[0] for text in figure.axes[0].texts}
    assert numbers == {str(number): mode.frequency_Hz for number, mode in enumerate(found, start=1)}
