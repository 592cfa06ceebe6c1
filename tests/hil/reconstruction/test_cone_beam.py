"""FDK gives back what was projected, about either axis, with the geometry of each exposure; wrong geometry shows in a wire.

All that loads the toolkit stands here, since loading it takes longer than all tests with it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scans_to_reconstruct import reconstruct as told_to_reconstruct
from scans_to_reconstruct import scan_of, table_of
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.imaging import ConeBeam, Detector
from hil.reconstruction.fdk import Volume, line_integrals, ramp_filtered, reconstruct, short_scan_weights
from hil.reconstruction.wire_profiles import wire_quality
from virtual_bus.xray.objects import Ball, Rod
from virtual_bus.xray.render import Panel, View, attenuation

pytestmark = pytest.mark.slow  # the toolkit takes a quarter of a minute to load

DETECTOR = Detector(columns=160, rows=160, pitch_m=1.0e-3)
PANEL = Panel(columns=160, rows=160, pitch_m=1.0e-3)
itk = pytest.importorskip("itk")


def scan(axis: str, count: int = 90, seed: int | None = None) -> ConeBeam:
    """A short scan; with a seed, every exposure is off by millimetres and milliradians."""
    rotation = Rotation.from_euler(axis, np.linspace(-1.72, 1.72, count)[:, None]).as_matrix()
    beam = ConeBeam.from_frames(rotation @ [0.0, 0.0, -0.81], rotation @ [0.0, 0.0, 0.35], rotation)
    if seed is None:
        return beam
    return beam.moved(np.random.default_rng(seed).normal(0.0, np.repeat([0.5e-3, 0.5e-3, 1e-3], 3), (count, 9)))


def projections(beam: ConeBeam, items: list[Ball | Rod]) -> np.ndarray:
    views = [View(beam.source_in_phantom_m[k], beam.detector_in_phantom_m[k], beam.rotation[k]) for k in range(len(beam))]
    return np.array([attenuation(view, PANEL, items, rays=1) for view in views])


def test_rtk_projects_the_same_balls() -> None:
    panel = Panel(columns=201, rows=161, pitch_m=0.5e-3)
    rng = np.random.default_rng(4)
    turn = Rotation.from_euler("xyz", [0.2, -0.5, 0.1]).as_matrix()
    view = View(turn @ np.array([0.004, -0.003, -0.81]), turn @ np.array([0.0, 0.0, 0.35]), turn)
    image_type = itk.Image[itk.F, 3]
    geometry = itk.RTK.ThreeDCircularProjectionGeometry.New()
    point, vector = itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
    geometry.AddProjection(point(1e3 * view.source_m), point(1e3 * view.panel_m), vector(turn[:, 0]), vector(turn[:, 1]))
    stack = itk.RTK.ConstantImageSource[image_type].New()
    stack.SetSpacing([0.5, 0.5, 1.0])
    stack.SetSize([201, 161, 1])
    stack.SetOrigin([-50.0, -40.0, 0.0])
    ball = Ball(rng.uniform(-0.02, 0.02, 3), 0.02, 0.3)
    shape = itk.RTK.RayEllipsoidIntersectionImageFilter[image_type, image_type].New()
    shape.SetInput(stack.GetOutput())
    shape.SetGeometry(geometry)
    shape.SetCenter(vector(1e3 * ball.center_m))
    shape.SetAxis(vector([20.0, 20.0, 20.0]))
    shape.SetDensity(0.3)
    shape.Update()
    expected = itk.array_from_image(shape.GetOutput())[0]
    ours = attenuation(view, panel, [ball], rays=1) * 1e3  # RTK counts millimetres
    np.testing.assert_allclose(ours, expected, atol=1e-5 * expected.max())


@pytest.mark.parametrize("axis", ["y", pytest.param("x", marks=pytest.mark.nightly)])
def test_two_balls_come_back_with_their_attenuation_and_place(axis: str) -> None:
    balls = [Ball(np.array([0.005, 0.003, -0.004]), 0.02, 20.0), Ball(np.array([0.012, 0.0, 0.0]), 0.006, 30.0)]
    beam = scan(axis)
    volume = reconstruct(projections(beam, balls), DETECTOR, beam, size=64)
    inside, both, outside = volume.sample(np.array([[0.005, -0.010, -0.004], [0.012, 0.0, 0.0], [-0.025, 0.0, 0.0]]))
    assert inside == pytest.approx(20.0, rel=0.01)
    assert both == pytest.approx(50.0, rel=0.02)
    assert abs(outside) < 1.0


@pytest.mark.nightly
def test_a_table_of_another_version_of_the_machine_s_file_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, scan = table_of(tmp_path / "t.npz", hash="0"), scan_of(tmp_path / "scan")
    status, said = told_to_reconstruct(capsys, scan, "--lookup", table, "--size", 16, "-o", tmp_path / "out")
    assert status == 0
    assert "t.npz was made with another version of carm's file; its deviations are used as they are" in said.out


@pytest.mark.parametrize(
    ("speed", "told"),
    [
        pytest.param([0.0, 3.2 / 23.0], False, marks=pytest.mark.nightly),
        pytest.param(None, False, marks=pytest.mark.nightly),
        ([0.0, -3.2 / 23.0], True),
        pytest.param([0.0, 0.25], True, marks=pytest.mark.nightly),
    ],
)
def test_a_table_made_at_another_speed_or_the_other_way_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], speed: list[float] | None, told: bool
) -> None:
    table, scan = table_of(tmp_path / "t.npz", speed=speed), scan_of(tmp_path / "scan")
    status, said = told_to_reconstruct(capsys, scan, "--lookup", table, "--size", 16, "-o", tmp_path / "out")
    assert status == 0
    assert ("roll went at" in said.out) == told
    assert not told or "what bends with speed is not this scan's" in said.out


@pytest.mark.parametrize("hann", [0.0, 0.7])
def test_the_ramp_is_that_of_rtk(hann: float) -> None:
    itk = pytest.importorskip("itk")
    images = np.random.default_rng(0).random((3, 20, 32), dtype=np.float32)
    stack = itk.image_from_array(images)
    stack.SetSpacing([1.3, 0.9, 1.0])
    ramp = itk.RTK.FFTRampImageFilter[itk.Image[itk.F, 3], itk.Image[itk.F, 3], itk.D].New()
    ramp.SetInput(stack)
    ramp.SetHannCutFrequency(hann)
    ramp.Update()
    assert np.abs(1e3 * itk.array_from_image(ramp.GetOutput()) - ramp_filtered(images, 1.3e-3, hann)).max() < 1e-6 * 770.0


@pytest.mark.parametrize("arc_deg", [190.0, 200.0])
@pytest.mark.parametrize("sweep", [1.0, -1.0])
@pytest.mark.parametrize("columns_grow", [1.0, -1.0])
def test_a_line_that_is_measured_twice_weighs_as_much_as_one_measured_once(arc_deg: float, sweep: float, columns_grow: float) -> None:
    arc, columns, pitch_m = np.radians(arc_deg), 161, 1e-3
    seen = 0
    for turn, column in itertools.product([0.05, 0.1, 0.2, 0.3], [30, 60, 79, 100, 131]):
        source, panel, u = circle([turn], sweep, columns_grow)
        ray = panel[0] + (column - 80) * pitch_m * u[0] - source[0]
        ray /= np.linalg.norm(ray)
        x, _, z = source[0] - 2.0 * (source[0] @ ray) * ray  # where the line leaves the circle is the focal spot that sees it again
        again = sweep * np.arctan2(x, z) % (2.0 * np.pi)
        if again < arc:
            turns = np.sort([0.0, turn, 0.5 * np.pi, again, arc])
            source, panel, u = circle(turns, sweep, columns_grow)
            beam = ConeBeam.from_frames(source, panel, np.stack([u, np.cross(-source / 0.81, u), -source / 0.81], axis=2))
            weights = short_scan_weights(beam, u, pitch_m, columns, arc)
            both = weights[np.searchsorted(turns, turn), column] + weights[np.searchsorted(turns, again), columns - 1 - column]
            assert both == pytest.approx(2.0, abs=1e-6), (turn, column, both)
            seen += 1
    assert seen >= 5


def circle(turns: list[float] | np.ndarray, sweep: float, columns_grow: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Focal spot, panel centre and direction of the columns of a scan about y."""
    angle = sweep * np.asarray(turns)
    outwards = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1)
    return 0.81 * outwards, -0.35 * outwards, columns_grow * np.stack([np.cos(angle), 0.0 * angle, -np.sin(angle)], axis=1)


