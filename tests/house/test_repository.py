"""What the repository holds besides code stays small, and its top level is the one that is agreed on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

MOST_OF_RESULTS_BYTES = 3_000_000

TOP_LEVEL = {
    *("hil", "drivers", "controllers", "virtual_bus", "tests", "docs", "benchmarks"),
    *("pyproject.toml", "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff", "LICENSE", "Containerfile"),
    *(".ci", ".github", ".gitignore", ".pre-commit-config.yaml"),
}
"""The rooms, and the files that a project of this kind usually has."""


def tracked(folder: str) -> list[Path]:
    """Return the files under version control below a folder."""
    listing = subprocess.run(["git", "ls-files", "-z", folder], cwd=ROOT, capture_output=True, check=False)
    if listing.returncode:
        pytest.skip("not a checkout")
    return [path for name in listing.stdout.decode().split("\0") if name and (path := ROOT / name).is_file()]


def test_the_top_level_is_the_one_that_is_agreed_on() -> None:
    assert {path.relative_to(ROOT).parts[0] for path in tracked(".")} == TOP_LEVEL


def test_results_of_benchmarks_are_todays_alone() -> None:
    assert sum(path.stat().st_size for path in tracked("benchmarks/results")) <= MOST_OF_RESULTS_BYTES


def test_a_large_file_is_refused_by_its_name_and_size(tmp_path: Path) -> None:
    large, small = tmp_path / "large.bin", tmp_path / "small.bin"
    large.write_bytes(bytes(600_000))
    small.write_bytes(bytes(400_000))
    words = [sys.executable, str(ROOT / ".ci" / "large_files.py"), str(large), str(small)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stdout.splitlines() == [f"{large}: 600 kB; at most 500 kB belong in the repository"]
