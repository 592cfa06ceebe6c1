"""Geometry that other programs wrote: vectors of ASTRA, LEAP and TIGRE, and Enhanced XA, in both directions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hil.cli import main
from hil.errors import UnusableInputError
from hil.imaging import ConeBeam, Detector
from hil.imaging.exchange.dicom_enhanced import write_enhanced_xa
from hil.imaging.exchange.dicom_file import read_xa
from hil.imaging.exchange.dicom_xa import Positioner, decimal, positioner_of, write_xa
from hil.imaging.exchange.read_vectors import Vectors, program_of, read_bare_vectors, read_vectors
from hil.imaging.exchange.vectors import write_vectors
from hil.imaging.nominal import nominal_beam
from hil.machine import load_machine

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

CARM = load_machine("carm")
PANEL = Detector(columns=620, rows=480, pitch_m=0.6e-3, aspect=1.01)
SKEWED = Detector(columns=620, rows=480, pitch_m=0.6e-3, aspect=1.01, skew=0.002)
POINTS = np.random.default_rng(3).uniform(-0.08, 0.08, (20, 3))


def beam(seed: int, exposures: int = 7) -> ConeBeam:
    """The C-arm with every parameter off by millimetres and milliradians."""
    rng = np.random.default_rng(seed)
    positions = np.radians(np.column_stack([rng.uniform(-80.0, 80.0, exposures), rng.uniform(-90.0, 90.0, exposures)]))
    return nominal_beam(CARM, positions).moved(rng.normal(0.0, 5e-3, (exposures, 9)))


def pixels(of: ConeBeam, detector: Detector) -> np.ndarray:
    """Columns and rows (N, P, 2) of the points."""
    seen = np.einsum("nij,pj->npi", of.matrices(detector), np.column_stack([POINTS, np.ones(len(POINTS))]))
    found: np.ndarray = seen[..., :2] / seen[..., 2:]
    return found


def read_back(path: Path) -> Vectors:
    return read_vectors(path, dict(np.load(path)), Detector(1, 1, 1e-3))


@settings(max_examples=examples(30), deadline=None)
@given(seed=st.integers(0, 2**20), program=st.sampled_from(["astra", "leap", "tigre"]))
def test_vectors_read_back_with_their_panel(tmp_path_factory: pytest.TempPathFactory, seed: int, program: str) -> None:
    path = tmp_path_factory.mktemp("vectors") / f"{program}.npz"
    ours, detector = beam(seed), SKEWED if program == "astra" else PANEL
    write_vectors(path, ours, detector, program)
    found = read_back(path)
    assert found.program == program_of(dict(np.load(path))) == program
    assert (found.detector.columns, found.detector.rows) == (620, 480)
    assert found.flipped == (program == "tigre")  # as its images are, which were flipped for it
    np.testing.assert_allclose(pixels(found.beam, found.detector), pixels(ours, detector), atol=2e-2 if program == "leap" else 1e-6)


def test_astra_s_documented_circle_is_read_from_a_bare_array(tmp_path: Path) -> None:
    """Source and panel go round the z axis, u in the plane of the circle, v along z, as its documentation of cone_vec has them."""
    angles = np.linspace(0.0, 3.0, 9)
    c, s, nil = np.cos(angles), np.sin(angles), np.zeros(9)
    rows = np.column_stack([810 * s, -810 * c, nil, -350 * s, 350 * c, nil, 0.6 * c, 0.6 * s, nil, nil, nil, 0.7 + nil])
    np.save(tmp_path / "a.npy", rows)
    found = read_bare_vectors(tmp_path / "a.npy", PANEL)
    panel = found.detector
    assert (panel.columns, panel.rows, panel.pitch_m, panel.aspect, panel.skew) == (
        620,
        480,
        pytest.approx(0.6e-3),
        pytest.approx(0.7 / 0.6),
        0.0,
    )
    k, point = 4, np.array([0.03, -0.02, 0.05])
    source, center, u, v = (rows[k, start : start + 3] for start in (0, 3, 6, 9))
    steps = np.linalg.solve(np.column_stack([u, v, source - 1e3 * point]), source - center)[:2]
    seen = found.beam.matrices(panel)[k] @ [*point, 1.0]
    row = seen[1] / seen[2]
    assert seen[0] / seen[2] == pytest.approx(309.5 + steps[0], abs=1e-9)
    assert (479.0 - row if found.flipped else row) == pytest.approx(239.5 + steps[1], abs=1e-9)


def test_tigre_s_plain_scan_has_angles_about_z_and_single_numbers(tmp_path: Path) -> None:
    """As its first demo describes one: DSO, DSD, nDetector, dDetector, angles of one number each."""
    arrays = {"DSO": 810.0, "DSD": 1160.0, "nDetector": [480, 620], "dDetector": [0.6, 0.6], "angles": np.radians([0.0, 90.0])}
    found = read_vectors(tmp_path / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    np.testing.assert_allclose(1e3 * found.beam.source_in_phantom_m, [[810, 0, 0], [0, 810, 0]], atol=1e-9)
    np.testing.assert_allclose(1e3 * found.beam.detector_in_phantom_m, [[-350, 0, 0], [0, -350, 0]], atol=1e-9)
    moved = read_vectors(tmp_path / "a.npz", {name: np.asarray(one) for name, one in (arrays | {"offOrigin": [0, 0, 5]}).items()}, PANEL)
    assert moved.notes == ("offOrigin is the volume's place and was not taken",)


def on_panel(source: np.ndarray, center: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Columns and rows (P, 2) where rays [mm] through the points meet a panel, from its middle in steps u and v."""
    steps = [np.linalg.solve(np.column_stack([u, v, source - point]), source - center)[:2] for point in 1e3 * POINTS]
    return np.array(steps) + np.array([309.5, 239.5])


