"""Every file of a geometry reads back equal, and says to RTK and pydicom what it says to us."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.errors import UnusableInputError
from hil.imaging import ConeBeam, Detector
from hil.imaging.exchange.dicom_file import read_xa
from hil.imaging.exchange.dicom_xa import positioner_of, write_xa
from hil.imaging.exchange.matrices import read_matrices, write_matrices
from hil.imaging.exchange.rtk_xml import read_rtk, write_rtk
from hil.imaging.nominal import nominal_beam
from hil.machine import load_machine

DETECTOR = Detector(columns=620, rows=480, pitch_m=0.6e-3, aspect=1.01, skew=0.002)
LENGTH = st.floats(-0.03, 0.03)
ANGLE = st.floats(-3.1, 3.1)


@st.composite
def beams(draw: Callable[..., object]) -> ConeBeam:
    """One to four exposures of any orientation, source and phantom centimetres off."""
    rows = [
        [
            draw(LENGTH),
            draw(LENGTH),
            -1.16 + draw(LENGTH),
            draw(LENGTH),
            draw(LENGTH),
            -0.35 + draw(LENGTH),
            draw(ANGLE),
            draw(ANGLE),
            draw(ANGLE),
        ]
        for _ in range(draw(st.integers(1, 4)))
    ]
    return ConeBeam.from_parameters(np.array(rows))


def assert_same(found: ConeBeam, beam: ConeBeam, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(found.deviation_from(beam), 0.0, atol=atol)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("exchange")


@given(beam=beams(), suffix=st.sampled_from([".csv", ".json"]))
@settings(max_examples=examples(60), deadline=None)
def test_matrices_read_back(folder: Path, beam: ConeBeam, suffix: str) -> None:
    path = folder / f"matrices{suffix}"
    write_matrices(path, beam, DETECTOR)
    other = Detector(10, 10, 1e-3) if suffix == ".json" else DETECTOR  # a JSON file knows its detector
    found, seen_on = read_matrices(path, other)
    assert_same(found, beam)
    assert seen_on == DETECTOR


@given(beam=beams(), rows_up=st.booleans())
@settings(max_examples=examples(60), deadline=None)
def test_rtk_s_xml_reads_back(folder: Path, beam: ConeBeam, rows_up: bool) -> None:
    write_rtk(folder / "rtk.xml", beam, rows_up)
    found, flipped = read_rtk(folder / "rtk.xml")
    assert flipped == rows_up
    assert_same(found, beam)


@pytest.mark.nightly
@given(beam=beams(), rows_up=st.booleans())
@settings(max_examples=examples(25), deadline=None)
def test_rtk_reads_our_file_as_its_own_and_we_read_rtk_s(folder: Path, beam: ConeBeam, rows_up: bool) -> None:
    itk = pytest.importorskip("itk")
    rtk = itk.RTK
    write_rtk(folder / "ours.xml", beam, rows_up)
    reader = rtk.ThreeDCircularProjectionGeometryXMLFileReader.New()
    reader.SetFilename(str(folder / "ours.xml"))
    reader.GenerateOutputInformation()
    geometry = reader.GetOutputObject()
    points = np.random.default_rng(1).uniform(-100.0, 100.0, (20, 3))
    for k in range(len(beam)):
        seen = np.column_stack([points, np.ones(20)]) @ np.array(itk.array_from_matrix(geometry.GetMatrix(k))).T
        expected = 1e3 * beam.project(1e-3 * points)[k] * ([1.0, -1.0] if rows_up else [1.0, 1.0])
        np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], expected, rtol=1e-9, atol=1e-9)
    theirs = rtk.ThreeDCircularProjectionGeometry.New()
    point, vector = itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
    for k in range(len(beam)):
        places = (1e3 * beam.source_in_phantom_m[k], 1e3 * beam.detector_in_phantom_m[k])
        theirs.AddProjection(*(point(place) for place in places), *(vector(beam.rotation[k, :, axis]) for axis in (0, 1)))
    writer = rtk.ThreeDCircularProjectionGeometryXMLFileWriter.New()
    writer.SetFilename(str(folder / "theirs.xml"))
    writer.SetObject(theirs)
    writer.WriteFile()
    found, flipped = read_rtk(folder / "theirs.xml")
    assert not flipped
    assert_same(found, beam)


@given(
    primary=st.lists(st.floats(-179.0, 179.0), min_size=1, max_size=5),
    secondary=st.floats(-85.0, 85.0),
    distance=st.floats(0.5, 1.0),
    further=st.floats(0.2, 0.6),
)
@settings(max_examples=examples(60), deadline=None)
def test_dicom_s_attributes_read_back(folder: Path, primary: list[float], secondary: float, distance: float, further: float) -> None:
    pytest.importorskip("pydicom")
    from hil.imaging.exchange.dicom_xa import Positioner

    count = len(primary)
    given_ = Positioner(np.radians(primary), np.radians(secondary) * np.linspace(0.5, 1.0, count), distance, distance + further, DETECTOR)
    write_xa(folder / "xa.dcm", given_)
    found = read_xa(folder / "xa.dcm")
    assert_same(found.beam, given_.beam, atol=1e-9)
    assert (found.detector.columns, found.detector.rows) == (620, 480)
    assert found.detector.pitch_m == pytest.approx(0.6e-3)
    assert found.detector.aspect == pytest.approx(1.01)
    again, lost = positioner_of(found.beam, DETECTOR)
    np.testing.assert_allclose(lost, 0.0, atol=1e-9)
    np.testing.assert_allclose(again.primary_rad, given_.primary_rad, atol=1e-9)


def test_the_positioner_s_angles_are_minus_propeller_and_minus_roll() -> None:
    machine = load_machine("carm")
    positions = np.radians([[0.0, 0.0], [30.0, 0.0], [0.0, -40.0], [50.0, 20.0]])
    found, lost = positioner_of(nominal_beam(machine, positions), None)
    np.testing.assert_allclose(np.column_stack([found.primary_rad, found.secondary_rad]), -positions, atol=1e-12)
    np.testing.assert_allclose(lost, 0.0, atol=1e-12)
    assert found.source_to_patient_m == pytest.approx(0.81)
    assert found.source_to_detector_m == pytest.approx(1.16)
    # Turned about the feet's direction by +30 degrees the panel, above at first, is on the patient's right: RAO, negative
    assert nominal_beam(machine, positions[1:2]).detector_in_phantom_m[0, 1] < 0.0 > found.primary_rad[1]


def test_a_dicom_file_holds_the_images_that_pydicom_shows(tmp_path: Path) -> None:
    pydicom = pytest.importorskip("pydicom")
    images = np.random.default_rng(2).integers(0, 65535, (3, 480, 620), dtype=np.uint16)
    positioner, _ = positioner_of(nominal_beam(load_machine("carm"), np.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.0]])), DETECTOR)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_xa(tmp_path / "a.dcm", positioner, images)
    data = pydicom.dcmread(tmp_path / "a.dcm")
    np.testing.assert_array_equal(data.pixel_array, images)
    assert data.Modality == "XA"
    assert data.PositionerMotion == "DYNAMIC"
    assert float(data.DistanceSourceToDetector) == pytest.approx(1160.0)
    assert [float(value) for value in data.PositionerPrimaryAngleIncrement] == pytest.approx(np.degrees([0.0, -0.1, -0.2]))


BEAM = ConeBeam.from_parameters([[0.0, 0.0, -1.16, 0.0, 0.0, -0.35, 0.0, 0.0, 0.3]])


def spoilt(path: Path, change: Callable[..., object]) -> int | None:
    """A good file, changed."""
    if path.suffix == ".xml":
        write_rtk(path, BEAM)
    elif path.suffix == ".dcm":
        write_xa(path, positioner_of(BEAM, None)[0])
        return change(path)
    else:
        write_matrices(path, BEAM, DETECTOR)
    path.write_text(change(path.read_text()))


def _without_distance(path: Path) -> None:
    import pydicom

    data = pydicom.dcmread(path)
    del data.DistanceSourceToPatient
    data.save_as(path)


def _more_frames(path: Path) -> None:
    import pydicom

    data = pydicom.dcmread(path)
    data.NumberOfFrames, data.PositionerMotion = 4, "DYNAMIC"
    data.save_as(path)


def _one_spacing(path: Path) -> None:
    import pydicom

    data = pydicom.dcmread(path)
    data.Rows, data.Columns, data.ImagerPixelSpacing = 480, 620, "0.6"
    data.save_as(path)


@pytest.mark.parametrize(
    ("name", "change", "line"),
    [
        ("a.csv", lambda t: t.replace("exposure_id", "id"), "the first line must be exposure_id,m00"),
        ("a.csv", lambda t: t.splitlines()[0], "no matrix"),
        ("a.csv", lambda t: t.replace("0.", "zero."), "could not convert"),
        ("a.csv", lambda t: t.splitlines()[0] + "\n0" + 12 * ",1.0" + "\n", "matrix 0 is no projection"),
        ("a.json", lambda t: t.replace('"mm"', '"m"'), '"unit": "mm"'),
        ("a.json", lambda t: t[:-30], "no matrices"),
        ("a.json", lambda t: json.dumps({**json.loads(t), "matrices": [[1, 2, 3]]}), "of 3 rows and 4 columns"),
        (
            "a.json",
            lambda t: t.replace('"pitch_mm": 0.6', '"pitch_mm": 0.6, "x": 0').replace('"aspect": 1.01', '"aspect": 1.3'),
            "other pixels",
        ),
        ("a.json", lambda t: t.replace('"pitch_mm": 0.6', '"pitch_mm": 0.0'), "columns, rows, pitch_mm and aspect must be positive"),
        ("a.xml", lambda t: t[:200], "no XML"),
        ("a.xml", lambda t: t.replace("RTKThreeDCircularGeometry", "Geometry"), "<Geometry>; RTK's geometry is"),
        ("a.xml", lambda t: t.replace("<GantryAngle>", "<GantryAngle>x"), "is no number"),
        ("a.xml", lambda t: t.replace("SourceToDetectorDistance", "Distance"), "SourceToDetectorDistance must be given"),
        ("a.xml", lambda t: re.sub("(?<=<ProjectionOffsetX>)[^<]+", "7.5", t), "<Matrix> of projection 0 is another geometry than its"),
        ("a.xml", lambda t: re.sub("(?s)(?<=<Matrix>).*(?=</Matrix>)", "1 2 3", t), "<Matrix> of projection 0 is no 3 x 4 numbers"),
        ("a.dcm", lambda p: p.write_text("hello"), "no DICOM file"),
        ("a.dcm", _without_distance, "no DistanceSourceToPatient"),
        ("a.dcm", _one_spacing, "an attribute is no number, or not as many as it should be"),
        ("a.dcm", _more_frames, "the positioner moves over 4 frames"),
    ],
)
def test_a_spoilt_file_is_one_line(tmp_path: Path, name: str, change: Callable[..., object], line: str) -> None:
    if name.endswith(".dcm"):
        pytest.importorskip("pydicom")
    path = tmp_path / name
    spoilt(path, change)
    read = {".xml": read_rtk, ".dcm": read_xa}.get(path.suffix, lambda p: read_matrices(p, DETECTOR))
    for where in (path, tmp_path / f"missing{path.suffix}"):
        with pytest.raises(UnusableInputError) as refused:
            read(where)
        assert "\n" not in str(refused.value)
        assert str(where) in str(refused.value)
        assert line in str(refused.value) or "No such file" in str(refused.value)
