"""isocenter geometry convert: a table through every file and back says the same, and what cannot be is one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hil.calibration.use.lookup_table import LookUp, read_look_up, write_look_up
from hil.cli import main
from hil.imaging import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.machine import load_machine

CARM = load_machine("carm")
POSITIONS = np.radians([[0.0, -40.0], [20.0, 10.0], [-70.0, 80.0]])


def isocenter(*arguments: Path | str) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code


@pytest.fixture
def table(tmp_path: Path) -> Path:
    deviation = np.random.default_rng(1).normal(0.0, np.repeat([1e-3, 2e-3, 3e-3], 3), (3, 9))
    write_look_up(LookUp(CARM.axes, POSITIONS, deviation, np.zeros((3, 9, 9)), {"machine": "carm"}), tmp_path / "t.npz")
    return tmp_path / "t.npz"


@pytest.mark.parametrize("way", [["a.csv"], ["a.json"], ["a.xml"], ["a.csv", "b.json", "c.xml", "d.csv"], ["n.npz"]])
def test_a_table_says_the_same_after_any_way(table: Path, tmp_path: Path, way: list[str]) -> None:
    source = table
    for name in way:
        assert isocenter("geometry", "convert", "carm", source, tmp_path / name, "--json", tmp_path / "said.json") == 0
        source = tmp_path / name
    expected = nominal_beam(CARM, POSITIONS).moved(read_look_up(table).deviation)
    said = ConeBeam.from_parameters(json.loads((tmp_path / "said.json").read_text())["parameters"])
    np.testing.assert_allclose(said.deviation_from(expected), 0.0, atol=1e-9)


def test_matrices_in_json_are_of_the_pixels_they_name(table: Path, tmp_path: Path) -> None:
    assert isocenter("geometry", "convert", "carm", table, tmp_path / "fine.json", "--binning", "2") == 0
    assert isocenter("geometry", "convert", "carm", tmp_path / "fine.json", tmp_path / "again.json") == 0
    fine, again = (json.loads((tmp_path / name).read_text()) for name in ("fine.json", "again.json"))
    assert again["detector"] == fine["detector"]
    assert fine["detector"]["columns"] == 1240
    np.testing.assert_allclose(again["matrices"], fine["matrices"], rtol=1e-9)


def test_what_dicom_cannot_hold_is_told(table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pydicom")
    assert isocenter("geometry", "convert", "carm", table, tmp_path / "a.dcm") == 0
    assert "DICOM's attributes hold no offsets and no turn in the panel's plane: lost up to" in capsys.readouterr().out
    assert isocenter("geometry", "convert", "carm", tmp_path / "a.dcm", tmp_path / "b.json", "--json", tmp_path / "b.txt") == 0
    parameters = np.array(json.loads((tmp_path / "b.txt").read_text())["parameters"])
    np.testing.assert_allclose(parameters[:, [0, 1, 3, 4]], 0.0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["t.npz", "x.txt"], "x.txt: must end in .npz, .csv"),
        (["t.npz", "t.npz"], "t.npz: is read by this command"),
        (["no.csv", "x.xml"], "no.csv: No such file"),
        (["t.npz", "x.json", "--rows-up"], "--rows-up: is for .xml"),
        (["t.npz", "x.dcm", "--images"], "--images: is for a scan's folder"),
        (["t.npz", "x.csv", "--with", "t.npz"], "has a geometry of its own; --with is for a scan's folder"),
        (["t.npz", "x.csv", "--binning", "7"], "cannot be read 7 x 7 at a time"),
    ],
)
def test_what_cannot_be_converted_is_one_line(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert isocenter("geometry", "convert", "carm", *arguments) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1


def test_matrices_of_other_pixels_and_tables_without_positions_are_refused(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert isocenter("geometry", "convert", "carm", table, tmp_path / "a.csv") == 0
    assert isocenter("geometry", "convert", "carm", tmp_path / "a.csv", tmp_path / "x.npz") == 2
    assert "a table goes by axis positions, and the input has none" in capsys.readouterr().err
    assert isocenter("geometry", "convert", "carm", tmp_path / "a.csv", tmp_path / "x.xml", "--binning", "8") == 2
    assert (
        "puts the focal spot 2.32 m from the panel, carm has 1.16 m; --binning 8 was taken for that of the images"
        in capsys.readouterr().err
    )