def seen_as_written(found: Vectors) -> np.ndarray:
    """Columns and rows (N, P, 2), counted as the program that wrote the file counts them."""
    seen = pixels(found.beam, found.detector)
    if found.flipped:
        seen[..., 1] = found.detector.rows - 1 - seen[..., 1]
    return seen


@pytest.mark.parametrize("cor", [2.5, -7.0, (1.0, -2.0, 3.0, 4.0)])
def test_tigre_s_centre_of_rotation_moves_source_and_panel(tmp_path: Path, cor: float | tuple[float, ...]) -> None:
    """By COR across the first angle, after the turn, as its projectors add it."""
    angles = np.column_stack([np.linspace(0.1, 3.0, 4), np.linspace(0.0, 0.4, 4), np.linspace(0.0, -0.3, 4)])
    arrays = {
        "DSO": 810.0,
        "DSD": 1160.0,
        "nDetector": [480, 620],
        "dDetector": [0.6, 0.6],
        "angles": angles,
        "COR": cor,
        "offDetector": [3.0, 9.0],
    }
    found = read_vectors(tmp_path / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    for k, (alpha, theta, psi) in enumerate(angles):
        ca, sa, ct, st_, cp, sp = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi)
        turn = np.array(
            [
                [ca * ct * cp - sa * sp, -ca * ct * sp - sa * cp, ca * st_],
                [sa * ct * cp + ca * sp, -sa * ct * sp + ca * cp, sa * st_],
                [-st_ * cp, st_ * sp, ct],
            ]
        )
        aside = np.broadcast_to(cor, 4)[k] * np.array([-sa, ca, 0.0])
        expected = on_panel(turn @ [810.0, 0, 0] + aside, turn @ [-350.0, 9.0, 3.0] + aside, 0.6 * turn[:, 1], 0.6 * turn[:, 2])
        np.testing.assert_allclose(seen_as_written(found)[k], expected, atol=1e-6)


