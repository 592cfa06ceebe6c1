"""Disturbances that are low passes of second order: their spectrum, how tuning tells them, and a design that keeps them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from observed_models import DenseModel, FREQUENCIES_Hz, colour_of, drawn_rows, small_model, small_noise
from scipy.linalg import solve_discrete_lyapunov

from controllers.errors import DesignError
from controllers.models.modal import ModalModel
from controllers.observers.modal_observer import ModalObserver
from controllers.observers.settings import ObserverNoise
from hil.errors import UnusableInputError
from hil.observing import ObserverDesign, read_design, tune, write_design
from hil.recording import Channel, Recording

CORNER_Hz, DAMPING_RATIO, STRENGTH = 9.0, 0.7, 0.5


def pushed_at_a_shift(is_low_pass: bool) -> tuple[ModalModel, ObserverNoise]:
    """A small model with two drives' disturbances and one at a shift, and what it is to believe of them."""
    over_stiffness = np.append([1.0, 1.0], (2.0 * np.pi * FREQUENCIES_Hz) ** -2)[:, None]
    along = np.random.default_rng(4).normal(size=6) * np.array([0, 0, 1, 1, 1, 1])
    directions = over_stiffness * np.column_stack((np.eye(6)[:, :2], along))
    model = replace(small_model(), directions=directions[:, :, None], places=("drive", "drive", "shift"))
    time = 1.0 / (2.0 * np.pi * CORNER_Hz * DAMPING_RATIO) if is_low_pass else 0.1
    noise = replace(
        small_noise(),
        disturbance=np.array([0.02, 0.02, STRENGTH]),
        disturbance_time_s=np.array([1.0, 1.0, time]),
        disturbance_Hz=np.array([0.0, 0.0, CORNER_Hz if is_low_pass else 3.0]),
        low_pass=np.array([False, False, is_low_pass]),
    )
    return model, noise


def test_a_low_pass_is_flat_below_its_corner_and_falls_with_the_square_of_frequency() -> None:
    model, noise = pushed_at_a_shift(True)
    step, added = colour_of(noise, 1.0 / 256.0)
    steady = solve_discrete_lyapunov(step, added)
    assert np.sqrt(steady[2, 2]) == pytest.approx(STRENGTH, rel=1e-9)
    observer = ModalObserver(model, noise)
    states = [observer.state_names.index(name) for name in ("disturbance_3", "disturbance_3_quadrature")]
    assert observer.covariance[np.ix_(states, states)] == pytest.approx(steady[2:, 2:], rel=1e-9)  # as it starts

    def density(frequency_Hz: float) -> float:
        resolvent = np.linalg.inv(np.exp(2j * np.pi * frequency_Hz / 256.0) * np.eye(len(step)) - step)
        return float((resolvent @ added @ resolvent.conj().T)[2, 2].real)

    def of_second_order(frequency_Hz: float) -> float:
        ratio = frequency_Hz / CORNER_Hz
        return 1.0 / ((1.0 - ratio**2) ** 2 + (2.0 * DAMPING_RATIO * ratio) ** 2)

    for frequency_Hz in (0.1, 3.0, 9.0, 20.0, 40.0):
        assert density(frequency_Hz) / density(0.01) == pytest.approx(of_second_order(frequency_Hz), rel=0.05), frequency_Hz


@pytest.mark.slow
@pytest.mark.parametrize("is_low_pass", [True, False])
def test_tuning_takes_a_low_pass_where_one_pushes_and_a_band_where_that_does(is_low_pass: bool) -> None:
    model, noise = pushed_at_a_shift(is_low_pass)
    measured, commands, _ = drawn_rows(DenseModel(model, noise), noise, 600, seed=6)
    channels = {"time": Channel("s", np.arange(len(measured)) / 256.0)}
    units = ["rad"] * 4 + ["m/s^2"] * 3 + ["rad/s"] * 3
    channels |= {name: Channel(unit, column) for name, unit, column in zip(model.channels(), units, measured.T, strict=True)}
    channels |= {f"command_{axis}": Channel("A", column) for axis, column in zip(model.axes, commands.T, strict=True)}
    start = replace(noise, disturbance_time_s=np.full(3, 0.1), disturbance_Hz=np.array([0.0, 0.0, 3.0]), low_pass=np.zeros(3, dtype=bool))
    tuned = tune(model, start, [Recording(channels, {})], evaluations=100 if is_low_pass else 40).noise
    assert list(tuned.low_pass) == [False, False, is_low_pass]
    if is_low_pass:
        assert tuned.disturbance_Hz[2] == pytest.approx(CORNER_Hz, rel=0.2)


def test_a_design_keeps_low_passes_an_earlier_one_has_none_and_one_without_frequencies_is_refused(tmp_path: Path) -> None:
    model, noise = pushed_at_a_shift(True)
    write_design(ObserverDesign(model, noise, np.zeros(3), "small", ""), tmp_path / "small.npz")
    kept = read_design(tmp_path / "small.npz")
    assert kept.model.places == model.places
    assert list(kept.noise.low_pass) == [False, False, True]
    with np.load(tmp_path / "small.npz") as file:
        later = dict(file)
    new = ("effort_step", "places", "noise_low_pass")
    np.savez(tmp_path / "earlier.npz", **{**{name: later[name] for name in later if name not in new}, "observer_format": 2})
    assert not len(read_design(tmp_path / "earlier.npz").noise.low_pass)
    np.savez(tmp_path / "future.npz", **{**later, "observer_format": 4})
    with pytest.raises(UnusableInputError, match="not an observer design of format 3 or 2"):
        read_design(tmp_path / "future.npz")
    with pytest.raises(DesignError, match="low_pass must be 3 times yes or no"):
        ModalObserver(model, replace(noise, disturbance_Hz=np.zeros(3)))
    with pytest.raises(DesignError, match=r"disturbance 3, disturbance_Hz = 1e-05.*does not change within a sample"):
        ModalObserver(model, replace(noise, disturbance_Hz=np.array([0.0, 0.0, 1e-5]), disturbance_time_s=np.array([1.0, 1.0, 3e4])))
