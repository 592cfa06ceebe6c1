"""isocenter roadmap and geometry on a scan of the emulated C-arm: overlay errors, volume, compensated images."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from commands import exposed_scan, isocenter
from flexible_machine import LONG, machine_file

from hil.calibration.kinematic.geometric_model import read_calibration
from hil.calibration.use.lookup_table import LookUp, write_look_up
from hil.experiments import read_experiment
from hil.imaging.nominal import nominal_beam
from hil.imaging.scan_folder import read_scan
from hil.machine import load_machine

pytestmark = pytest.mark.slow


CARM = load_machine("carm")


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("roadmap")
    (folder / "off.toml").write_text(machine_file(LONG))
    exposed_scan(folder, "--scene", "dodecahedron", "--rate", "4", machine=folder / "off.toml")
    assert (
        isocenter(
            "geometry",
            "truth",
            "carm",
            folder / "images",
            "--truth",
            folder / "truth.csv",
            "-o",
            folder / "true.npz",
            "--emulated",
            folder / "off.toml",
        )
        == 0
    )
    assert isocenter("calibrate", "phantom", "carm", folder / "images", "-o", folder / "phantom.npz") == 0
    return folder


def test_the_overlay_of_a_phantom_table_is_better_than_nominal_and_of_the_truth_is_nothing(scanned: Path) -> None:
    judged = ["--with", scanned / "phantom.npz", "--with", scanned / "true.npz"]
    written = ["--json", scanned / "r.json", "--figure", scanned / "r.png"]
    assert isocenter("roadmap", "carm", scanned / "true.npz", *judged, *written) == 0
    found = json.loads((scanned / "r.json").read_text())["overlay_m"]
    for place in ("centre", "1/3", "2/3"):
        assert found["true.npz"][place]["max"] < 1e-9
        assert found["phantom.npz"][place]["max"] < 0.05e-3 < 0.5e-3 < found["nominal"][place]["mean"]
        for row in (result[place] for result in found.values()):
            assert row["mean"] <= row["max"]
            assert row["max_90"] <= row["max"]
    assert (scanned / "r.png").stat().st_size > 10_000
    assert isocenter("roadmap", "carm", scanned / "true.npz", "--registered", "--json", scanned / "l.json") == 0
    laid = json.loads((scanned / "l.json").read_text())["overlay_m"]
    assert laid["nominal"]["centre"]["mean"] < 0.2 * found["nominal"]["centre"]["mean"]  # over 30 degrees it sags nearly alike


def test_compensated_images_are_those_of_the_nominal_geometry(scanned: Path) -> None:
    out = scanned / "compensated"
    assert isocenter("geometry", "compensate", "carm", scanned / "images", "--with", scanned / "true.npz", "-o", out) == 0
    assert isocenter("calibrate", "phantom", "carm", out, "-o", scanned / "again.npz", "--six") == 0
    positions = read_scan(out).positions_of(CARM)
    nominal = nominal_beam(CARM, positions)
    origin = np.zeros((1, 3))
    for path, least, most in (("phantom.npz", 1e-3, 1.0), ("again.npz", 0.0, 0.05e-3)):
        seen = nominal.moved(read_calibration(scanned / path, CARM).at(positions)).project(origin)[:, 0]
        off = np.linalg.norm(seen - nominal.project(origin)[:, 0], axis=1)
        assert least <= off.max() < most, (path, off)


@pytest.mark.nightly
def test_the_volume_of_the_scan_is_told(scanned: Path) -> None:
    """That of the truth, within what calibrations by a phantom are off by; a single nominal exposure sees no smaller ball."""
    found = []
    for table in ("phantom.npz", "true.npz"):
        written = ["--with", scanned / table, "--json", scanned / "v.json"]
        assert isocenter("geometry", "volume", "carm", scanned / "images", *written) == 0
        found.append(json.loads((scanned / "v.json").read_text()))
    detector = read_scan(scanned / "images").detector
    nominal = 0.81 * np.sin(np.arctan(0.5 * detector.rows * detector.pitch_m * detector.aspect / 1.16))
    assert found[0]["radius_m"] == pytest.approx(found[1]["radius_m"], abs=0.2e-3)
    assert found[0]["volume_m3"] == pytest.approx(found[1]["volume_m3"], rel=2e-3)
    assert 0.97 * nominal < found[0]["radius_m"] < 1.003 * nominal  # the tube is 1.5 mm farther than by the drawing


def test_what_cannot_be_done_is_one_line(scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outside = LookUp(CARM.axes, np.array([[0.0, 1.2], [0.0, 1.3]]), np.zeros((2, 9)), np.zeros((2, 9, 9)), {"machine": "carm"})
    write_look_up(outside, tmp_path / "outside.npz")
    (tmp_path / "junk.npz").write_text("junk")
    write_look_up(LookUp(("a", "b"), outside.positions, outside.deviation, outside.covariance, {}), tmp_path / "other.npz")
    commands = [
        (["roadmap", "carm", scanned / "true.npz", "--with", tmp_path / "outside.npz"], "roll goes from"),
        (["roadmap", "carm", tmp_path / "junk.npz"], "junk.npz: not a calibration of isocenter"),
        (["roadmap", "carm", tmp_path / "missing.npz"], "missing.npz: no such file"),
        (["roadmap", "carm", tmp_path / "other.npz"], "with axes a, b; carm has propeller, roll"),
        (["roadmap", "emps", scanned / "true.npz"], "calibrate this machine"),
        (["roadmap", "carm", scanned / "true.npz", "--figure", tmp_path / "no" / "f.png"], "there is no folder"),
        (["geometry", "volume", "carm", tmp_path], "scan.toml: No such file"),
        (["geometry", "truth", "carm", scanned / "images", "--truth", scanned / "scan.mf4", "-o", tmp_path / "t.npz"], "no truth file"),
        (
            ["geometry", "compensate", "carm", scanned / "images", "--with", scanned / "true.npz", "-o", scanned / "images"],
            "is read by this",
        ),
    ]
    for arguments, line in commands:
        assert isocenter(*arguments) == 2, arguments
        error = capsys.readouterr().err
        assert line in error, error
        assert error.count("\n") == 1, error


def test_a_grid_of_poses_is_proposed_and_kept_of_what_was_exposed_on_the_way(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert isocenter("calibrate", "grid", "carm", "--step", "60", "-o", tmp_path / "g.toml", "--json", tmp_path / "g.json") == 0
    answer = json.loads((tmp_path / "g.json").read_text())
    plan = read_experiment(tmp_path / "g.toml", CARM).plans(CARM)[0]
    assert answer["poses"] == 20
    assert answer["seconds"] == plan.rows / 256.0
    positions = plan.reference[::100]
    deviation = positions.sum(axis=1)[:, None] * np.ones(9)
    write_look_up(
        LookUp(CARM.axes, positions, deviation, np.tile(np.eye(9), (len(positions), 1, 1)), {"machine": "carm"}), tmp_path / "t.npz"
    )
    assert isocenter("geometry", "standing", tmp_path / "t.npz", "-o", tmp_path / "s.npz") == 0
    grid = read_calibration(tmp_path / "s.npz", CARM)
    stops = [[stop[axis] for axis in CARM.axes] for stop in read_experiment(tmp_path / "g.toml", CARM).stops]
    np.testing.assert_allclose(grid.positions, stops, atol=1e-3)
    between = np.array([[0.3, -0.2], [-1.1, 0.7]])  # Fig. 2.4: what is linear over the grid is interpolated exactly
    np.testing.assert_allclose(grid.at(between), between.sum(axis=1)[:, None] * np.ones(9), atol=1e-3)
    capsys.readouterr()
    for arguments, line in (
        (["calibrate", "grid", "carm", "--step", "0.5", "-o", tmp_path / "x.toml"], "at most 2000"),
        (["calibrate", "grid", "carm", "--step", "nan", "-o", tmp_path / "x.toml"], "--step nan: must be a positive number"),
        (["calibrate", "grid", "emps", "-o", tmp_path / "x.toml"], "emps: its file has no [geometry]"),
    ):
        assert isocenter(*arguments) == 2
        error = capsys.readouterr().err
        assert line in error
        assert error.count("\n") == 1


def test_a_grid_keeps_to_the_middle_of_a_range_that_is_not_about_zero(tmp_path: Path) -> None:
    text = resources.files("hil.machine").joinpath("shipped/carm.toml").read_text(encoding="utf-8")
    (tmp_path / "m.toml").write_text(text.replace("range_deg = [-95.0, 95.0]", "range_deg = [-15.0, 95.0]"), encoding="utf-8")
    assert isocenter("calibrate", "grid", tmp_path / "m.toml", "--step", "20", "-o", tmp_path / "grid.toml") == 0
    machine = load_machine(str(tmp_path / "m.toml"))
    rolls = np.degrees([stop["roll"] for stop in read_experiment(tmp_path / "grid.toml", machine).stops])
    assert -15.0 < rolls.min() < 0.0
    assert 80.0 < rolls.max() < 95.0
    assert rolls.min() + rolls.max() == pytest.approx(80.0)