def test_astra_s_circle_of_few_numbers_is_read(tmp_path: Path) -> None:
    """A point's pixel by similar triangles in the frame that turns with the scan; ASTRA's own conversion where it is installed."""
    angles = np.linspace(0.0, 3.0, 5)
    names = (
        "DetectorSpacingX",
        "DetectorSpacingY",
        "DetectorRowCount",
        "DetectorColCount",
        "DistanceOriginSource",
        "DistanceOriginDetector",
    )
    arrays = dict(zip(names, (0.6, 0.7, 480, 620, 810.0, 350.0), strict=True)) | {"type": "cone", "ProjectionAngles": angles}
    found = read_vectors(tmp_path / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    x, y, z = 1e3 * POINTS.T
    for k, angle in enumerate(angles):
        c, s = np.cos(angle), np.sin(angle)
        magnification = 1160.0 / (810.0 - (s * x - c * y))
        expected = np.column_stack([309.5 + magnification * (c * x + s * y) / 0.6, 239.5 + magnification * z / 0.7])
        np.testing.assert_allclose(seen_as_written(found)[k], expected, atol=1e-6)


@pytest.mark.parametrize(("tau", "row", "column"), [(0.0, 239.5, 309.5), (4.0, 239.5, 309.5), (-3.0, 200.0, 60.0)])
def test_leap_s_circle_of_few_numbers_is_read(tmp_path: Path, tau: float, row: float, column: float) -> None:
    """Pixels of a point by its manual: (x p + tau) / (R - x t) and z / (R - x t), of angles that it counts from -90 degrees."""
    phis = np.linspace(0.0, 300.0, 7)
    arrays = {"phis": phis, "sod": 810.0, "sdd": 1160.0, "tau": tau, "centerRow": row, "centerCol": column}
    arrays |= {"pixelHeight": 0.7, "pixelWidth": 0.6, "numRows": 480, "numCols": 620}
    found = read_vectors(tmp_path / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    for k, angle in enumerate(np.radians(phis) - np.pi / 2.0):
        t, p = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
        depth = 810.0 - 1e3 * POINTS @ t
        u, v = (1e3 * POINTS @ p + tau) / depth, 1e3 * POINTS[:, 2] / depth
        expected = np.column_stack([column + 1160.0 * u / 0.6, row + 1160.0 * v / 0.7])
        np.testing.assert_allclose(seen_as_written(found)[k], expected, atol=1e-6)


VECTORS = np.tile([0.0, -810, 0, 0, 350, 0, 0.6, 0, 0, 0, 0, 0.6], (3, 1))


@pytest.mark.parametrize(
    ("arrays", "line"),
    [
        ({"vectors": VECTORS[:, :6]}, "fan beam, fanflat_vec; cone_vec has (N, 12)"),
        ({"vectors": np.vstack([VECTORS[:2], 2.0 * VECTORS[:1]])}, "exposure 2 has pixels of another size"),
        ({"vectors": np.full((2, 12), np.nan)}, "not finite"),
        ({"vectors": VECTORS, "det_row_count": 0}, "det_row_count must be one number above 0"),
        ({"vectors": VECTORS, "type": "parallel3d_vec"}, "type = parallel3d_vec; cone_vec and cone are read"),
        ({"phis": [0.0], "sod": 810.0, "sdd": 1160.0, "helicalPitch": 2.0}, "helicalPitch is not 0: no circle; LEAP's convert_to_"),
        ({"phis": [0.0], "sod": 810.0, "sdd": 1160.0}, "LEAP's vectors without"),
        ({"ProjectionAngles": [0.0], "DistanceOriginSource": 810.0}, "ASTRA's vectors without distanceorigindetector"),
        ({"DSO": 810.0, "DSD": 1160.0, "angles": [0.0], "mode": "parallel"}, "mode = parallel; cone is read"),
        (dict.fromkeys(("sourcePositions", "moduleCenters", "rowVectors", "colVectors"), np.ones((2, 3))), "without pixelheight"),
    ],
)  # fmt: skip
def test_vectors_that_a_flat_panel_cannot_have_are_refused_in_one_line(tmp_path: Path, arrays: dict[str, Any], line: str) -> None:
    with pytest.raises(UnusableInputError) as refused:
        read_vectors(tmp_path / "a.npz", {name: np.asarray(one) for name, one in arrays.items()}, PANEL)
    assert line in str(refused.value)
    assert "\n" not in str(refused.value)


def test_lengths_of_another_unit_are_refused_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "cm.npy", VECTORS / 10.0)
    with pytest.raises(SystemExit) as left:
        main(["geometry", "convert", "carm", str(tmp_path / "cm.npy"), str(tmp_path / "o.csv")])
    assert left.value.code == 2
    assert "puts the focal spot 0.116 m from the panel, carm has 1.16 m; ASTRA's lengths are taken in mm" in capsys.readouterr().err


def test_the_command_reads_what_it_wrote(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_vectors(tmp_path / "a.npz", beam(1), PANEL, "astra")
    for arguments in (["a.npz", "b.npz", "--for", "tigre"], ["b.npz", "c.npz", "--for", "leap"], ["c.npz", "d.json"]):
        with pytest.raises(SystemExit) as left:
            main(["geometry", "convert", "carm", str(tmp_path / arguments[0]), str(tmp_path / arguments[1]), *arguments[2:]])
        assert left.value.code == 0
    assert "flipped up-down" in capsys.readouterr().out


# ---- Enhanced XA -----------------------------------------------------------------------------------------


def test_enhanced_xa_holds_what_the_classic_object_does_frame_by_frame(tmp_path: Path) -> None:
    pytest.importorskip("pydicom")
    positioner, lost = positioner_of(beam(5), PANEL, each_distance=True)
    write_enhanced_xa(tmp_path / "e.dcm", positioner)
    found = read_xa(tmp_path / "e.dcm")
    np.testing.assert_allclose(found.beam.deviation_from(positioner.beam), 0.0, atol=1e-7)
    assert np.ptp(found.source_to_patient_m) > 1e-3  # each frame has its own
    assert found.detector is not None
    assert (found.detector.columns, found.detector.rows, found.detector.aspect) == (620, 480, pytest.approx(1.01))
    assert np.abs(lost[:, 2]).max() < 1e-9 < np.abs(positioner_of(beam(5), PANEL)[1][:, 2]).max()


@pytest.mark.parametrize("value", [-9.999999999999998, 9.999999999999998, -99.99999999999999, 1e-15, -0.1 / 3.0, 1160.0, -0.0])
def test_decimal_strings_have_at_most_sixteen_letters(value: float) -> None:
    pytest.importorskip("pydicom")
    assert len(decimal(value)) <= 16
    assert float(decimal(value)) == pytest.approx(value, rel=1e-9, abs=1e-300)


def test_groups_may_be_shared_and_equal_the_classic_object(tmp_path: Path) -> None:
    pydicom = pytest.importorskip("pydicom")
    classic = Positioner(np.radians([-30.0, 0.0, 30.0]), np.radians([5.0, 5.0, 5.0]), 0.81, 1.16, PANEL)
    write_xa(tmp_path / "c.dcm", classic)
    write_enhanced_xa(tmp_path / "e.dcm", classic)
    data = pydicom.dcmread(tmp_path / "e.dcm")
    frames = data.PerFrameFunctionalGroupsSequence
    data.SharedFunctionalGroupsSequence[0].XRayGeometrySequence = frames[0].XRayGeometrySequence
    for frame in frames:
        del frame.XRayGeometrySequence
    frames[1].IsocenterReferenceSystemSequence = [pydicom.Dataset()]
    data.save_as(tmp_path / "e.dcm")
    found = read_xa(tmp_path / "e.dcm")
    np.testing.assert_allclose(found.beam.deviation_from(read_xa(tmp_path / "c.dcm").beam), 0.0, atol=1e-7)
    assert found.notes == ("not taken: IsocenterReferenceSystemSequence",)


def _no_group(data: Dataset) -> None:
    del data.PerFrameFunctionalGroupsSequence[1].PositionerPositionSequence


def _no_attribute(data: Dataset) -> None:
    del data.PerFrameFunctionalGroupsSequence[2].XRayGeometrySequence[0].DistanceSourceToIsocenter


def _few_items(data: Dataset) -> None:
    del data.PerFrameFunctionalGroupsSequence[2]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (_no_group, "frame 2 of 3 has no PositionerPositionSequence, of this Enhanced XA Image Storage"),
        (_no_attribute, "frame 3 of 3 has no DistanceSourceToIsocenter in XRayGeometrySequence"),
        (_few_items, "2 items of PerFrameFunctionalGroupsSequence for 3 frames"),
    ],
)
def test_what_a_frame_lacks_is_named(tmp_path: Path, change: Callable[[Dataset], None], line: str) -> None:
    pydicom = pytest.importorskip("pydicom")
    write_enhanced_xa(tmp_path / "e.dcm", Positioner(np.zeros(3), np.zeros(3), 0.81, 1.16, PANEL))
    data = pydicom.dcmread(tmp_path / "e.dcm")
    change(data)
    data.save_as(tmp_path / "e.dcm")
    with pytest.raises(UnusableInputError) as refused:
        read_xa(tmp_path / "e.dcm")
    assert line in str(refused.value)


