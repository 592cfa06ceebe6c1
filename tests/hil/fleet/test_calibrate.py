"""A scan with images becomes the machine's geometry in a fleet's results, with the same digits on a cluster."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import exposed_scan, isocenter

import hil
from hil.emulated.images import true_beam, xray_side
from hil.imaging.geometry import DEVIATIONS
from hil.imaging.nominal import nominal_beam
from hil.imaging.scan_folder import read_scan
from hil.machine import load_machine
from virtual_bus.xray.motion import STILL

for package in ("duckdb", "tifffile"):
    pytest.importorskip(package)

FLEET = """
format = 1
[every]
file = "carm"
recordings = "recordings/{name}"
tasks = ["calibrate"]
[[machine]]
name = "room"
"""
SIDEWAYS_M = 0.002
COLUMNS = "quantity, value, standard_deviation, unit, covariance, covariance_index"
ROWS = f"select {COLUMNS} from results where task = 'calibrate' and value is not null"


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A night's scan of a C-arm whose panel sits to the side of where its file has it."""
    folder = tmp_path_factory.mktemp("fleet")
    drawn, mounted = "position_m = [0.0, 0.0, 0.35]", f"position_m = [0.0, {SIDEWAYS_M}, 0.35]"
    text = hil.open_machine("carm").text
    assert drawn in text
    (folder / "built.toml").write_text(text.replace(drawn, mounted), encoding="utf-8")
    exposed_scan(folder, "--rate", "2", "--binning", "4", machine=folder / "built.toml")
    night = folder / "recordings/room/2026-11-27"
    night.mkdir(parents=True)
    shutil.copy(folder / "scan.mf4", night)
    shutil.copytree(folder / "images", night / "scan")
    (folder / "fleet.toml").write_text(FLEET, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def calibrated(scanned: Path) -> Path:
    assert isocenter("fleet", "run", scanned / "fleet.toml", "--workers", "0") == 0
    return scanned / "fleet-results"


def test_the_geometry_at_three_images_is_the_true_one_within_its_deviations(scanned: Path, calibrated: Path) -> None:
    rows = {row[0]: row[1:] for row in hil.query_fleet(calibrated, ROWS).rows}
    machine, scan = load_machine(scanned / "built.toml"), read_scan(scanned / "images")
    true = true_beam(xray_side(machine, scanned / "truth.csv", STILL, 0.0), scan.start_s, scan.width_s)
    deviation = true.deviation_from(nominal_beam(load_machine("carm"), scan.positions))
    for place, image in ((0, "first"), (len(scan) // 2, "middle"), (-1, "last")):
        names = [f"{name}, {image} image" for name in DEVIATIONS]
        found, sigma = np.array([rows[name][:2] for name in names]).T
        assert np.all(np.abs(found - deviation[place]) < 4.0 * sigma)
        assert [rows[name][2] for name in names] == [*["m"] * 6, *["rad"] * 3]
        assert rows[f"phantom_v, {image} image"][0] == pytest.approx(-SIDEWAYS_M, abs=0.3e-3)


def test_every_number_has_its_covariance_with_the_others(calibrated: Path) -> None:
    numbers = [row[2:] for row in hil.query_fleet(calibrated, ROWS).rows]
    order = np.argsort([row[3] for row in numbers])
    covariance = np.array([numbers[place][2] for place in order])
    assert covariance.shape == (27, 27)
    assert np.sqrt(np.diag(covariance)) == pytest.approx([numbers[place][0] for place in order])
    assert np.abs(covariance - covariance.T).max() < 1e-9 * covariance.max()
    source, isocentre = (np.sqrt(covariance[place, place]) for place in (1, 4))
    assert covariance[1, 4] > 0.5 * source * isocentre  # the projection hardly sees both move together


@pytest.mark.slow
def test_a_cluster_answers_to_the_same_digit(scanned: Path, calibrated: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    assert isocenter("fleet", "run", scanned / "fleet.toml", "--workers", "1", "--store", tmp_path) == 0
    assert hil.query_fleet(tmp_path, ROWS).rows == hil.query_fleet(calibrated, ROWS).rows
