"""The geometry of a scan from the scan itself, on clouds whose shadows and plane integrals are closed forms."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hil.calibration.consistency.epipolar import PLANES, lines_of, object_radius, pairs_of
from hil.calibration.consistency.plane_derivatives import plane_derivatives, read
from hil.calibration.consistency.recalibrate import ORDER, Consistent, recalibrate
from hil.calibration.consistency.scale import change
from hil.calibration.consistency.seen_pixels import seen_pixels
from hil.calibration.use.lookup_table import read_look_up
from hil.cli import main
from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.imaging.scan_folder import write_description, write_exposures
from hil.machine import load_machine

tifffile = pytest.importorskip("tifffile", reason="the extra `images` is not installed")

PANEL = Detector(128, 96, 3e-3)
SEED = 5
CENTRES_m = np.random.default_rng(SEED).uniform(-0.03, 0.03, (6, 3))
WIDTH_m, ATTENUATION_1_m = 8e-3, 40.0
"""Of Gaussian clouds: standard deviation, and attenuation in the middle."""
PHOTONS = 2000.0
VIEWS = 20


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


def counts(images: np.ndarray, seed: int) -> np.ndarray:
    """What the panel counts."""
    counted: np.ndarray = np.random.default_rng(seed).poisson(PHOTONS * np.exp(-images)).astype(np.uint16)
    return counted


def changed(beam: ConeBeam, seed: int, size: float = 0.6e-3) -> ConeBeam:
    """The same scan on a machine that has changed since, slowly over its arc, by `size` [m, rad] at degree 0."""
    along = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(beam)), ORDER)
    scale = np.full(9, size) / (1.0 + np.arange(ORDER + 1))[:, None]
    return beam.moved(along @ (scale * np.random.default_rng(seed).standard_normal(scale.shape)))


def found_in(images: np.ndarray, beam: ConeBeam, panel: Detector = PANEL) -> Consistent:
    return recalibrate(lambda k: images[k], panel, beam)


def shape_error_mm(beam: ConeBeam, true: ConeBeam) -> float:
    """Rms distance on the panel of points' shadows in both, the scan's place and size, which nothing shows, fitted."""
    points = np.random.default_rng(SEED).uniform(-0.04, 0.04, (40, 3))

    def seen(geometry: ConeBeam, at: np.ndarray) -> np.ndarray:
        own = np.einsum("nab,pb->npa", geometry.matrices(PANEL), np.column_stack([at, np.ones(len(at))]))
        at_m: np.ndarray = PANEL.pitch_m * own[..., :2] / own[..., 2:]
        return at_m

    wanted = seen(true, points)

    def misfit(place: np.ndarray) -> np.ndarray:
        at = np.exp(place[6]) * Rotation.from_rotvec(place[:3]).apply(points) + 0.01 * place[3:6]
        apart: np.ndarray = (seen(beam, at) - wanted).ravel()
        return apart

    return 1e3 * float(np.sqrt(2.0 * np.mean(least_squares(misfit, np.zeros(7)).fun ** 2)))


def test_an_image_knows_by_how_much_the_integral_over_a_plane_changes() -> None:
    """Over a plane at x from a cloud: A (2 pi) s^2 exp(-x^2 / 2 s^2), blurred by the table's 1.5 pixels over the magnification."""
    beam = circle(6)
    panel = Detector(160, 120, 2.4e-3)
    images = [seen_pixels(1e9 * np.exp(-image), panel) for image in shadows(beam, panel)]
    tables = plane_derivatives(images, panel, beam)
    pairs = pairs_of(beam, 0.05)
    first, second = (
        each.factor * read(tables.known, each.places) for each in lines_of(tables, pairs, beam[pairs.first], beam[pairs.second])
    )
    spot = beam.source_in_phantom_m[pairs.first]
    baseline = beam.source_in_phantom_m[pairs.second] - spot
    baseline /= np.linalg.norm(baseline, axis=1)[:, None]
    nearest = spot - np.sum(spot * baseline, axis=1)[:, None] * baseline
    distance = np.linalg.norm(nearest, axis=1)
    toward = -nearest / distance[:, None]
    tilt = np.arcsin(pairs.radius_m / distance)[:, None] * np.linspace(-1.0, 1.0, PLANES)
    normal = np.cos(tilt)[..., None] * np.cross(baseline, toward)[:, None] - np.sin(tilt)[..., None] * toward[:, None]
    expected = np.zeros(first.shape)
    wide = np.hypot(WIDTH_m, 1.5 * panel.pitch_m / 1.5)
    for centre in CENTRES_m:
        x = ((centre - spot)[:, None] * normal).sum(axis=-1)
        expected += 2.0 * np.pi * ATTENUATION_1_m * (WIDTH_m / wide) ** 3 * x * np.exp(-0.5 * (x / wide) ** 2)
    size = np.sqrt(np.mean(expected**2))
    np.testing.assert_allclose(first, expected, atol=0.07 * size)
    np.testing.assert_allclose(second, expected, atol=0.07 * size)
    furthest = np.linalg.norm(CENTRES_m, axis=1).max()
    assert furthest < object_radius(images, beam) < furthest + 8.0 * WIDTH_m  # without noise a cloud is seen to six; and its margin


