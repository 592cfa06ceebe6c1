"""Filters for plants that are typed: the thesis's examples, and the response beside SciPy's."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import scipy.signal
from command_line import Isocenter

from controllers.errors import DesignError
from hil.errors import UnusableInputError
from hil.shaping.typed_plant import design_for, from_coefficients, from_roots

ZETA, W_rad_s = 0.02, np.sqrt(2.0)
NUMERATOR, DENOMINATOR = [2.0], [1.0, 2.0 * ZETA * W_rad_s, 2.0]


def test_the_example_of_a_lightly_damped_plant_has_the_printed_delay_and_gains() -> None:
    """(7.15) to (7.17)."""
    found = design_for(from_coefficients(NUMERATOR, DENOMINATOR), [0.7]).shaper
    np.testing.assert_allclose(found.delays_s, [0.0, 2.2219, 4.4438], atol=1e-4)
    np.testing.assert_allclose(found.gains, [0.3970, -0.0087, -0.3583], atol=1e-4)


def test_five_harmonics_are_tracked_by_eleven_taps_and_the_pole_is_gone() -> None:
    """Example 7.3; the gains printed in Table 7.1 meet none of its conditions."""
    harmonics = np.array([1.0, 3.0, 5.0, 7.0, 11.0])
    found = design_for(from_coefficients(NUMERATOR, DENOMINATOR), harmonics.tolist())
    gains, delays = found.shaper.gains, found.shaper.delays_s
    s = 1j * harmonics
    through = 2.0 / (s**2 + DENOMINATOR[1] * s + 2.0) * (np.exp(-s[:, None] * delays) @ gains)
    np.testing.assert_allclose(through, 1.0, atol=1e-9)
    pole = -ZETA * W_rad_s + 1j * W_rad_s * np.sqrt(1.0 - ZETA**2)
    assert abs(np.exp(-pole * delays) @ gains) < 1e-9
    assert len(gains) == 11
    np.testing.assert_allclose(np.diff(delays), delays[1])


def test_poles_and_zeros_are_the_same_plant_as_its_transfer_function() -> None:
    zeros, poles = np.array([-3.0]), np.array([-0.1 + 2.0j, -0.1 - 2.0j, -5.0])
    by_roots = from_roots([-3.0], [-0.1 + 2.0j, -5.0], static_gain=1.5)
    s = np.array([0.0, 0.3j, 2.0j, 9.0j])
    wanted = 1.5 * np.prod((s[:, None] - zeros) / -zeros, axis=1) / np.prod((s[:, None] - poles) / -poles, axis=1)
    np.testing.assert_allclose(by_roots.response(s), wanted, rtol=1e-10)


def test_a_pair_counts_once_whether_one_of_it_is_typed_or_both() -> None:
    one, both = (from_roots([], poles) for poles in ([-1.0 + 2.0j], [-1.0 + 2.0j, -1.0 - 2.0j]))
    np.testing.assert_allclose(np.sort_complex(both.poles), [-1.0 - 2.0j, -1.0 + 2.0j])
    np.testing.assert_array_equal(one.a, both.a)
    twice = from_roots([], [-1.0 + 2.0j, -1.0 + 2.0j, -1.0 - 2.0j, -1.0 - 2.0j])
    assert twice.response(1.0j) == pytest.approx(one.response(1.0j) ** 2)
    robust = [design_for(one, [0.7], delay_s=1.0, robust_poles=poles).shaper for poles in ([-1.0 + 2.0j], [-1.0 - 2.0j, -1.0 + 2.0j])]
    np.testing.assert_array_equal(robust[1].gains, robust[0].gains)
    assert len(robust[1].gains) == 6  # real equations: two of the pole, two of its slope, two of the frequency


def test_a_pole_that_stands_more_often_than_its_conjugate_is_refused() -> None:
    with pytest.raises(UnusableInputError, match="stands 2 times and its conjugate 1 times"):
        from_roots([], [-1.0 + 2.0j, -1.0 + 2.0j, -1.0 - 2.0j])


@pytest.mark.parametrize("inverse", ["", "zmetc"])
def test_what_it_shows_in_time_is_what_scipy_integrates_and_follows_after_the_transient(inverse: str) -> None:
    """With a zero of the left half plane, too."""
    numerator, denominator = [0.5, 2.0], [1.0, 0.08, 2.0]
    found = design_for(from_coefficients(numerator, denominator), [0.5, 0.9], delay_s=1.3, inverse=inverse)
    times = np.arange(0.0, 40.0, 0.002)

    def reference(t: np.ndarray) -> np.ndarray:
        return np.where(t >= 0.0, np.sin(0.5 * t) + np.sin(0.9 * t), 0.0)

    parts = [gain * reference(times - delay) for gain, delay in zip(found.shaper.gains, found.shaper.delays_s, strict=True)]
    if found.shaper.tail is not None:
        parts[-1] = scipy.signal.lsim(([2.0], [0.5, 2.0]), parts[-1], times)[1]
    integrated = scipy.signal.lsim((numerator, denominator), np.sum(parts, axis=0), times)[1]
    shown = found.in_time(times)
    np.testing.assert_allclose(shown[:, 0], reference(times), atol=1e-12)
    np.testing.assert_allclose(shown[:, 2], integrated, atol=2e-5)
    late = times > found.shaper.settled_s + 6.0
    assert np.abs(shown[late, 2] - shown[late, 0]).max() < 1e-6
    assert np.abs(shown[late, 1] - shown[late, 0]).max() > 0.05


def test_a_robust_filter_is_insensitive_to_what_it_shall_be() -> None:
    plant = from_coefficients(NUMERATOR, DENOMINATOR)
    plain = design_for(plant, [0.7], delay_s=1.5)
    flat = design_for(plant, [0.7], delay_s=1.5, robust_forcing_rad_s=[0.7])
    near = design_for(plant, [0.7], delay_s=1.5, robust_poles=[-0.02828 + 1.41393j])
    assert flat.through_off[0] < 0.3 * plain.through_off[0]
    slope = [abs(each.shaper.response(1.01 * plant.poles[0])) for each in (plain, near)]
    assert slope[1] < 0.1 * slope[0]


@pytest.mark.parametrize(
    ("denominator", "options", "said"),
    [
        ([1.0, -0.1, 2.0], {}, "not stable"),
        (DENOMINATOR, {"forcing_rad_s": [W_rad_s]}, "forcing frequency"),
        (DENOMINATOR, {"robust_poles": [-1.0 + 1.0j]}, "the plant has"),
        (DENOMINATOR, {"forcing_rad_s": []}, "0 for a reference with a mean"),
    ],
)
def test_what_cannot_be_is_said(denominator: list[float], options: dict, said: str) -> None:
    with pytest.raises((DesignError, UnusableInputError), match=said):
        design_for(from_coefficients(NUMERATOR, denominator), **{"forcing_rad_s": [0.7]} | options)


@pytest.mark.parametrize("denominator", [[1.0, 1.0], [1.0, 3.0, 2.0]])
def test_where_no_shortest_delay_exists_the_way_out_is_said(denominator: list[float]) -> None:
    plant = from_coefficients([denominator[-1]], denominator)
    with pytest.raises(DesignError, match=r"no delay up to 12\.57 s .* with --delay you choose T"):
        design_for(plant, [0.7])
    assert design_for(plant, [0.7], delay_s=1.0).through.max() < 1e-9


def test_the_command_takes_either_form_and_writes_the_response(isocenter: Isocenter, tmp_path: Path) -> None:
    table = tmp_path / "response.csv"
    coefficients = ("--numerator", "2", "--denominator", "1,0.05656854,2")
    typed = isocenter("shape-plant", *coefficients, "--forcing", "0.7", "--csv", table, "--json", "-")
    document = json.loads(typed.out)
    assert document["gains"] == pytest.approx([0.3970, -0.0087, -0.3583], abs=1e-4)
    assert document["delays_s"] == pytest.approx([0.0, 2.2219, 4.4438], abs=1e-4)
    with table.open(encoding="utf-8") as file:
        rows = [[float(value) for value in row] for row in list(csv.reader(file))[1:]]
    assert np.abs(np.array([row[1] - row[3] for row in rows if row[0] > 4.5])).max() < 1e-6
    roots = isocenter("shape-plant", "--poles=-0.02828427+1.413931j", "--forcing", "0.7", "--json", "-")
    assert json.loads(roots.out)["gains"] == pytest.approx(document["gains"], abs=1e-5)
