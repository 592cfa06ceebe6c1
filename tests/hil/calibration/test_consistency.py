"""The geometry of a scan from the scan itself, on clouds whose shadows and plane integrals are closed forms."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hil.calibration.consistency.epipolar import pairs_of, said, visible_radius
from hil.calibration.consistency.plane_derivatives import plane_derivatives
from hil.calibration.consistency.recalibrate import ORDER, PRIOR, recalibrate
from hil.calibration.use.lookup_table import read_look_up
from hil.cli import main
from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.imaging.scan_folder import write_description, write_exposures
from hil.machine import load_machine

pytest.importorskip("skimage", reason="the extra `imaging` is not installed")
tifffile = pytest.importorskip("tifffile", reason="the extra `images` is not installed")

PANEL = Detector(64, 48, 6e-3)
SEED = 5
CENTRES_m = np.random.default_rng(SEED).uniform(-0.03, 0.03, (6, 3))
WIDTH_m, ATTENUATION_1_m = 8e-3, 40.0
"""Of Gaussian clouds: standard deviation, and attenuation in the middle."""
NOISE = 0.003


def circle(count: int) -> ConeBeam:
    """200 degrees, the focal spot at 0.8 m and the panel at 0.4 m from the isocentre."""
    angle = np.radians(np.linspace(0.0, 200.0, count))
    toward = np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)
    rows = np.tile([0.0, 1.0, 0.0], (count, 1))
    return ConeBeam.from_frames(-0.8 * toward, 0.4 * toward, np.stack([np.cross(rows, toward), rows, toward], axis=-1))


def shadows(beam: ConeBeam, panel: Detector = PANEL, centres: np.ndarray = CENTRES_m) -> np.ndarray:
    """Line integrals (N, rows, columns) of the clouds."""
    columns, rows = np.meshgrid(np.arange(panel.columns), np.arange(panel.rows))
    points = np.concatenate([panel.to_metres(np.stack([columns, rows], axis=-1)), np.zeros((*columns.shape, 1))], axis=-1)
    images = np.zeros((len(beam), *columns.shape))
    for k in range(len(beam)):
        ray = points - beam.source_m[k]
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        for centre in centres:
            to_cloud = beam.rotation[k].T @ centre + beam.phantom_m[k] - beam.source_m[k]
            aside = to_cloud @ to_cloud - (ray @ to_cloud) ** 2
            images[k] += ATTENUATION_1_m * WIDTH_m * np.sqrt(2.0 * np.pi) * np.exp(-0.5 * aside / WIDTH_m**2)
    return images


def changed(beam: ConeBeam, seed: int) -> ConeBeam:
    """The same scan on a machine that has changed since, slowly over its arc."""
    along = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(beam)), ORDER)
    scale = PRIOR / (1.0 + np.arange(ORDER + 1))[:, None]
    return beam.moved(along @ (scale * np.random.default_rng(seed).standard_normal(scale.shape)))


def shape_error_mm(beam: ConeBeam, true: ConeBeam) -> float:
    """Rms distance on the panel of points' shadows in both, the scan's place and size, which nothing shows, fitted."""
    points = np.random.default_rng(SEED).uniform(-0.04, 0.04, (40, 3))

    def seen(geometry: ConeBeam, at: np.ndarray) -> np.ndarray:
        own = np.einsum("nab,pb->npa", geometry.matrices(PANEL), np.column_stack([at, np.ones(len(at))]))
        return PANEL.pitch_m * own[..., :2] / own[..., 2:]

    wanted = seen(true, points)

    def misfit(place: np.ndarray) -> np.ndarray:
        at = np.exp(place[6]) * Rotation.from_rotvec(place[:3]).apply(points) + 0.01 * place[3:6]
        return (seen(beam, at) - wanted).ravel()

    return 1e3 * float(np.sqrt(2.0 * np.mean(least_squares(misfit, np.zeros(7)).fun ** 2)))


def test_an_image_knows_by_how_much_the_integral_over_a_plane_changes() -> None:
    """Over a plane at x from a cloud: A (2 pi) s^2 exp(-x^2 / 2 s^2), here blurred by the table's pixel, one over the magnification."""
    beam = circle(6)
    panel = Detector(160, 120, 2.4e-3)
    known = plane_derivatives(shadows(beam, panel), panel, beam)
    pairs = pairs_of(beam, 0.05)
    first, second = said(known, pairs, beam[pairs.first], beam[pairs.second])
    spot = beam.source_in_phantom_m[pairs.first]
    baseline = beam.source_in_phantom_m[pairs.second] - spot
    baseline /= np.linalg.norm(baseline, axis=1)[:, None]
    nearest = spot - np.sum(spot * baseline, axis=1)[:, None] * baseline
    distance = np.linalg.norm(nearest, axis=1)
    toward = -nearest / distance[:, None]
    tilt = np.arcsin(pairs.radius_m / distance)[:, None] * np.linspace(-1.0, 1.0, first.shape[1])
    normal = np.cos(tilt)[..., None] * np.cross(baseline, toward)[:, None] - np.sin(tilt)[..., None] * toward[:, None]
    expected = np.zeros(first.shape)
    wide = np.hypot(WIDTH_m, panel.pitch_m / 1.5)
    for centre in CENTRES_m:
        x = ((centre - spot)[:, None] * normal).sum(axis=-1)
        expected += 2.0 * np.pi * ATTENUATION_1_m * (WIDTH_m / wide) ** 3 * x * np.exp(-0.5 * (x / wide) ** 2)
    size = np.sqrt(np.mean(expected**2))
    np.testing.assert_allclose(first, expected, atol=0.05 * size)
    np.testing.assert_allclose(second, expected, atol=0.05 * size)
    assert visible_radius(beam, panel) == pytest.approx(0.5 * 120 * 2.4e-3 * 0.8 / 1.2)


