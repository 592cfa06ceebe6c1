"""A scan of the phantom on the emulated C-arm, from the command line to a look-up table that holds the true geometry."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import exposed_scan, isocenter
from page_text import page_verdict

from hil.calibration.use.lookup_table import LookUp, read_look_up, sweep_speed, write_look_up
from hil.emulated.images import true_beam, xray_side
from hil.errors import UnusableInputError
from hil.imaging.nominal import nominal_beam
from hil.imaging.scan_folder import read_scan
from hil.machine import load_machine
from virtual_bus.xray.motion import STILL

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exposed_scan(tmp_path_factory.mktemp("scan"), "--scene", "dodecahedron", "--rate", "7")


def test_the_table_holds_the_true_geometry_within_its_covariance(scanned: Path) -> None:
    out = scanned / "roll.npz"
    answers = ["-o", out, "--figure", scanned / "f.png", "--json", scanned / "a.json", "--page", scanned / "a.html"]
    assert isocenter("calibrate", "phantom", "carm", scanned / "images", *answers) == 0
    table, scan, machine = read_look_up(out), read_scan(scanned / "images"), load_machine("carm")
    truth = true_beam(xray_side(machine, scanned / "truth.csv", STILL, 0.0), scan.start_s, scan.width_s)
    nominal = nominal_beam(machine, scan.positions)
    error = nominal.moved(table.deviation).deviation_from(truth)
    chi2 = np.einsum("na,nab,nb->n", error, np.linalg.inv(table.covariance), error) / 9.0
    assert 0.5 < np.mean(chi2) < 2.0, np.mean(chi2)  # the focal spot's 8 um and what pixels cost beyond photons are in here
    sagged = truth.deviation_from(nominal)
    assert np.abs(sagged[:, 3:6]).max() > 20.0 * np.sqrt(np.mean(np.diagonal(table.covariance, axis1=1, axis2=2)[:, 3:6]) / 20)
    np.testing.assert_allclose(table.notes["speed"], np.radians([0.0, 30.0]), rtol=0.05)
    answer = json.loads((scanned / "a.json").read_text())
    assert answer["used"] == len(scan)
    assert (scanned / "f.png").stat().st_size > 10_000
    assert f"{len(scan)} of {len(scan)} exposures" in page_verdict(scanned / "a.html")
    assert (scanned / "a.html").read_text(encoding="utf-8").count("<figure") == 9


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda f: (f / "exposures.csv").write_text("exposure_id,start [s]\n0,1\n"), "the first line must be exposure_id,start [s],w"),
        (lambda f: (f / "frames.tif").unlink(), "frames.tif: missing"),
        (lambda f: (f / "frames.tif").write_bytes(b"II*\0"), "image 0 of"),
        (lambda f: (f / "scan.toml").write_text("format = 7\n"), "format = 7; this version reads 1"),
    ],
)
def test_a_spoilt_folder_is_one_line(
    scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], spoil: Callable[..., object], line: str
) -> None:
    folder = tmp_path / "copy"
    folder.mkdir()
    for file in (scanned / "images").iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    spoil(folder)
    assert isocenter("calibrate", "phantom", "carm", folder, "-o", tmp_path / "x.npz") == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not (tmp_path / "x.npz").exists()


def test_a_recording_of_another_run_is_named(scanned: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = ["--axis", "roll", "--from", "0", "--to", "2", "--dwell", "0.1"]
    assert isocenter("run", "scan", "-m", "carm", "-b", "lockstep:", *short, "--speed", "5", "-o", scanned / "other.mf4") == 0
    capsys.readouterr()
    exposed = ["--truth", scanned / "truth.csv", "-o", scanned / "images2", "--rate", "1"]
    assert isocenter("expose", "carm", scanned / "other.mf4", *exposed) == 2
    assert "the panel's clock is not the loop's, or the recording is another run's" in capsys.readouterr().err


def test_a_figure_that_cannot_be_written_costs_no_table(scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = tmp_path / "few"
    few.mkdir()
    lines = (scanned / "images" / "exposures.csv").read_text().splitlines()
    (few / "exposures.csv").write_text("\n".join(lines[:4]) + "\n")
    for name in ("scan.toml", "frames.tif"):
        (few / name).write_bytes((scanned / "images" / name).read_bytes())
    assert isocenter("calibrate", "phantom", "carm", few, "-o", tmp_path / "t.npz", "--figure", tmp_path / "f.xyz") == 2
    error = capsys.readouterr().err
    assert "f.xyz: cannot be written" in error
    assert error.count("\n") == 1
    assert len(read_look_up(tmp_path / "t.npz").positions) == 3
    for wrong in (["-o", tmp_path / "no" / "t.npz"], ["-o", tmp_path / "u.npz", "--figure", tmp_path / "no" / "f.png"]):
        assert isocenter("calibrate", "phantom", "carm", few, *wrong) == 2
        assert f"there is no folder {tmp_path / 'no'}" in capsys.readouterr().err
    assert not (tmp_path / "u.npz").exists()


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda lines: lines[:1], "0 whole rows of 0"),
        (lambda lines: lines[:2], "1 whole rows of 1"),
        (lambda lines: [*lines[:5], lines[5][:100]], "4 whole rows of 5"),
        (lambda lines: [*lines[:5], lines[5].replace(lines[5].split(",")[3], "nan")], "a number is not finite"),
        (lambda lines: [*lines[:5], lines[4]], "time does not rise"),
        (lambda lines: ["hello"], "0 whole rows of 0"),
    ],
)
def test_a_truth_file_that_was_cut_short_is_one_line(
    scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], spoil: Callable[..., object], line: str
) -> None:
    with (scanned / "truth.csv").open() as file:
        lines = [next(file).rstrip("\n") for _ in range(6)]
    (tmp_path / "truth.csv").write_text("\n".join(spoil(lines)) + "\n")
    assert isocenter("expose", "carm", scanned / "scan.mf4", "--truth", tmp_path / "truth.csv", "-o", tmp_path / "images") == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("option", ["--rate", "--width", "--photons"])
def test_a_setting_that_is_no_positive_number_is_named(
    scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    for value in ("nan", "inf", "0"):
        truth = ["--truth", scanned / "truth.csv", "-o", tmp_path / "images"]
        assert isocenter("expose", "carm", scanned / "scan.mf4", *truth, option, value) == 2
        assert f"{option} {value}: must be a positive number" in capsys.readouterr().err


def test_a_table_interpolates_between_exposures_and_refuses_what_it_does_not_cover() -> None:
    rng = np.random.default_rng(1)
    roll = np.linspace(-1.0, 1.0, 21)
    table = LookUp(("propeller", "roll"), np.column_stack([np.zeros(21), roll]), rng.normal(size=(21, 9)), np.zeros((21, 9, 9)))
    np.testing.assert_allclose(table.at([[0.0, roll[3]], [0.0, 0.5 * (roll[3] + roll[4])]])[1], table.deviation[3:5].mean(axis=0))
    with pytest.raises(UnusableInputError, match=r"roll goes from 1\.300"):
        table.at([[0.0, 1.3]])
    with pytest.raises(UnusableInputError, match=r"propeller stood at 0.000 in the calibration; the scan is 0.300 away"):
        table.at([[0.3, 0.0]])
    shaken = replace(table, positions=np.column_stack([rng.uniform(-3e-3, 3e-3, 21), roll]))  # by the other axis's drive
    np.testing.assert_allclose(shaken.at([[4e-3, roll[3]]])[0], table.deviation[3])
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)), axis=-1).reshape(-1, 2)
    plane = LookUp(("propeller", "roll"), grid, grid @ rng.normal(size=(2, 9)), np.zeros((25, 9, 9)))
    slopes = np.linalg.lstsq(grid, plane.deviation)[0]
    np.testing.assert_allclose(plane.at([[0.3, -0.2]])[0], [0.3, -0.2] @ slopes, atol=1e-12)
    with pytest.raises(UnusableInputError, match="outside of the calibrated grid"):
        plane.at([[1.4, 0.0]])


@pytest.mark.parametrize("poses", [[[0.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [0.5, 0.5], [1.0, 1.0], [2.0, 2.0]]])
def test_poses_of_both_axes_that_span_no_area_are_refused(poses: list[list[float]]) -> None:
    table = LookUp(("propeller", "roll"), np.array(poses), np.zeros((len(poses), 9)), np.zeros((len(poses), 9, 9)))
    with pytest.raises(UnusableInputError, match=f"{len(poses)} poses that span no area of propeller and roll"):
        table.at([[0.5, 0.5]])


def test_a_sweep_s_speed_is_signed_and_not_one_number_where_it_went_both_ways() -> None:
    time_s = np.arange(5.0)
    there, back, stood = np.array([0.0, 0.1, 0.4, 0.7, 0.8]), np.array([0.0, 0.3, 0.6, 0.3, 0.0]), np.zeros(5)
    np.testing.assert_allclose(sweep_speed(time_s, np.column_stack([there, -there, stood])), [0.3, -0.3, 0.0])
    np.testing.assert_array_equal(sweep_speed(time_s, np.column_stack([back, stood])), [np.nan, 0.0])
    assert np.isnan(sweep_speed(time_s[:1], np.zeros((1, 2)))).all()
    table = LookUp(("propeller", "roll"), np.zeros((1, 2)), np.zeros((1, 9)), np.zeros((1, 9, 9)), {"speed": [None, 0.0]})
    assert table.other_speed(np.array([0.3, 0.0])) == ""
    assert "roll went at +0 in" in table.other_speed(np.array([0.0, 0.3]))


@pytest.mark.parametrize(
    ("positions", "notes", "line"),
    [
        ([[0.0, np.nan]], {}, "a number is not finite"),
        ([[0.0, 1.0]], {"speed": [0.3]}, r"speed = \[0.3\]; it is a list of 2 numbers"),
        ([[0.0, 1.0]], {"speed": "fast"}, "speed = 'fast'; it is a list of 2 numbers"),
    ],
)
def test_a_table_that_another_hand_wrote_wrongly_is_refused(
    tmp_path: Path, positions: list[list[float]], notes: dict[str, list[float] | str], line: str
) -> None:
    table = LookUp(("propeller", "roll"), np.array(positions), np.zeros((1, 9)), np.zeros((1, 9, 9)), notes)
    write_look_up(table, tmp_path / "t.npz")
    with pytest.raises(UnusableInputError, match=line):
        read_look_up(tmp_path / "t.npz")
