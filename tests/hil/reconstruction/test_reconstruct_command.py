"""What `reconstruct` must not take: another machine's table, axes in another order, a volume larger than the memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scans_to_reconstruct import ANGLE, refused, scan_of, table_of

from hil.imaging.scan_folder import read_scan


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
