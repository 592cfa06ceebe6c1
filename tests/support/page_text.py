"""What a page says: its verdict, and its text without scripts and styles."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path

HIDDEN = re.compile(r"<(script|style)\b.*?</\1>", re.DOTALL)
TAG = re.compile(r"<[^>]+>")


def page_text(path: Path) -> str:
    """Text of a page, one space between words."""
    return " ".join(unescape(TAG.sub(" ", HIDDEN.sub(" ", path.read_text(encoding="utf-8")))).split())


def page_verdict(path: Path) -> str:
    """The sentence on top; it stands before every section and every chart."""
    page = path.read_text(encoding="utf-8")
    found = re.search(r'<p class="verdict \w+">(.*?)</p>', page, re.DOTALL)
    assert found is not None
    assert all(found.end() < place for mark in ("<h2>", "<figure", "<table") if (place := page.find(mark)) >= 0)
    return " ".join(unescape(TAG.sub(" ", found[1])).split())
