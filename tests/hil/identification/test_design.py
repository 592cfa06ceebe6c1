"""Claims of the excitation design: lines where the response changes, power where it is least known, motion that stays at the pose."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, Loop, experiment, plant_response, two_mode_loop

from hil.identification import FrequencyResponse, IdentificationError, periodic_records, robust_bla
from hil.identification.design.excitation import design_excitation
from hil.identification.design.frozen_pose import frozen_pose_check

PERIOD, SETTLE = 512, 5
BAND_HZ = (0.5, 20.0)


def measured(
    frequencies_Hz: tuple[float, float] = (3.0, 7.0),
    damping: tuple[float, float] = (0.03, 0.02),
    seed: int = 1,
    pose: tuple[float, float] = (0.0, 0.0),
    amplitude: float = 1.0,
    noise: tuple[float, float, float] = (0.01, 0.001, 0.001),
) -> tuple[FrequencyResponse, dict[str, np.ndarray], Loop]:
    loop = two_mode_loop(frequencies_Hz=frequencies_Hz, damping=damping)
    lines = np.arange(3, 170)
    data = experiment(
        loop, np.random.default_rng(seed), realisations=2, periods=4, settle_periods=SETTLE, period=PERIOD, lines=lines, noise=noise
    )
    names = ("imu_x", "position_propeller", "position_roll")
    records = periodic_records(
        **data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, settle_periods=SETTLE, output_names=names, pose=pose
    )
    return robust_bla(records), data, loop


def interpolation_error(loop: Loop, lines_Hz: np.ndarray) -> float:
    """Largest error, as a share of the peak, of a response known only at some frequencies."""
    fine = np.linspace(1.0, 18.0, 3000)
    truth, known = plant_response(loop, fine), plant_response(loop, lines_Hz)
    between = np.stack([[np.interp(fine, lines_Hz, known[:, i, j]) for j in range(2)] for i in range(3)]).transpose(2, 0, 1)
    return np.max(np.abs(between - truth) / np.abs(truth).max(axis=0))


@pytest.mark.slow
def test_lines_crowd_where_a_response_changes() -> None:
    response, _, loop = measured()
    design = design_excitation([response], lines=60, band_Hz=BAND_HZ, period_samples=8 * PERIOD)
    even = np.linspace(*BAND_HZ, 60)
    assert len(design.lines) == len(np.unique(design.lines)) == 60
    assert interpolation_error(loop, design.frequencies_Hz) < interpolation_error(loop, even) / 3


@pytest.mark.nightly
def test_a_resonance_that_moves_gets_its_whole_range() -> None:
    poses = [measured(frequencies_Hz=(f, 7.0), seed=k)[0] for k, f in enumerate((3.0, 3.5, 4.0))]
    at_one = design_excitation(poses[:1], lines=80, band_Hz=BAND_HZ, period_samples=8 * PERIOD).frequencies_Hz
    at_all = design_excitation(poses, lines=80, band_Hz=BAND_HZ, period_samples=8 * PERIOD).frequencies_Hz
    assert np.sum((at_all > 3.3) & (at_all < 4.2)) > 2 * np.sum((at_one > 3.3) & (at_one < 4.2))


def test_only_odd_lines_without_the_jogs_are_taken() -> None:
    response, _, _ = measured()
    design = design_excitation([response], lines=60, band_Hz=BAND_HZ, period_samples=8 * PERIOD, without=(301,))
    assert np.all(design.lines % 2 == 1)
    assert 301 not in design.lines
    assert np.mean(design.weights**2) == pytest.approx(1.0)


def test_power_goes_where_the_response_is_least_known() -> None:
    response, _, _ = measured()
    design = design_excitation([response], lines=80, band_Hz=BAND_HZ, period_samples=4 * PERIOD)
    kind = response.standard_deviation("total") / np.abs(response.G)
    worst = np.interp(design.frequencies_Hz, response.frequencies_Hz, kind.min(axis=2).max(axis=1))
    assert np.corrcoef(np.log(worst), np.log(design.weights))[0, 1] > 0.5


def test_a_band_without_enough_harmonics_is_refused() -> None:
    response, _, _ = measured()
    with pytest.raises(IdentificationError, match="lengthen the period or ask for fewer"):
        design_excitation([response], lines=400, band_Hz=BAND_HZ, period_samples=PERIOD)
    with pytest.raises(IdentificationError, match=r"not the band 0\.5 to 32 Hz"):
        design_excitation([response], lines=10, band_Hz=(0.5, 32.0), period_samples=PERIOD)


def test_the_frozen_pose_check_knows_the_motion_and_what_it_does() -> None:
    spacing = 0.5
    made = [measured(frequencies_Hz=(3.0 + 0.2 * k, 7.0), seed=k, pose=(0.0, spacing * k), damping=(0.2, 0.2)) for k in range(3)]
    responses = [response for response, _, _ in made]
    data = made[0][1]
    rms = data["excitation"][0, 0, :PERIOD].std(axis=0)
    check = frozen_pose_check(responses, rms, 1)
    settled = np.concatenate([d["outputs"][:, :, SETTLE * PERIOD :, 1:].reshape(-1, 2) for _, d, _ in made])
    np.testing.assert_allclose(check.motion_rms, settled.std(axis=0), rtol=0.25)
    far = frozen_pose_check([r for r, _, _ in made[::2]], rms, 1)
    assert np.median(far.change / check.change) == pytest.approx(1.0, abs=0.3)  # a slope, whatever the poses' spacing
    twice = frozen_pose_check(responses, 2 * rms, 1)
    np.testing.assert_allclose(twice.change, 2 * check.change)
    assert check.largest_scale < 1.0 < check.change.max()