def test_what_is_seen_has_the_variance_that_photons_leave_and_nothing_else_is_seen() -> None:
    clean = shadows(circle(1))[0]
    noisy = [seen_pixels(counts(clean[None], seed)[0], PANEL) for seed in range(4)]
    at = np.round(noisy[0].at_m / PANEL.pitch_m + np.array([PANEL.columns - 1, PANEL.rows - 1]) / 2.0).astype(int)
    assert len(at) < 0.6 * clean.size
    unseen = clean.sum() - clean[at[:, 1], at[:, 0]].sum()
    assert abs(unseen) < 0.03 * clean.sum()
    for image in noisy:
        places = np.round(image.at_m / PANEL.pitch_m + np.array([PANEL.columns - 1, PANEL.rows - 1]) / 2.0).astype(int)
        wrong = (image.integral - clean[places[:, 1], places[:, 0]]) / np.sqrt(image.variance)
        assert np.std(wrong) == pytest.approx(1.0, abs=0.1)
        assert not image.cut


def test_a_scan_tells_what_has_changed_in_its_shape_and_how_sure_that_is() -> None:
    beam = circle(VIEWS)
    ratios = []
    for seed in range(SEED, SEED + 3):
        true = changed(beam, seed)
        found = found_in(counts(shadows(true), seed), beam)
        before, after = shape_error_mm(beam, true), shape_error_mm(beam.moved(found.deviation), true)
        print(f"seed {seed}: {before:.3f} mm before, {after:.3f} mm after, {1e3 * found.stated_m:.3f} mm stated")
        assert found.sure
        assert after < 0.5 * before
        ratios.append(1e3 * found.stated_m / after)
    assert 0.7 < np.exp(np.mean(np.log(ratios))) < 1.5


@pytest.mark.nightly
def test_a_scan_that_is_right_already_is_left_alone() -> None:
    beam = circle(VIEWS)
    for seed in range(SEED, SEED + 3):
        found = found_in(counts(shadows(beam), seed), beam)
        assert not found.sure
        assert shape_error_mm(beam.moved(found.deviation), beam) < 2e3 * found.stated_m


def test_the_scale_of_a_change_is_found_from_what_the_images_say() -> None:
    random = np.random.default_rng(SEED)
    information = np.diag(np.geomspace(1.0, 1e4, 40))
    groups = np.diag(np.arange(40) % 2 == 0).astype(float), np.diag(np.arange(40) % 2 == 1).astype(float)
    noise = information.copy()
    true = 0.3 * (np.arange(40) % 2) * random.standard_normal(40)
    score = information @ true + np.sqrt(np.diag(noise)) * random.standard_normal(40)
    found = change(information, score, noise, groups)
    assert found.scales[1] == pytest.approx(0.3, rel=0.5)
    assert found.scales[0] < 0.03
    assert found.gain > 100.0
    wrong = (found.mean - true) / np.sqrt(np.diag(found.covariance))
    assert np.sqrt(np.mean(wrong[1::2] ** 2)) == pytest.approx(1.0, abs=0.3)
    nothing = change(information, np.sqrt(np.diag(noise)) * random.standard_normal(40), noise, groups)
    assert nothing.gain < 12.0


def test_an_object_that_reaches_beyond_the_panel_is_refused() -> None:
    beam = circle(12)
    with pytest.raises(UnusableInputError, match="cut off by the panel's border"):
        found_in(counts(shadows(beam, centres=CENTRES_m + np.array([0.0, 0.09, 0.0])), SEED), beam)


def test_images_of_nothing_are_refused() -> None:
    beam = circle(12)
    with pytest.raises(UnusableInputError, match="shows nothing"):
        found_in(counts(np.zeros((12, PANEL.rows, PANEL.columns)), SEED), beam)


def test_a_scan_to_and_fro_between_two_poses_is_refused() -> None:
    beam = circle(20)[np.arange(20) % 2]
    with pytest.raises(UnusableInputError, match="exposures on the way"):
        found_in(np.zeros((20, PANEL.rows, PANEL.columns)), beam)


def scan_of(folder: Path, images: np.ndarray, positions: np.ndarray) -> Path:
    """A scan's folder."""
    machine = load_machine("carm")
    folder.mkdir()
    write_description(folder, PANEL, machine.axes, {"machine": "carm"})
    times = np.arange(float(len(images)))
    write_exposures(folder, np.arange(len(images)), times, np.full(len(images), 0.01), dict.fromkeys(machine.axes, "rad"), positions)
    tifffile.imwrite(folder / "frames.tif", images)
    return folder


def test_the_command_writes_a_table_that_the_others_read_only_if_something_has_changed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = load_machine("carm")
    positions = np.stack([np.zeros(VIEWS), np.radians(np.linspace(-95.0, 95.0, VIEWS))], axis=1)
    nominal = nominal_beam(machine, positions)
    new, answer_file = tmp_path / "new.npz", tmp_path / "answer.json"
    for name, true, status in (("as it was", nominal, 1), ("changed", changed(nominal, SEED), 0)):
        scan = scan_of(tmp_path / name, counts(shadows(true), SEED), positions)
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "consistency", "carm", str(scan), "-o", str(new), "--json", str(answer_file)])
        assert (ended.value.code or 0) == status
        answer = json.loads(answer_file.read_text())
        assert new.exists() == answer["changed"] == (status == 0)
        said = capsys.readouterr().out
        assert ("say nothing more than the drawing of carm" in said) == (status == 1)
    table = read_look_up(new)
    table.require(machine)
    np.testing.assert_allclose(table.deviation, answer["deviation"], atol=1e-9)
    assert "say that shadows lie" in said