def _other_pixels(data: Dataset) -> None:
    import copy

    frames = data.PerFrameFunctionalGroupsSequence
    shared = data.SharedFunctionalGroupsSequence[0]
    for frame in frames:
        frame.FramePixelDataPropertiesSequence = copy.deepcopy(shared.FramePixelDataPropertiesSequence)
    frames[2].FramePixelDataPropertiesSequence[0].ImagerPixelSpacing = [0.3, 0.3]
    del shared.FramePixelDataPropertiesSequence


def test_frames_of_other_pixels_are_named(tmp_path: Path) -> None:
    pydicom = pytest.importorskip("pydicom")
    write_enhanced_xa(tmp_path / "e.dcm", Positioner(np.zeros(3), np.zeros(3), 0.81, 1.16, PANEL))
    data = pydicom.dcmread(tmp_path / "e.dcm")
    _other_pixels(data)
    data.save_as(tmp_path / "e.dcm")
    with pytest.raises(UnusableInputError, match=r"frame 3 has ImagerPixelSpacing \(0\.3, 0\.3\), the first"):
        read_xa(tmp_path / "e.dcm")


@pytest.mark.parametrize(
    ("attributes", "notes"),
    [
        ({"FieldOfViewHorizontalFlip": "YES", "FieldOfViewRotation": "90"}, "FieldOfViewRotation = 90, FieldOfViewHorizontalFlip = YES"),
        ({"FieldOfViewOrigin": [20.0, 0.0]}, "FieldOfViewOrigin = [20.0, 0.0]"),
        ({"PatientPosition": "FFS"}, "PatientPosition = FFS: the angles are the patient's"),
        ({"TableMotion": "DYNAMIC"}, "TableMotion = DYNAMIC"),
        ({"FieldOfViewHorizontalFlip": "NO", "FieldOfViewRotation": "0", "PatientPosition": "HFS", "TableMotion": "STATIC"}, ""),
    ],
)
def test_what_turns_images_or_patient_is_told(tmp_path: Path, attributes: dict[str, Any], notes: str) -> None:
    pydicom = pytest.importorskip("pydicom")
    write_xa(tmp_path / "c.dcm", Positioner(np.zeros(2), np.zeros(2), 0.81, 1.16, PANEL))
    data = pydicom.dcmread(tmp_path / "c.dcm")
    for name, value in attributes.items():
        setattr(data, name, value)
    data.save_as(tmp_path / "c.dcm")
    assert read_xa(tmp_path / "c.dcm").notes == ((f"not taken: {notes}",) if notes else ())


