"""What `reconstruct` must not take: another machine's table, axes in another order, a volume larger than the memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.calibration.use.lookup_table import LookUp, write_look_up
from hil.cli import main
from hil.imaging import Detector
from hil.imaging.scan_folder import read_scan, write_description, write_exposures

pytestmark = pytest.mark.slow  # the toolkit takes a quarter of a minute to load

tifffile = pytest.importorskip("tifffile")
ANGLE = np.linspace(-1.6, 1.6, 24)


def scan_of(folder: Path, axes: tuple[str, str] = ("propeller", "roll"), units: tuple[str, str] = ("rad", "rad")) -> Path:
    folder.mkdir()
    write_description(folder, Detector(16, 12, 20e-3), axes, {"machine": "carm"})
    write_exposures(folder, np.arange(24), np.arange(24.0), np.full(24, 0.01), dict(zip(axes, units, strict=True)), positions_of(axes))
    tifffile.imwrite(folder / "frames.tif", np.full((24, 12, 16), 2000, dtype=np.uint16))
    return folder


def positions_of(axes: tuple[str, str]) -> np.ndarray:
    return np.stack([ANGLE if axis == "roll" else 0.0 * ANGLE for axis in axes], axis=1)


def table_of(path: Path, axes: tuple[str, str] = ("propeller", "roll"), **notes: list[float] | str | None) -> Path:
    write_look_up(LookUp(axes, positions_of(axes), np.zeros((24, 9)), np.zeros((24, 9, 9)), {"machine": "carm", **notes}), path)
    return path


def reconstruct(capsys: pytest.CaptureFixture[str], *arguments: Path | int | str) -> tuple[int, pytest.CaptureResult]:
    with pytest.raises(SystemExit) as ended:
        main(["reconstruct", "carm", *(str(argument) for argument in arguments)])
    return ended.value.code, capsys.readouterr()


def refused(capsys: pytest.CaptureFixture[str], *arguments: Path | int | str) -> str:
    status, said = reconstruct(capsys, *arguments)
    assert status == 2
    assert said.err.count("\n") == 1
    return said.err


@pytest.mark.parametrize(
    ("notes", "axes", "line"),
    [
        ({"machine": "other"}, ("propeller", "roll"), "the look-up table is of other with axes propeller, roll; carm has propeller, roll"),
        ({}, ("roll", "propeller"), "the look-up table is of carm with axes roll, propeller; carm has propeller, roll"),
    ],
)
def test_a_table_of_another_machine_or_order_of_axes_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], notes: dict[str, str], axes: tuple[str, str], line: str
) -> None:
    table = table_of(tmp_path / "t.npz", axes, **notes)
    assert line in refused(capsys, scan_of(tmp_path / "scan"), "--lookup", table, "-o", tmp_path / "out")


@pytest.mark.nightly
def test_a_table_of_another_version_of_the_machine_s_file_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, scan = table_of(tmp_path / "t.npz", hash="0"), scan_of(tmp_path / "scan")
    pytest.importorskip("itk")
    status, said = reconstruct(capsys, scan, "--lookup", table, "--size", 16, "-o", tmp_path / "out")
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
    pytest.importorskip("itk")
    table, scan = table_of(tmp_path / "t.npz", speed=speed), scan_of(tmp_path / "scan")
    status, said = reconstruct(capsys, scan, "--lookup", table, "--size", 16, "-o", tmp_path / "out")
    assert status == 0
    assert ("roll went at" in said.out) == told
    assert not told or "what bends with speed is not this scan's" in said.out


@pytest.mark.parametrize(
    ("axes", "units", "line"),
    [
        (("roll", "propeller"), ("rad", "rad"), "a scan of axes roll, propeller; carm has propeller, roll"),
        (("propeller", "roll"), ("rad", "m"), "positions in rad, m; carm has rad, rad"),
    ],
)
def test_a_scan_of_other_axes_or_units_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], axes: tuple[str, str], units: tuple[str, str], line: str
) -> None:
    assert line in refused(capsys, scan_of(tmp_path / "scan", axes, units), "-o", tmp_path / "out")


def test_the_exposures_table_says_which_axis_slides(tmp_path: Path) -> None:
    scan = read_scan(scan_of(tmp_path / "scan", ("rail", "roll"), ("m", "rad")))
    assert (scan.folder / "exposures.csv").read_text().splitlines()[0].endswith("position_rail [m],position_roll [rad]")
    assert scan.units == ("m", "rad")
    np.testing.assert_array_equal(scan.positions[:, 1], ANGLE)


def test_a_volume_that_the_memory_does_not_hold_is_refused_before_an_image_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sysconf", {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 8 * 10**9 // 4096}.__getitem__)
    scan = scan_of(tmp_path / "scan")
    (scan / "frames.tif").write_bytes(b"II*\0")
    line = "--size 1024: takes 12.9 GB of memory; this computer has 8.0 GB"
    assert line in refused(capsys, scan, "--size", 1024, "-o", tmp_path / "out")
    assert "image 0 of 24 cannot be read" in refused(capsys, scan, "--size", 64, "-o", tmp_path / "out")
