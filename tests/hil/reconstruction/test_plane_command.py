"""isocenter plane: discs come back from a fan and from parallel rays, where they were, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main


def exit_of(*arguments: object) -> int:
    with pytest.raises(SystemExit) as leave:
        main(["plane", *(str(argument) for argument in arguments)])
    return int(leave.value.code or 0)


def lens(one: float, other: float, apart: float) -> float:
    """Area that two circles of these radii share, their middles so far apart."""
    parts = [r**2 * np.arccos((apart**2 + r**2 - s**2) / (2.0 * apart * r)) for r, s in ((one, other), (other, one))]
    sides = (one + other - apart) * (apart + one - other) * (apart - one + other) * (one + other + apart)
    return float(sum(parts) - 0.5 * np.sqrt(sides))


def chords(angles: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Line integrals of a disc of 20 1/m and radius 12 mm at x = 20, y = 9 mm: parallel rays whose bins count along (cos, sin)."""
    middle = 0.020 * np.cos(angles) + 0.009 * np.sin(angles)
    return 20.0 * 2.0 * np.sqrt(np.maximum(0.012**2 - (at - middle[:, None]) ** 2, 0.0))


def test_a_fan_is_made_written_read_and_gives_the_discs_back(tmp_path: Path) -> None:
    fan, out = tmp_path / "fan.npz", tmp_path / "plane"
    assert exit_of(fan, "--disc", "0,0,50,20", "--disc", "18,6,12,10", "-o", out, "--json", tmp_path / "a.json") == 0
    both = 20.0 + 10.0 * lens(25.0, 12.0, np.hypot(18.0, 6.0)) / (np.pi * 25.0**2)  # in the large disc's inner half
    for row, true in zip(json.loads((tmp_path / "a.json").read_text())["discs"], (both, 30.0), strict=True):
        assert row["true_1_m"] == pytest.approx(true, rel=0.003)  # pixels
        assert row["mean_1_m"] == pytest.approx(true, rel=0.01)
    assert (out / "image.png").stat().st_size > 10_000
    first = np.load(out / "image.npz")["image_1_m"]
    assert abs(first[:40, :40][np.hypot(*np.mgrid[-150:-110, -150:-110]) > 155]).max() == 0.0  # a corner that some views do not see
    assert exit_of(fan, "-o", tmp_path / "again") == 0
    np.testing.assert_array_equal(np.load(tmp_path / "again" / "image.npz")["image_1_m"], first)


@pytest.mark.parametrize("turn", [np.pi, 2.0 * np.pi])
def test_parallel_rays_give_a_disc_back_where_it_was(tmp_path: Path, turn: float) -> None:
    angles, at = turn * np.arange(180) / 180, (np.arange(101) - 50) * 1e-3
    np.savez(tmp_path / "p.npz", projections=chords(angles, at), angles_rad=angles, spacing_m=1e-3)
    assert exit_of(tmp_path / "p.npz", "-o", tmp_path / "out") == 0
    image = np.load(tmp_path / "out" / "image.npz")["image_1_m"]
    x, y = np.meshgrid(at, at)
    near, far = np.hypot(x - 0.020, y - 0.009), np.hypot(x + 0.020, y + 0.009)
    assert image[near < 0.008].mean() == pytest.approx(20.0, rel=0.02)
    assert abs(image[far < 0.008].mean()) < 0.2


def test_what_is_of_no_use_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    angles, at = np.pi * np.arange(90) / 90, (np.arange(51) - 25) * 1e-3
    good = {"projections": chords(angles, at), "angles_rad": angles, "spacing_m": 1e-3}
    for change, line in (
        ({"spacing_m": None}, "no array spacing_m"),
        ({"angles_rad": angles[1:]}, r"angles_rad of shape (89,): must be (90,)"),
        ({"angles_rad": 0.7 * angles}, "even steps once or more around half a turn, not over 126 deg"),
        ({"projections": good["projections"] * np.nan}, "projections: must be finite numbers"),
        ({"spacing_m": -1.0}, "spacing_m: must be one positive number"),
        ({"psi_rad": at, "source_m": 0.8}, "angles go once around in even steps"),
    ):
        arrays = {name: value for name, value in {**good, **change}.items() if value is not None}
        np.savez(tmp_path / "p.npz", **arrays)
        assert exit_of(tmp_path / "p.npz", "-o", tmp_path / "out") == 2, change
        assert line in " ".join(capsys.readouterr().err.split())
    np.savez(tmp_path / "p.npz", **good)
    for options, line in (
        (("--window", "square"), "--window square: must be one of ramp"),
        (("--size", "30"), "--size and --spacing: of a fan"),
        (("--disc", "0,0,50"), "--disc 0,0,50: must be four numbers"),
        (("--disc", "0,0,900,20"), "the source must be well outside"),
        (("--disc", "0,0,50,20", "--window", "hann"), "only parallel rays have windows"),
    ):
        assert exit_of(tmp_path / "p.npz", "-o", tmp_path / "out", *options) == 2, options
        assert line in " ".join(capsys.readouterr().err.split())
    assert exit_of(tmp_path / "none.npz", "-o", tmp_path / "out") == 2
    assert "no such file" in capsys.readouterr().err
