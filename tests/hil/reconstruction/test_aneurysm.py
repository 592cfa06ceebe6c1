"""The shape of an aneurysm: a dome on a vessel whose numbers are known in closed form, in any orientation, with blur and noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scans_to_reconstruct import refused, scan_of
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.reconstruction.aneurysm import UNITS, aneurysm_shape
from hil.reconstruction.fdk import Volume

pytest.importorskip("skimage", reason="shapes need the extra imaging")

BALL_M, ABOVE_M, LUMEN_1_M = 3.5e-3, 2.2e-3, 60.0
SPACING_M, SIZE, FINER = 0.4e-3, 56, 3
CENTER = np.array([0.0, 0.0, 5e-3])
NECK = CENTER - [0.0, 0.0, ABOVE_M]


def closed_form() -> dict[str, float]:
    """A ball of 3.5 mm cut by a plane 2.2 mm under its centre."""
    height, neck = BALL_M + ABOVE_M, 2.0 * np.sqrt(BALL_M**2 - ABOVE_M**2)
    volume, wall = np.pi * height**2 * (3.0 * BALL_M - height) / 3.0, 2.0 * np.pi * BALL_M * height
    surface = wall + 0.25 * np.pi * neck**2
    return {
        "volume": volume,
        "wall_area": wall,
        "neck_width": neck,
        "dome_height": height,
        "dome_width": 2.0 * BALL_M,
        "aspect_ratio": height / neck,
        "bottleneck_factor": 2.0 * BALL_M / neck,
        "sphericity": np.pi ** (1 / 3) * (6.0 * volume) ** (2 / 3) / surface,
    }


def vessel(seed: int, blur_m: float = 0.3e-3, noise: float = 0.05) -> tuple[Volume, np.ndarray, np.ndarray]:
    """A vessel of 2 mm radius along y with the ball on it, somewhere between voxels; volume, neck and dome in the phantom's frame."""
    rng = np.random.default_rng(seed)
    rotation, shift = Rotation.random(random_state=seed).as_matrix(), rng.uniform(-0.5, 0.5, 3) * SPACING_M
    fine = (np.arange(SIZE * FINER) - (SIZE * FINER - 1) / 2) * SPACING_M / FINER
    x, y, z = (each - by for each, by in zip(np.meshgrid(fine, fine, fine, indexing="ij")[::-1], shift, strict=True))
    inside = (np.hypot(x, z) < 2e-3) | (x**2 + y**2 + (z - CENTER[2]) ** 2 < BALL_M**2)
    values = LUMEN_1_M * inside.reshape(SIZE, FINER, SIZE, FINER, SIZE, FINER).mean(axis=(1, 3, 5))
    values = gaussian_filter(values, blur_m / SPACING_M) + noise * LUMEN_1_M * rng.standard_normal(values.shape)
    return Volume(values.astype(np.float32), SPACING_M, rotation), rotation @ (NECK + shift), rotation @ (CENTER + shift)


def test_every_number_is_true_within_its_deviation() -> None:
    """Standardised errors over several noises, orientations and places between voxels."""
    truth = closed_form()
    assert set(truth) == set(UNITS)
    off: dict[str, list[float]] = {name: [] for name in truth}
    for seed in range(4):
        shape = aneurysm_shape(*vessel(seed))
        for name, true in truth.items():
            assert shape.values[name] == pytest.approx(true, rel=0.05)
            assert shape.deviations[name] < 0.08 * true
            off[name].append((shape.values[name] - true) / shape.deviations[name])
    for name, scores in off.items():
        assert np.sqrt(np.mean(np.square(scores))) < 2.0, (name, scores)


def test_more_noise_is_more_deviation() -> None:
    few, much = (aneurysm_shape(*vessel(1, noise=noise)).deviations for noise in (0.01, 0.15))
    assert all(much[name] > few[name] for name in ("neck_width", "dome_width", "sphericity"))


def test_what_is_no_closed_dome_is_one_line() -> None:
    volume, neck, dome = vessel(2)
    axis = (dome - neck) / np.linalg.norm(dome - neck)
    with pytest.raises(UnusableInputError, match="a vessel leaves it"):
        aneurysm_shape(volume, neck - 5e-3 * axis, dome - 4.5e-3 * axis)
    with pytest.raises(UnusableInputError, match="no lumen is there"):
        aneurysm_shape(volume, neck + 8e-3 * axis, dome + 8e-3 * axis)
    with pytest.raises(UnusableInputError, match="less than a voxel"):
        aneurysm_shape(volume, neck, neck)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--neck", "1,2,3"], "--neck and --dome: give both, or none"),
        (["--neck", "1,2", "--dome", "1,2,3"], "--neck 1,2: must be three numbers in mm"),
    ],
)
def test_points_that_are_none_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], line: str) -> None:
    assert line in refused(capsys, scan_of(tmp_path / "scan"), *options, "-o", tmp_path / "out")