def test_a_scan_tells_what_has_changed_in_its_shape() -> None:
    beam = circle(20)
    true = changed(beam, SEED)
    found = recalibrate(shadows(true) + NOISE * np.random.default_rng(SEED).standard_normal((20, 48, 64)), PANEL, beam)
    before, after = shape_error_mm(beam, true), shape_error_mm(beam.moved(found.deviation), true)
    print(f"seed {SEED}: {before:.3f} mm before, {after:.3f} mm after")
    assert after < 0.15 * before
    assert found.after < 0.3 * found.before
    wrong = found.deviation - true.deviation_from(beam)
    stated = np.sqrt(np.mean(np.diagonal(found.covariance, axis1=1, axis2=2), axis=0))
    ratio = stated / np.sqrt(np.mean(wrong**2, axis=0))
    assert 0.3 < np.median(ratio) < 3.0


def test_an_object_that_reaches_beyond_the_panel_is_refused() -> None:
    beam = circle(12)
    with pytest.raises(UnusableInputError, match="cut off by the panel's border"):
        recalibrate(shadows(beam, centres=CENTRES_m + np.array([0.0, 0.09, 0.0])), PANEL, beam)


def test_a_scan_to_and_fro_between_two_poses_is_refused() -> None:
    beam = circle(20)[np.arange(20) % 2]
    with pytest.raises(UnusableInputError, match="exposures on the way"):
        recalibrate(np.zeros((20, 48, 64)), PANEL, beam)


def test_the_command_writes_a_table_that_the_others_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = load_machine("carm")
    positions = np.stack([np.zeros(16), np.radians(np.linspace(-95.0, 95.0, 16))], axis=1)
    nominal = nominal_beam(machine, positions)
    counts = 2e4 * np.exp(-shadows(changed(nominal, SEED)))
    scan = tmp_path / "scan"
    scan.mkdir()
    write_description(scan, PANEL, machine.axes, {"machine": "carm"})
    write_exposures(scan, np.arange(16), np.arange(16.0), np.full(16, 0.01), dict.fromkeys(machine.axes, "rad"), positions)
    tifffile.imwrite(scan / "frames.tif", np.round(counts).astype(np.uint16))
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "consistency", "carm", str(scan), "-o", str(tmp_path / "new.npz"), "--json", str(tmp_path / "answer.json")])
    assert ended.value.code in (0, None)
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert answer["contradiction_after"] < 0.5 * answer["contradiction_before"]
    table = read_look_up(tmp_path / "new.npz")
    table.require(machine)
    np.testing.assert_allclose(table.deviation, answer["deviation"], atol=1e-9)
    assert "contradicted each other by" in capsys.readouterr().out
