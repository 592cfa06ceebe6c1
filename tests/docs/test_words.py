"""The pages that are written by hand can be read in two hours: at most 30,000 words."""

from __future__ import annotations

from pathlib import Path

from places import ROOT

MOST_WORDS = 30_000
BESIDE = ("README.md", "CONTRIBUTING.md", "benchmarks/README.md")


NO_PAGES = {"generated", "changes"}
"""Folders of docs: what the code writes, and the coming lines of the changelog, which is no page either."""


def by_hand(root: Path) -> list[Path]:
    """List the pages that are written by hand: of docs all but `NO_PAGES`, and those beside it."""
    pages = [path for path in (root / "docs").rglob("*.md") if NO_PAGES.isdisjoint(path.relative_to(root).parts)]
    return sorted([*pages, *(root / name for name in BESIDE if (root / name).is_file())])


def words(path: Path) -> int:
    """Count words as `wc -w` does."""
    return len(path.read_text(encoding="utf-8").split())


def test_the_pages_written_by_hand_stay_short() -> None:
    """What is listed by the code belongs on a generated page, what was measured on the page of results."""
    counted = {path.relative_to(ROOT).as_posix(): words(path) for path in by_hand(ROOT)}
    assert sum(counted.values()) <= MOST_WORDS, sorted(counted.items(), key=lambda item: -item[1])[:12]


def test_generated_pages_are_not_counted_and_all_others_are(tmp_path: Path) -> None:
    """In any folder of docs."""
    for name in ("docs/index.md", "docs/how-to/a.md", "docs/generated/b.md", "docs/changes/c.md", "README.md", "benchmarks/README.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("two words\n")
    assert [path.relative_to(tmp_path).as_posix() for path in by_hand(tmp_path)] == [
        "README.md",
        "benchmarks/README.md",
        "docs/how-to/a.md",
        "docs/index.md",
    ]
    assert words(tmp_path / "README.md") == 2