def test_a_view_of_enhanced_xa_that_is_mirrored_is_told(tmp_path: Path) -> None:
    pydicom = pytest.importorskip("pydicom")
    write_enhanced_xa(tmp_path / "e.dcm", Positioner(np.zeros(2), np.zeros(2), 0.81, 1.16, PANEL))
    data = pydicom.dcmread(tmp_path / "e.dcm")
    view = pydicom.Dataset()
    view.FieldOfViewHorizontalFlip = "YES"
    data.PerFrameFunctionalGroupsSequence[1].FieldOfViewSequence = [view]
    data.save_as(tmp_path / "e.dcm")
    assert read_xa(tmp_path / "e.dcm").notes == ("not taken: FieldOfViewHorizontalFlip = YES",)


def test_the_command_tells_whose_pixels_it_took(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pydicom")
    write_xa(tmp_path / "c.dcm", Positioner(np.zeros(2), np.zeros(2), 0.81, 1.16, None))
    with pytest.raises(SystemExit):
        main(["geometry", "convert", "carm", str(tmp_path / "c.dcm"), str(tmp_path / "o.csv")])
    assert "it names no pixels: those of carm with --binning 4 were taken" in capsys.readouterr().out


def test_images_of_other_pixels_whose_size_nothing_says_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pydicom = pytest.importorskip("pydicom")
    write_xa(tmp_path / "c.dcm", Positioner(np.zeros(2), np.zeros(2), 0.81, 1.16, None))
    write_enhanced_xa(tmp_path / "e.dcm", Positioner(np.zeros(2), np.zeros(2), 0.81, 1.16, PANEL))
    for name in ("c.dcm", "e.dcm"):
        data = pydicom.dcmread(tmp_path / name)
        data.Rows, data.Columns = 512, 500
        for item in data.get("SharedFunctionalGroupsSequence", []):
            item.pop("FramePixelDataPropertiesSequence", None)
        for item in data.get("PerFrameFunctionalGroupsSequence", []):
            item.pop("FramePixelDataPropertiesSequence", None)
        data.save_as(tmp_path / name)
        with pytest.raises(SystemExit) as ended:
            main(["geometry", "convert", "carm", str(tmp_path / name), str(tmp_path / "o.csv")])
        assert ended.value.code == 2
        words = "no ImagerPixelSpacing, and 500 x 512 pixels, where carm with --binning 4 has 620 x 480; name the --binning of its images"
        assert words in capsys.readouterr().err
        assert not (tmp_path / "o.csv").exists()


def test_an_archive_of_something_else_is_told_by_what_it_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "a.npz", gain=1.0, dark=2.0)
    with pytest.raises(SystemExit):
        main(["geometry", "convert", "carm", str(tmp_path / "a.npz"), str(tmp_path / "o.csv")])
    said = capsys.readouterr().err
    assert "a.npz: holds dark, gain; what is read has one of: Vectors of ASTRA" in said
    assert "look-up table of isocenter" not in said


