"""Claims: what is missing is predicted over, what cannot be is refused in one line, and a drifting frequency is followed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_models import DenseModel, drawn_rows, small_model, small_noise, with_lower_mode

from controllers.errors import DesignError
from controllers.observers.consistency import InnovationMonitor
from controllers.observers.modal_observer import ModalObserver
from hil.observing.observability import observability


@pytest.fixture(scope="module")
def drawn() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return drawn_rows(DenseModel(small_model(), small_noise()), small_noise(), 1200, seed=11)


def _run(observer: ModalObserver, measured: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    states, estimates = [], []
    for k, z in enumerate(measured):
        observer.step_measured(z, commands[max(k - 1, 0)])
        states.append(observer.state.copy())
        estimates.append(observer.estimate.copy())
    return np.array(states), np.array(estimates)


@pytest.mark.parametrize("kind", ["kf", "ekf", "ukf"])
def test_an_imu_that_falls_silent_widens_the_estimate_and_its_return_mends_it(
    drawn: tuple[np.ndarray, np.ndarray, np.ndarray], kind: str
) -> None:
    measured, commands, _ = drawn
    gap = measured.copy()
    gap[400:800, 4:] = np.nan
    observer = ModalObserver(small_model(), small_noise(), kind)  # type: ignore[arg-type]
    _, estimates = _run(observer, gap, commands)
    assert np.isfinite(estimates).all()
    column = [name for name, _ in observer.channels].index("estimate_detector_x_variance")
    before, inside, after = estimates[399, column], estimates[799, column], estimates[1199, column]
    assert inside > 1.2 * before
    assert after < 1.05 * before
    assert (estimates[400:800, [name for name, _ in observer.channels].index("estimate_measured")] == 4).all()


def test_rows_in_which_nothing_arrived_are_predictions(drawn: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    measured, commands, _ = drawn
    gap = measured.copy()
    gap[600:603] = np.nan
    observer = ModalObserver(small_model(), small_noise(), "ukf")
    states, estimates = _run(observer, gap, commands)
    whole, _ = _run(ModalObserver(small_model(), small_noise(), "ukf"), measured, commands)
    assert np.isfinite(states).all()
    assert estimates[601, -4] == 0.0
    assert estimates[601, -3] == 0.0
    assert np.array_equal(states[:600], whole[:600])
    assert not np.array_equal(states[601], whole[601])
    assert np.abs(states[-1] - whole[-1]).max() < 0.05 * np.abs(whole).max()


def test_a_restarted_observer_repeats_itself_to_the_bit(drawn: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    measured, commands, _ = drawn
    observer = ModalObserver(small_model(), small_noise(), "ukf")
    first, _ = _run(observer, measured[:200], commands)
    observer.restart()
    assert np.isnan(observer.estimate).all()
    again, _ = _run(observer, measured[:200], commands)
    assert np.array_equal(first, again)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_a_mode_ten_per_cent_off_is_found_within_one_per_cent(drawn: tuple[np.ndarray, np.ndarray, np.ndarray], kind: str) -> None:
    measured, commands, _ = drawn
    wrong = with_lower_mode(small_model(), 1.1)
    observer = ModalObserver(wrong, small_noise(adapted_walk=1e-3), kind, adapted=(0,))  # type: ignore[arg-type]
    states, _ = _run(observer, measured, commands)
    ratio = np.exp(states[:, observer.state_names.index("log_frequency_ratio_mode_1")])
    assert abs(ratio[0] - 1.0) < 0.05
    assert abs(ratio[300:].mean() / 1.1 - 1.0) < 0.01
    assert abs(np.log(ratio[-1] / 1.1)) < 3.0 * np.sqrt(observer.covariance[18, 18])


def test_the_alarm_is_silent_on_chance_and_raised_by_what_is_not_modelled(drawn: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    measured, commands, _ = drawn
    alarm = [name for name, _ in ModalObserver(small_model(), small_noise()).channels].index("estimate_alarm")
    _, usual = _run(ModalObserver(small_model(), small_noise(), "ekf"), measured, commands)
    assert not usual[100:, alarm].any()
    calm = replace(small_noise(), disturbance=0.1 * small_noise().disturbance)
    _, surprised = _run(ModalObserver(small_model(), calm, "ekf"), measured, commands)
    assert surprised[100:, alarm].mean() > 0.25


def test_the_monitor_needs_no_measurement_to_keep_still() -> None:
    monitor = InnovationMonitor()
    assert np.isnan(monitor.step(0.0, 0))


def test_with_all_sensors_little_is_hidden_and_without_the_imu_its_modes_and_biases_are_named() -> None:
    observer = ModalObserver(small_model(), small_noise(), "ekf")
    all_of_them = observability(observer, [np.zeros(2)])
    imu = small_model().channels()[4:]
    without = observability(observer, [np.zeros(2)], missing=imu)
    assert len(without.blind) >= len(all_of_them.blind) + 6
    hidden = {name for names in without.blind for name in names}
    assert {f"bias_{channel}" for channel in imu} <= hidden
    told = dict(zip(without.state_names, without.told, strict=True))
    assert told["position_roll"] > 0.9
    assert told["bias_imu_x"] < 1e-6
    assert any("bias_imu_x" in line for line in without.lines)


def test_accelerometer_biases_come_apart_from_tilt_when_the_pose_changes() -> None:
    observer = ModalObserver(small_model(), small_noise(), "ekf")
    one = observability(observer, [np.zeros(2)])
    several = observability(observer, [np.array([0.0, roll]) for roll in (-1.2, -0.6, 0.6, 0.0)])
    x = one.state_names.index("bias_imu_x")
    assert several.told[x] > one.told[x]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"measurement": np.zeros(10)}, "measurement must be above zero"),
        ({"command": np.zeros(3)}, "command must be 2 numbers"),
        ({"disturbance_time_s": np.full(6, np.inf), "disturbance_Hz": np.full(6, 8.0)}, "disturbance_time_s must be finite where"),
        ({"disturbance_Hz": np.full(6, np.inf)}, "disturbance_Hz must be 6 numbers"),
        ({"disturbance": np.array([1.0, np.nan, 1.0, 1.0, 1.0, 1.0])}, "disturbance must be 6 numbers"),
    ],
)
def test_noise_that_does_not_fit_is_one_clear_line(change: dict, words: str) -> None:
    with pytest.raises(DesignError, match=words) as caught:
        ModalObserver(small_model(), replace(small_noise(), **change))
    assert "\n" not in str(caught.value)


def test_a_mode_or_a_filter_that_does_not_exist_is_refused() -> None:
    with pytest.raises(DesignError, match="modes 0 to 3"):
        ModalObserver(small_model(), small_noise(), adapted=(4,))
    with pytest.raises(DesignError, match="kf, ekf, ukf"):
        ModalObserver(small_model(), small_noise(), "pf")  # type: ignore[arg-type]
    with pytest.raises(DesignError, match="the observer looks at"):
        observability(ModalObserver(small_model(), small_noise()), [np.zeros(2)], missing=("camera",))
