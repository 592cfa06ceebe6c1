"""isocenter calibrate data and level on a short scan of the emulated C-arm: the geometry it writes is the true one, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import exposed_scan, isocenter
from page_text import page_verdict

from hil.calibration.data_driven.data_file import read_data_file
from hil.emulated.images import true_beam, xray_side
from hil.imaging.nominal import nominal_beam
from hil.imaging.scan_folder import read_scan
from hil.machine import load_machine
from hil.recording import read_recording
from virtual_bus.xray.motion import STILL

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = exposed_scan(tmp_path_factory.mktemp("data"), "--scene", "dodecahedron", "--rate", "7")
    answers = ["-o", folder / "a.npz", "--figure", folder / "a.png", "--json", folder / "a.json", "--page", folder / "a.html"]
    assert isocenter("calibrate", "data", "carm", folder / "scan.mf4", folder / "images", *answers) == 0
    return folder


@pytest.mark.nightly
def test_the_geometry_of_a_scan_is_the_true_one_within_its_deviations(scanned: Path) -> None:
    machine, scan = load_machine("carm"), read_scan(scanned / "images")
    true = true_beam(xray_side(machine, scanned / "truth.csv", STILL, 0.0), scan.start_s, scan.width_s)
    found = read_data_file(scanned / "a.npz")
    error = found.beam(machine, scan.middle_s).deviation_from(true)
    nominal = nominal_beam(machine, scan.positions).deviation_from(true)
    assert np.sqrt(np.mean(error[:, 3:6] ** 2)) < 0.3 * np.sqrt(np.mean(nominal[:, 3:6] ** 2))
    sigma = np.array([np.interp(scan.middle_s, found.time_s, column) for column in found.sigma.T]).T
    assert np.sqrt(np.mean((error / sigma)[-3:] ** 2)) < 1.5
    answer = json.loads((scanned / "a.json").read_text())
    assert answer["used"] == len(scan)
    assert not answer["refused"]
    assert f"{1e3 * answer['place_sigma_m'][-1]:.3f} mm after {len(scan)} images" in page_verdict(scanned / "a.html")
    assert (scanned / "a.png").stat().st_size > 10_000
    assert answer["place_sigma_m"][-1] < 0.05 * answer["place_sigma_m"][0]


def test_without_images_it_goes_on_from_an_earlier_calibration(scanned: Path, tmp_path: Path) -> None:
    out = tmp_path / "b.npz"
    assert isocenter("calibrate", "data", "carm", scanned / "scan.mf4", "--start", scanned / "a.npz", "-o", out) == 0
    first, second = read_data_file(scanned / "a.npz"), read_data_file(out)
    assert np.array_equal(first.values, second.values)
    assert np.abs(first.final - second.final).max() < 1e-12
    mount = first.names.index("mount_place_x")
    assert second.covariance[mount, mount] > first.covariance[mount, mount] + 0.9 * 0.3e-3**2


def test_levelling_turns_gravity_as_the_offsets_turn_the_detector(scanned: Path, tmp_path: Path) -> None:
    found = read_data_file(scanned / "a.npz")
    values = np.zeros(len(found.names))
    values[found.names.index("detector_turn_y")] = 2e-3
    values[[found.names.index(f"mount_yield_{of}_turn_x") for of in ("cos", "sin")]] = 1e-3  # bends: the observer finds that
    with np.load(scanned / "a.npz") as file:
        np.savez(tmp_path / "turned.npz", **{**dict(file), "values": values})
    out = tmp_path / "level.mf4"
    assert isocenter("calibrate", "level", "carm", scanned / "scan.mf4", "--by", tmp_path / "turned.npz", "-o", out) == 0
    machine = load_machine("carm")
    before, after = (read_recording(path, machine).matrix(["imu_x", "imu_y", "imu_z"]) for path in (scanned / "scan.mf4", out))
    expected = before + np.cross([0.0, 2e-3, 0.0], before)
    assert np.nanmax(np.abs(after - expected)) < 1e-6


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ([], "no images and no --start: nothing tells this machine's geometry"),
        (["--start", "images/scan.toml"], "scan.toml: not a data-driven calibration"),
        (["images", "--marker", "images"], "scan.toml names no marker of experimental, clinical"),
        (["nowhere"], "a scan's folder holds scan.toml, exposures.csv and frames.tif"),
        (["--start", "incomplete.npz"], "incomplete.npz: holds no final, sigma"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: list[str], line: str
) -> None:
    monkeypatch.chdir(scanned)
    with np.load("a.npz") as file:
        np.savez("incomplete.npz", **{name: value for name, value in file.items() if name not in ("final", "sigma")})
    assert isocenter("calibrate", "data", "carm", "scan.mf4", *arguments, "-o", tmp_path / "x.npz") == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not (tmp_path / "x.npz").exists()


@pytest.mark.parametrize("command", [["data", "carm", "scan.mf4", "--start", "a.npz"], ["level", "carm", "scan.mf4", "--by", "a.npz"]])
@pytest.mark.parametrize("read", ["scan.mf4", "a.npz"])
def test_what_is_read_is_not_written_over(
    scanned: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: list[str], read: str
) -> None:
    monkeypatch.chdir(scanned)
    before = (scanned / read).read_bytes()
    assert isocenter("calibrate", *command, "-o", read) == 2
    assert f"{read}: is read by this command; write to another file" in capsys.readouterr().err
    assert (scanned / read).read_bytes() == before


def test_clocks_that_disagree_are_told(scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file in (scanned / "images").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    head, *rows = (tmp_path / "exposures.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    later = [",".join([row[0], repr(float(row[1]) + 60.0), *row[2:]]) for row in cells]
    (tmp_path / "exposures.csv").write_text("\n".join([head, *later]) + "\n")
    assert isocenter("calibrate", "data", "carm", scanned / "scan.mf4", tmp_path, "-o", tmp_path / "x.npz") == 2
    assert "the panel's clock is not the loop's, or the recording is another run's" in capsys.readouterr().err


def test_reconstruct_takes_its_geometry_and_refuses_two(scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = ["--lookup", scanned / "a.npz", "--geometry", scanned / "a.npz"]
    assert isocenter("reconstruct", "carm", scanned / "images", *both, "-o", tmp_path) == 2
    assert "--lookup and --geometry: give the one or the other" in capsys.readouterr().err
    assert isocenter("reconstruct", "carm", scanned / "images", "--geometry", scanned / "scan.mf4", "-o", tmp_path) == 2
    assert "scan.mf4: not a data-driven calibration" in capsys.readouterr().err
    assert isocenter("reconstruct", "carm", scanned / "images", "--geometry", scanned / "a.npz", "-o", tmp_path) == 2
    assert "a reconstruction needs" in capsys.readouterr().err  # geometry taken, the scan is too short