TIGRE = {"DSO": 810.0, "DSD": 1160.0, "angles": np.linspace(0.0, 3.3, 9), "nDetector": [480, 620], "dDetector": [0.6, 0.6]}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"angles": None}, "TIGRE's vectors without angles"),
        ({"offDetector": np.zeros((2, 9))}, r"offDetector of shape \(2, 9\); \(2,\) or \(9, 2\) would be right"),
        ({"rotDetector": np.zeros(2)}, r"rotDetector of shape \(2,\); \(3,\) or \(9, 3\) would be right"),
        ({"COR": np.zeros(4)}, "COR has 4 numbers; 1 or 9, those of angles, would be right"),
        ({"DSO": np.full(8, 810.0)}, "DSO has 8 numbers; 1 or 9"),
    ],
)
def test_arrays_of_tigre_that_do_not_fit_are_named(tmp_path: Path, changed: dict[str, object], words: str) -> None:
    np.savez(tmp_path / "t.npz", **{name: np.asarray(one) for name, one in (TIGRE | changed).items() if one is not None})
    with pytest.raises(UnusableInputError, match=words):
        read_back(tmp_path / "t.npz")


def test_offsets_of_tigre_s_panel_may_differ_from_exposure_to_exposure(tmp_path: Path) -> None:
    """Its documented geometry: the panel's middle is (DSO - DSD, offDetector[1], offDetector[0]), turned about z by the angle."""
    angles = np.linspace(0.0, 3.3, 9)
    offset = np.column_stack([3.0 * np.sin(angles), 150.0 + 5.0 * np.cos(angles)])
    np.savez(tmp_path / "t.npz", **TIGRE, offDetector=offset)
    found = read_back(tmp_path / "t.npz").beam
    seen = 1e3 * (found.detector_in_phantom_m - found.source_in_phantom_m)
    turn = Rotation.from_euler("z", angles[:, None])
    np.testing.assert_allclose(1e3 * found.source_in_phantom_m, turn.apply([810.0, 0.0, 0.0]), atol=1e-9)
    np.testing.assert_allclose(seen, turn.apply(np.column_stack([np.full(9, -1160.0), offset[:, 1], offset[:, 0]])), atol=1e-9)


def test_angles_that_go_round_often_are_told_in_turns(tmp_path: Path) -> None:
    degrees = np.degrees(np.linspace(0.0, 3.3, 9))
    np.savez(tmp_path / "t.npz", **TIGRE | {"angles": degrees})
    assert read_back(tmp_path / "t.npz").notes == ("its angles span 189.1, taken in rad: 30.1 turns",)
    np.savez(tmp_path / "t.npz", **TIGRE)
    assert read_back(tmp_path / "t.npz").notes == ()


def test_a_dicom_file_of_another_kind_is_named(tmp_path: Path) -> None:
    pydicom = pytest.importorskip("pydicom")
    write_xa(tmp_path / "c.dcm", Positioner(np.zeros(1), np.zeros(1), 0.81, 1.16, PANEL))
    data = pydicom.dcmread(tmp_path / "c.dcm")
    data.SOPClassUID = "1.2.840.10008.5.1.4.1.1.2"
    del data.PositionerPrimaryAngle
    data.save_as(tmp_path / "c.dcm", enforce_file_format=False)
    with pytest.raises(UnusableInputError, match="no PositionerPrimaryAngle in this CT Image Storage"):
        read_xa(tmp_path / "c.dcm")


def test_the_command_writes_enhanced_xa(tmp_path: Path) -> None:
    pydicom = pytest.importorskip("pydicom")
    write_vectors(tmp_path / "a.npz", beam(1), PANEL, "astra")
    for suffix, code in ((".dcm", 0), (".csv", 2)):
        with pytest.raises(SystemExit) as left:
            main(["geometry", "convert", "carm", str(tmp_path / "a.npz"), str(tmp_path / f"o{suffix}"), "--for", "enhanced-xa"])
        assert left.value.code == code
    assert pydicom.dcmread(tmp_path / "o.dcm").SOPClassUID.name == "Enhanced XA Image Storage"
