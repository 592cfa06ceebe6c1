"""Vectors for ASTRA, LEAP and TIGRE: points fall on the same pixels by those programs' equations, and by ASTRA itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.errors import UnusableInputError
from hil.imaging import ConeBeam, Detector
from hil.imaging.exchange.vectors import write_vectors
from hil.imaging.nominal import nominal_beam, nominal_detector
from hil.machine import load_machine

CARM = load_machine("carm")
SKEWED = Detector(columns=620, rows=480, pitch_m=0.6e-3, aspect=1.01, skew=0.002)
STRAIGHT = Detector(columns=620, rows=480, pitch_m=0.6e-3, aspect=1.01)


@pytest.fixture(scope="module")
def beam() -> ConeBeam:
    """The C-arm at twelve poses, every parameter off by millimetres and milliradians."""
    rng = np.random.default_rng(2)
    positions = np.radians(np.column_stack([rng.uniform(-80.0, 80.0, 12), rng.uniform(-90.0, 90.0, 12)]))
    return nominal_beam(CARM, positions).moved(rng.normal(0.0, 5e-3, (12, 9)))


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.random.default_rng(3).uniform(-0.08, 0.08, (20, 3))


def pixels(beam: ConeBeam, detector: Detector, points: np.ndarray) -> np.ndarray:
    """Columns and rows (N, P, 2) by the projection matrices."""
    seen = np.einsum("nij,pj->npi", beam.matrices(detector), np.column_stack([points, np.ones(len(points))]))
    found: np.ndarray = seen[..., :2] / seen[..., 2:]
    return found


def arrays(folder: Path, beam: ConeBeam, detector: Detector, program: str) -> dict[str, np.ndarray]:
    write_vectors(folder / f"{program}.npz", beam, detector, program)
    return dict(np.load(folder / f"{program}.npz"))


def on_plane(source: np.ndarray, origin: np.ndarray, u: np.ndarray, v: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Steps along u and v from `origin` to where the ray from the source through a point meets the plane."""
    return np.linalg.solve(np.column_stack([u, v, source - point]), source - origin)[:2]


def test_astra_itself_puts_points_on_the_same_pixels(tmp_path: Path, beam: ConeBeam, points: np.ndarray) -> None:
    astra = pytest.importorskip("astra")
    experimental = pytest.importorskip("astra.experimental")
    found = arrays(tmp_path, beam, SKEWED, "astra")
    geometry = astra.create_proj_geom("cone_vec", int(found["det_row_count"]), int(found["det_col_count"]), found["vectors"])
    theirs = [[experimental.projectPoint(geometry, *(1e3 * point), k) for point in points] for k in range(len(beam))]
    np.testing.assert_allclose(theirs, pixels(beam, SKEWED, points), atol=1e-6)


def test_astra_s_own_circle_has_these_vectors(tmp_path: Path) -> None:
    """Its conversion of a circular cone beam to vectors, for a panel whose rows go along z, as it has them."""
    functions = pytest.importorskip("astra.functions")
    creators = pytest.importorskip("astra.creators")
    angles = np.linspace(0.0, 3.0, 5)
    circle = creators.create_proj_geom("cone", 0.6, 0.606, 480, 620, angles, 810.0, 350.0)
    c, s, nil = np.cos(angles), np.sin(angles), np.zeros(5)
    out = np.stack([s, -c, nil], axis=1)
    rotation = np.stack([np.stack([c, s, nil], axis=1), np.tile([0.0, 0.0, 1.0], (5, 1)), out], axis=2)
    ours = ConeBeam.from_frames(0.81 * out, -0.35 * out, rotation)
    found = arrays(tmp_path, ours, STRAIGHT, "astra")["vectors"]
    np.testing.assert_allclose(found, functions.geom_2vec(circle)["Vectors"], atol=1e-9)


def test_astra_s_vectors_by_its_documented_equations(tmp_path: Path, beam: ConeBeam, points: np.ndarray) -> None:
    found = arrays(tmp_path, beam, SKEWED, "astra")["vectors"]
    middle = np.array([309.5, 239.5])
    theirs = [[middle + on_plane(row[:3], row[3:6], row[6:9], row[9:], 1e3 * point) for point in points] for row in found]
    np.testing.assert_allclose(theirs, pixels(beam, SKEWED, points), atol=1e-6)


