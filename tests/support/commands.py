"""The command line as calibration tests use it, and a short roll scan with the emulated panel's images."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.cli import main


def isocenter(*arguments: Path | str) -> int:
    """Exit status of one command."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code


def exposed_scan(folder: Path, *exposing: object, machine: str | Path = "carm") -> Path:
    """A folder with scan.mf4, truth.csv and images, exposed as asked; of another machine if its file is given."""
    sweep = ["--axis", "roll", "--from", "-15", "--to", "15", "--speed", "30", "--dwell", "0.2", "--truth", folder / "truth.csv"]
    assert isocenter("run", "scan", "-m", machine, "-b", "lockstep:", *sweep, "-o", folder / "scan.mf4") == 0
    assert isocenter("expose", machine, folder / "scan.mf4", "--truth", folder / "truth.csv", *exposing, "-o", folder / "images") == 0
    return folder