def test_a_ball_that_fills_the_panel_is_flat() -> None:
    beam = scan("y")
    volume = reconstruct(projections(beam, [Ball(np.zeros(3), 0.045, 20.0)]), DETECTOR, beam, size=48, spacing_m=2e-3)
    x, z = (values.ravel() for values in np.meshgrid(*2 * [np.linspace(-0.035, 0.035, 15)]))
    inside = volume.sample(np.stack([x, 0.0 * x, z], axis=1)[np.hypot(x, z) < 0.035])
    np.testing.assert_allclose(inside, 20.0, rtol=0.01)


def test_every_exposure_s_own_geometry_is_used() -> None:
    wire = Rod(np.array([0.004, -0.008, 0.003]), np.array([0.004, 0.008, 0.003]), 0.5e-3, 500.0)
    true = scan("y", seed=4)
    images = projections(true, [wire])
    with_true = wire_quality(reconstruct(images, DETECTOR, true, size=64, spacing_m=0.35e-3), wire.start_m, wire.end_m, 500.0)
    with_nominal = wire_quality(reconstruct(images, DETECTOR, scan("y"), size=64, spacing_m=0.35e-3), wire.start_m, wire.end_m, 500.0)
    assert np.linalg.norm(with_true.offset_m) < 0.1e-3
    assert with_true.widths_m.max() < 2.5e-3
    assert with_nominal.peak_ratio < 0.8 * with_true.peak_ratio < 0.8
    assert with_true.peak_ratio == pytest.approx(with_true.peak_1_m / 500.0)
    assert with_nominal.widths_m.max() > 1.3 * with_true.widths_m.max()


