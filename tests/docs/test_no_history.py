"""Pages, sources and tests say what is, not how it came: no commit hash and no number of a benchmark's case stands in them."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from places import ROOT

SUFFIXES = (".py", ".md", ".toml", ".yaml", ".yml", ".sh", ".html", ".css")

ALLOWED = ("benchmarks/results/", "CHANGELOG.md", "benchmarks/concealed/", "docs/generated/results.md")
"""Data of the benchmarks and the page made of it, the list of changes, and the concealed benchmark: its command line takes such numbers."""

HEXADECIMAL = re.compile(r"(?<![\w#.])(?=[0-9a-f]*[0-9])(?=[0-9a-f]*[a-f])[0-9a-f]{7,40}(?![\w.])")
"""What may be a hash: letters and digits, and no colour, no `0x...`, no number with a point."""

CASE = re.compile(
    r"(?<!--)\b(?:cases?|sealed|development)\s+(?:number\s+)?[1-9][0-9]{0,4}\b(?!\s*(?:%|per cent|of\b|machines|draws))"
    r"|\b[1-9][0-9]{2,4}[,;]?\s+(?:both\s+|all\s+)?spent\b"
)
"""`case 123`, `cases 11901-12650`, `sealed 4092`, `(8311, spent)`."""

MATCH_STATEMENT = re.compile(r"^\s*case\s.*:\s*(#.*)?$", re.MULTILINE)


def texts() -> list[Path]:
    """List the files that people read: what git tracks, and what is new and not ignored."""
    listing = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT, capture_output=True, check=False
    )
    if listing.returncode:
        if os.environ.get("CI"):
            pytest.fail(f"git lists no files here: {listing.stderr.decode()}")
        pytest.skip("no checkout: git lists no files")
    names = sorted({name for name in listing.stdout.decode().split("\0") if name.endswith(SUFFIXES) and not name.startswith(ALLOWED)})
    return [ROOT / name for name in names if (ROOT / name).is_file()]


def possible_hashes(text: str) -> Iterator[tuple[int, str]]:
    """Yield line and word of everything that may be a hash."""
    for match in HEXADECIMAL.finditer(text):
        yield text.count("\n", 0, match.start()) + 1, match[0]


def case_numbers(text: str) -> Iterator[tuple[int, str]]:
    """Yield line and words of every number of a case, also where a line ends between them."""
    text = MATCH_STATEMENT.sub(lambda match: " " * len(match[0]), text)
    text = re.sub(r"\n(\s*)#", lambda match: "\n" + match[1] + " ", text)
    for match in CASE.finditer(text):
        yield text.count("\n", 0, match.start()) + 1, " ".join(match[0].split())


def known_to_git(words: Iterable[str]) -> set[str]:
    """Return the words that name a commit of this repository."""
    asked = sorted(set(words))
    answer = subprocess.run(
        ["git", "cat-file", "--batch-check=%(objecttype)"],
        cwd=ROOT,
        input="\n".join(asked) + "\n",
        capture_output=True,
        text=True,
        check=False,
    )
    kinds = answer.stdout.splitlines()[: len(asked)]
    return {word for word, kind in zip(asked, kinds, strict=True) if kind == "commit"} if asked else set()


def test_the_history_is_whole_in_ci() -> None:
    """In a shallow clone git knows one commit alone, and the next test would see no other."""
    asked = subprocess.run(["git", "rev-parse", "--is-shallow-repository"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert not (os.environ.get("CI") and asked.stdout.strip() != "false"), "fetch the whole history: fetch-depth 0"


def test_no_commit_is_named() -> None:
    """A hash counts where git knows the commit."""
    found = [(path, line, word) for path in texts() for line, word in possible_hashes(path.read_text(encoding="utf-8", errors="replace"))]
    known = known_to_git(word for _, _, word in found)
    assert [f"{path.relative_to(ROOT)}:{line}: {word}" for path, line, word in found if word in known] == []


def test_no_case_of_a_benchmark_is_named() -> None:
    """A reason is told by what was seen, not by where."""
    found = [
        f"{path.relative_to(ROOT)}:{line}: {words}"
        for path in texts()
        if path != Path(__file__).resolve()
        for line, words in case_numbers(path.read_text(encoding="utf-8", errors="replace"))
    ]
    assert found == []


def test_this_commit_would_be_found() -> None:
    """Its short and its long name are hashes that git knows, unless one has no letter or no digit."""
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    if not head:
        pytest.skip("no checkout: there is no commit")
    words = [word for _, word in possible_hashes(f"since {head}, and ({head[:12]}).")]
    assert words[0] == head
    assert known_to_git(words) == set(words)


@pytest.mark.parametrize("text", ["#a1b2c3d is a colour", "0xdeadbee1", "1234567", "deadbeef", "b1d2621x", "1e5.7e8"])
def test_other_hexadecimal_words_are_no_hashes(text: str) -> None:
    """Colours, constants, plain numbers and words."""
    assert list(possible_hashes(text)) == []


@pytest.mark.parametrize(
    "text",
    [
        "case 123",
        "cases 11901-12650",
        "sealed 4092's order",
        "development case 42",
        "# lost in\n    # case 12 alone",
        "(8311, spent)",
        "sealed\n    1137",
    ],
)
def test_numbers_of_cases_are_found(text: str) -> None:
    """However they are written."""
    assert len(list(case_numbers(text))) == 1


@pytest.mark.parametrize(
    "text", ["    case 12:\n", "in this case 12 % are lost", "a case of 12 V", "in 40 cases", "case 3 of 5", "--cases 12651-12665"]
)
def test_other_cases_are_left_alone(text: str) -> None:
    """Match statements and plain words."""
    assert list(case_numbers(text)) == []
