"""Files can be read in a sitting, say what they are for, hold nothing unfinished and no path of somebody's machine."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from places import ROOT

PACKAGES = ("hil", "drivers", "controllers", "virtual_bus")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
A_SITTING = 450
UNFINISHED = re.compile(r"\b(TO" + r"DO|FIX" + r"ME|NotImplemented" + r"Error)\b")
PRIVATE_PATH = re.compile(r"(?<![\w.])/(home|root|Users|wo" + r"rk)/\w")


def tracked_texts() -> list[Path]:
    """Every text file under version control; the packages alone where this is no checkout."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listing.returncode:
        return SOURCES
    names = [name for name in listing.stdout.decode().split("\0") if name]
    text = {".py", ".md", ".toml", ".sh", ".html", ".eds", ""}
    return [ROOT / name for name in names if Path(name).suffix in text and (ROOT / name).is_file()]


def test_no_file_is_longer_than_a_sitting() -> None:
    assert {str(path.relative_to(ROOT)): n for path in SOURCES if (n := len(path.read_text().splitlines())) > A_SITTING} == {}


def test_nothing_is_left_unfinished() -> None:
    assert [str(path.relative_to(ROOT)) for path in SOURCES if UNFINISHED.search(path.read_text())] == []


def test_no_two_files_of_tests_share_a_name() -> None:
    """Pytest imports them by their names alone and collects only the first."""
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert sorted(name for name in set(names) if names.count(name) > 1) == []


def test_no_path_of_one_persons_machine_is_tracked() -> None:
    assert [str(path.relative_to(ROOT)) for path in tracked_texts() if PRIVATE_PATH.search(path.read_text(errors="replace"))] == []