def test_leap_s_vectors_by_its_documented_equations(tmp_path: Path, beam: ConeBeam, points: np.ndarray) -> None:
    """In single precision, as its library takes them: s and t of `set_modularbeam`."""
    found = arrays(tmp_path, beam, STRAIGHT, "leap")
    names = ("sourcePositions", "moduleCenters", "colVectors", "rowVectors")
    assert all(found[name].dtype == np.float32 for name in names)
    for k, expected in enumerate(pixels(beam, STRAIGHT, points)):
        y, c, u, v = (found[name][k].astype(float) for name in names)
        n = np.cross(u, v)
        for point, pixel in zip(points, expected, strict=True):
            x = 1e3 * point - y
            s, t = (((c - y) @ n) / (x @ n) * (x @ axis) - (c - y) @ axis for axis in (u, v))
            assert 309.5 + s / found["pixelWidth"] == pytest.approx(pixel[0], abs=2e-3)
            assert 239.5 + t / found["pixelHeight"] == pytest.approx(pixel[1], abs=2e-3)


def test_tigre_s_angles_and_offsets_by_its_equations(tmp_path: Path, beam: ConeBeam, points: np.ndarray) -> None:
    """Elementary turns written out; rows count from the other side, as its images are flipped."""

    def turn(axis: int, angle: float) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[[1, 0, 0], [0, c, -s], [0, s, c]], [[c, 0, s], [0, 1, 0], [-s, 0, c]], [[c, -s, 0], [s, c, 0], [0, 0, 1]]][axis])

    found = arrays(tmp_path, beam, STRAIGHT, "tigre")
    height, width = found["dDetector"]
    for k, expected in enumerate(pixels(beam, STRAIGHT, points)):
        alpha, theta, psi = found["angles"][k]
        roll, pitch, yaw = found["rotDetector"][k]
        gantry, panel = turn(2, alpha) @ turn(1, theta) @ turn(2, psi), turn(2, roll) @ turn(1, pitch) @ turn(0, yaw)
        source = gantry @ [found["DSO"][k], 0.0, 0.0]
        rows, columns = found["offDetector"][k]
        center = gantry @ [found["DSO"][k] - found["DSD"][k], columns, rows]
        u, v = gantry @ panel @ [0.0, width, 0.0], gantry @ panel @ [0.0, 0.0, height]
        theirs = np.array([309.5, 239.5]) + [on_plane(source, center, u, v, 1e3 * point) for point in points]
        np.testing.assert_allclose(theirs[:, 0], expected[:, 0], atol=1e-6)
        np.testing.assert_allclose(479.0 - theirs[:, 1], expected[:, 1], atol=1e-6)
    assert np.abs(found["rotDetector"]).max() < 0.1  # of an upright panel small turns are left


@pytest.mark.parametrize("program", ["leap", "tigre"])
def test_a_skewed_panel_is_refused_where_it_cannot_be_said(tmp_path: Path, beam: ConeBeam, program: str) -> None:
    with pytest.raises(UnusableInputError, match=r"skewed by 0\.002 columns a row"):
        write_vectors(tmp_path / "a.npz", beam, SKEWED, program)
    assert not (tmp_path / "a.npz").exists()


def test_the_command_writes_them_and_says_what_is_untried(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    matrices, out = tmp_path / "a.csv", tmp_path / "b.npz"
    from hil.imaging.exchange.matrices import write_matrices

    beam = nominal_beam(CARM, np.radians([[0.0, -30.0], [10.0, 20.0]]))
    write_matrices(matrices, beam, nominal_detector(CARM, 4))
    for arguments, code, said in (
        (["--for", "tigre"], 0, "TIGRE's documented equations; not tried with the program"),
        (["--for", "astra"], 0, "lengths in mm"),
        (["--for", "asta"], 2, "--for asta: must be astra, leap, tigre"),
    ):
        with pytest.raises(SystemExit) as left:
            main(["geometry", "convert", "carm", str(matrices), str(out), *arguments])
        assert left.value.code == code
        shown = capsys.readouterr()
        assert said in shown.out + shown.err
    np.testing.assert_allclose(np.load(out)["vectors"][:, :3], 1e3 * beam.source_in_phantom_m, atol=1e-6)
