"""A scan with a marker plate on the tube of the emulated C-arm: the command's parameters hold the true ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import exposed_scan, isocenter
from scipy.spatial.transform import Rotation

from hil.emulated.images import true_beam, xray_side
from hil.imaging.nominal import panel_in_tube
from hil.imaging.scan_folder import read_scan
from hil.machine import load_machine
from virtual_bus.xray.motion import STILL

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exposed_scan(tmp_path_factory.mktemp("marker"), "--marker", "experimental", "--rate", "3")


@pytest.fixture(scope="module")
def measured(scanned: Path) -> dict[str, np.ndarray]:
    """The parameters as the command finds them: the file's arrays."""
    answers = ["-o", scanned / "marker.npz", "--figure", scanned / "f.png", "--json", scanned / "a.json", "--page", scanned / "a.html"]
    assert isocenter("calibrate", "marker", "carm", scanned / "images", *answers) == 0
    with np.load(scanned / "marker.npz", allow_pickle=False) as file:
        return dict(file)


@pytest.mark.nightly
def test_the_parameters_of_a_scan_are_the_true_ones(scanned: Path, measured: dict[str, np.ndarray]) -> None:
    scan, machine = read_scan(scanned / "images"), load_machine("carm")
    side = xray_side(machine, scanned / "truth.csv", STILL, 0.0)
    source = true_beam(side, scan.start_s, scan.width_s).source_m
    _, tube = side.tube(scan.middle_s)
    _, panel = side.panel(scan.middle_s)
    angles = Rotation.from_matrix(np.swapaxes(panel, 1, 2) @ tube @ panel_in_tube(machine)).as_euler("xyz")
    values, covariance = measured["values"][:, :6], measured["covariance"]
    assert list(measured["free"]) == ["focal_u", "focal_v", "focal_length", "theta_x", "theta_y", "theta_z"]
    error = values - np.column_stack([source * [1.0, 1.0, -1.0], angles])
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :6]
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.5
    assert np.sqrt(np.mean(error[:, :2] ** 2)) < 0.3e-3
    # Of focal spot and angle the image's place shows the sum alone: to micrometres, but for the spot's own 18 um times magnification - 1
    assert np.abs(error[:, 0] + 1.16 * error[:, 4]).max() < 3.64 * 18e-6 + 10e-6
    answer = json.loads((scanned / "a.json").read_text())
    assert answer["used"] == len(scan)
    assert min(answer["points"]) >= 90
    assert (scanned / "f.png").stat().st_size > 10_000


@pytest.mark.nightly
def test_the_linear_case_takes_angles_for_a_shift_of_the_source(scanned: Path, measured: dict[str, np.ndarray]) -> None:
    """Sec. 6.4.1: f_x, f_y and Z-bar alone; the panel's rocking by some mrad shows in them, 1.16 mm for each."""
    named = [argument for name in ("focal_u", "focal_v", "focal_length") for argument in ("--free", name)]
    assert isocenter("calibrate", "marker", "carm", scanned / "images", "-o", scanned / "linear.npz", *named) == 0
    with np.load(scanned / "linear.npz", allow_pickle=False) as file:
        linear = dict(file)
    assert list(linear["free"]) == ["focal_u", "focal_v", "focal_length"]
    assert not linear["values"][:, 3:6].any()
    turned = measured["values"][:, 4]
    assert np.abs(turned).max() > 1e-3, "there is something to take for a shift"
    np.testing.assert_allclose(linear["values"][:, 0], measured["values"][:, 0] + 1.16 * turned, atol=30e-6)
    by_spot = 13e-6 * 1.16 / 0.25  # the focal spot's own motion shifts the plate's shadow; its crossings are known to micrometres
    np.testing.assert_allclose(np.sqrt(linear["covariance"][:, [0, 1], [0, 1]]), by_spot, rtol=0.01)


@pytest.mark.parametrize(
    ("more", "line"),
    [
        (["--plate", "round"], "marker plate round: there are experimental, clinical"),
        (["--distance", "-3"], "distance of the marker plate -3.0 mm: must be a positive number"),
        (["--distance", "0"], "distance of the marker plate 0.0 mm: must be a positive number"),
        (["--plate", "clinical"], "of the clinical plate are in the image; two of each and five in all are needed"),
        (["--free", "focal_length", "--free", "plate_distance"], "a flat plate shows their ratio alone; hold one of them"),
        (["--free", "tilt"], "tilt to fit: the parameters of a marker are focal_u"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], line: str
) -> None:
    assert isocenter("calibrate", "marker", "carm", scanned / "images", "-o", tmp_path / "x.npz", *more) == 2
    error = capsys.readouterr().err
    assert line in error
    assert len([said for said in error.splitlines() if not said.startswith("... ")]) == 1  # progress of a slow computer aside
    assert not (tmp_path / "x.npz").exists()


def test_a_scan_that_says_nothing_of_a_marker_is_asked_about(scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file in (scanned / "images").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    text = (tmp_path / "scan.toml").read_text()
    (tmp_path / "scan.toml").write_text("\n".join(row for row in text.splitlines() if not row.startswith("marker")) + "\n")
    assert isocenter("calibrate", "marker", "carm", tmp_path, "-o", tmp_path / "x.npz") == 2
    assert "scan.toml names no marker and marker_distance_mm; give --plate and --distance" in capsys.readouterr().err
