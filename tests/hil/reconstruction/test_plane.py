"""Appendix B in a plane: discs come back from parallel and fan projections, and what the appendix says of angles and offsets holds."""

from __future__ import annotations

import numpy as np
import pytest

from hil.errors import UnusableInputError
from hil.reconstruction.filtered_backprojection import fan_projections, fan_reconstruction, filtered_backprojection, parallel_projections

DISCS = np.array([[0.0, 0.0, 0.05, 20.0], [0.018, 0.006, 0.012, 10.0], [-0.02, -0.015, 0.008, -8.0]])
SIZE, SPACING, SOURCE = 129, 1e-3, 0.81


def picture(fine: int = 4) -> np.ndarray:
    """The discs on the grid, averaged over fine x fine points a pixel."""
    along = (np.arange(SIZE * fine) - (SIZE * fine - 1) / 2.0) * SPACING / fine
    x, y = np.meshgrid(along, along)
    values = sum(a * ((x - cx) ** 2 + (y - cy) ** 2 < r**2) for cx, cy, r, a in DISCS)
    return values.reshape(SIZE, fine, SIZE, fine).mean(axis=(1, 3))


def inside(image: np.ndarray) -> list[float]:
    """Mean in the middle of the big disc's plain part, of each small disc."""
    along = (np.arange(SIZE) - (SIZE - 1) / 2.0) * SPACING
    x, y = np.meshgrid(along, along)
    places = [(-0.01, 0.025), (0.018, 0.006), (-0.02, -0.015)]
    return [float(image[(x - a) ** 2 + (y - b) ** 2 < 0.005**2].mean()) for a, b in places]


def fan(angles: int = 360, offset: float = 0.0) -> np.ndarray:
    turn = 2.0 * np.pi * np.arange(angles) / angles
    psi = (np.arange(301) - 150) * 0.0006
    return fan_reconstruction(fan_projections(DISCS, turn, psi + offset, SOURCE), turn, psi, SOURCE, SIZE, SPACING)


def test_a_fan_gives_the_discs_their_attenuation() -> None:
    assert inside(fan()) == pytest.approx([20.0, 30.0, 12.0], rel=0.01)


def test_parallel_projections_are_the_line_integrals_of_discs_and_give_them_back() -> None:
    angles = np.pi * np.arange(180) / 180
    projections = parallel_projections(picture(), angles, SPACING)
    assert projections[:, SIZE // 2] == pytest.approx(fan_projections(DISCS, np.pi / 2 - angles, np.zeros(1), 1e3)[:, 0], abs=0.06)
    assert inside(filtered_backprojection(projections, angles, SPACING)) == pytest.approx([20.0, 30.0, 12.0], rel=0.02)


def test_without_the_filter_the_image_is_smeared() -> None:
    angles = np.pi * np.arange(180) / 180
    projections = parallel_projections(picture(), angles, SPACING)
    smeared = filtered_backprojection(projections, angles, SPACING, None)
    assert smeared[SIZE // 2, 3] / smeared[SIZE // 2, SIZE // 2] > 0.2  # outside of the disc, where there is nothing


def test_fewer_angles_leave_streaks_and_an_offset_blurs() -> None:
    along = (np.arange(SIZE) - (SIZE - 1) / 2.0) * SPACING
    x, y = np.meshgrid(along, along)
    # next to the disc, whose inside shows no streaks at 60 angles
    outside = (x**2 + y**2 > 0.054**2) & (x**2 + y**2 < 0.062**2)
    streaks = [float(np.std(fan(angles)[outside])) for angles in (30, 60, 360)]
    assert streaks[0] > 1.2 * streaks[1] > 1.2 * streaks[2]
    edge = (np.abs(y) < 2e-3) & (x > 0.04) & (x < 0.06)
    slope = [float(np.abs(np.diff(fan(360, offset)[SIZE // 2, :])).max()) for offset in (0.0, 2e-3 / SOURCE)]
    assert slope[1] < 0.8 * slope[0]
    assert edge.any()


def test_angles_that_are_no_turn_are_refused() -> None:
    with pytest.raises(UnusableInputError, match="once around"):
        fan_reconstruction(np.zeros((90, 11)), np.linspace(0.0, np.pi, 90), np.linspace(-0.1, 0.1, 11), SOURCE, 16, 1e-3)