def test_a_rod_much_wider_than_voxels_keeps_its_whole_peak() -> None:
    rod = Rod(np.array([0.0, -0.03, 0.0]), np.array([0.0, 0.03, 0.0]), 8e-3, 20.0)
    beam = scan("y")
    volume = reconstruct(projections(beam, [rod]), DETECTOR, beam, size=48, spacing_m=2e-3)
    assert 0.97 < wire_quality(volume, rod.start_m, rod.end_m, 20.0).peak_ratio < 1.1  # its edges overshoot, by the voxels' size


def test_a_wire_is_judged_as_far_as_the_volume_holds_it() -> None:
    wire = Rod(np.array([0.0, -0.03, 0.0]), np.array([0.0, 0.03, 0.0]), 2e-3, 20.0)
    beam = scan("y")
    whole = reconstruct(projections(beam, [wire]), DETECTOR, beam, size=64, spacing_m=1e-3)
    small = replace(whole, values=whole.values[20:44, 20:44, 20:44])  # 24 of the 36 mm that are looked at
    here, there = (wire_quality(volume, wire.start_m, wire.end_m, 20.0) for volume in (whole, small))
    assert there.peak_ratio == pytest.approx(here.peak_ratio, rel=0.02)
    assert there.peak_ratio > 0.9
    with pytest.raises(UnusableInputError, match="not in the volume, which is 24 mm wide"):
        wire_quality(small, wire.start_m + np.array([0.0, 0.03, 0.0]), wire.end_m + np.array([0.0, 0.03, 0.0]), 20.0)
    with pytest.raises(UnusableInputError, match="nothing attenuates where it should be"):
        wire_quality(replace(whole, values=np.zeros_like(whole.values)), wire.start_m, wire.end_m, 20.0)


@pytest.mark.parametrize("size", [11, 41])
def test_artefacts_are_looked_for_inside_of_the_volume(size: int) -> None:
    values = np.ones((size, size, size), dtype=np.float32)
    values[size // 2, :, size // 2] = 100.0
    wire = np.array([0.0, -0.03, 0.0]), np.array([0.0, 0.03, 0.0])
    quality = wire_quality(Volume(values, 1e-3, np.eye(3)), *wire, 200.0)
    assert (quality.artefact, quality.peak_ratio) == pytest.approx((0.01, 0.5))


def test_a_shift_of_the_world_moves_the_wire_and_leaves_it_sharp() -> None:
    wire = Rod(np.array([0.004, -0.008, 0.003]), np.array([0.004, 0.008, 0.003]), 0.5e-3, 500.0)
    beam = scan("y")
    images = projections(beam, [wire])
    moved = beam.referred_to(np.array([2e-3, 0.0, -1e-3]), np.eye(3))
    here = wire_quality(reconstruct(images, DETECTOR, beam, size=64, spacing_m=0.35e-3), wire.start_m, wire.end_m, 500.0)
    there = wire_quality(reconstruct(images, DETECTOR, moved, size=64, spacing_m=0.35e-3), wire.start_m, wire.end_m, 500.0)
    np.testing.assert_allclose(there.offset_m - here.offset_m, [-2e-3, 0.0, 1e-3], atol=0.05e-3)
    assert there.peak_1_m == pytest.approx(here.peak_1_m, rel=0.1)


def test_line_integrals_undo_the_exponential() -> None:
    np.testing.assert_allclose(line_integrals(1000.0 * np.exp(-np.array([[0.0, 1.0, 3.0]])), 1000.0), [[0.0, 1.0, 3.0]], atol=1e-5)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda p, b: (p[:10], b[:10]), "10 projections; a reconstruction needs 20"),
        (lambda p, b: (p[:60], b[:60]), "the scan covers 131 degrees; a reconstruction needs 150"),
        (lambda p, b: (p[:, :, :80], b), "90 exposures of 160 x 160 pixels differ"),
    ],
)
def test_what_cannot_be_reconstructed_is_named(change: Callable[..., object], line: str) -> None:
    beam = scan("y")
    with pytest.raises(UnusableInputError, match=line):
        reconstruct(*_with_detector(*change(np.zeros((90, 160, 160)), beam)))


def _with_detector(images: np.ndarray, beam: ConeBeam) -> tuple[np.ndarray, Detector, ConeBeam]:
    return images, DETECTOR, beam


def test_skewed_pixels_are_refused_not_ignored() -> None:
    with pytest.raises(UnusableInputError, match=r"skewed by 0\.01 columns a row"):
        reconstruct(np.zeros((90, 160, 160)), replace(DETECTOR, skew=0.01), scan("y"))
