"""A short scan of sixteen columns and its look-up table, and the command that reconstructs from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.calibration.use.lookup_table import LookUp, write_look_up
from hil.cli import main
from hil.imaging import Detector
from hil.imaging.scan_folder import write_description, write_exposures

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
