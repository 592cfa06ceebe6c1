"""The map from the thesis to the code: chapter, section, equation and method to `file:symbol`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from docs.generate.markdown import code, table
from docs.generate.markdown import page as whole
from docs.generate.thesis_references import Reference, references
from docs.generate.thesis_sections import ALSO, CHAPTERS, DECLINED, SECTIONS, Section

ROOT = Path(__file__).resolve().parents[2]

INTRODUCTION = """
This page leads from every section of Chapters 2 to 8 and Appendix B of the thesis to the code that implements it. The
thesis is R. van der Maas, *Advanced geometric calibration and control for medical X-ray systems*. A place is
`file:symbol`; a file alone is a module as a whole. A section without code says *declined*, with the reason. The map
is collected from the references in docstrings and comments; where the code departs from a printed equation, the
docstring says so.
"""


def page() -> str:
    """Write the page."""
    found = references(ROOT) + [Reference(number, place) for number, places in ALSO.items() for place in places]
    parts = [INTRODUCTION]
    for chapter, title in CHAPTERS.items():
        mine = [section for section in SECTIONS if section.number[0] == chapter]
        name = "Appendix B" if chapter == "B" else f"Chapter {chapter}"
        parts.append(f"## {name}: {title}")
        if whole_chapter := _places(found, {chapter}):
            parts.append(f"The chapter as a whole: {whole_chapter}.")
        parts.append(table(("section", "method", "code"), (row(section, found) for section in mine)))
        equations = list(_equations(chapter, found))
        if equations:
            parts.append(table(("equation", "code"), equations))
    return whole("Thesis map", *parts)


def row(section: Section, found: Iterable[Reference]) -> tuple[str, str, str]:
    """Write a section's row: its own references and those to its equations, else its subsections, else why there are none."""
    found = list(found)
    wanted = {section.number, *(f"({section.number[0]}.{number})" for number in range(section.first, section.last + 1))}
    places = _places(found, wanted)
    if not places:
        inside = [each.number for each in SECTIONS if each.number.startswith(section.number + ".") and _is_implemented(each, found)]
        if inside:
            places = "in its parts: " + ", ".join(inside)
        else:
            places = f"declined: {DECLINED[section.number]}" if section.number in DECLINED else "missing"
    return section.number, section.title, places


def missing_rows(text: str) -> list[str]:
    """List the sections that a page has no row for, or whose row names neither code nor a reason."""
    rows = dict(re.findall(r"^\| ([2-8B][\d.]*) \| [^|]* \| (.*) \|$", text, re.MULTILINE))
    return [section.number for section in SECTIONS if rows.get(section.number, "missing") == "missing"]


def places_in(text: str) -> list[str]:
    """List the places that a page names."""
    return sorted(set(re.findall(r"`((?:[\w]+/)+\w+\.py(?::[\w.]+)?)`", text)))


def _is_implemented(section: Section, found: Iterable[Reference]) -> bool:
    return not row(section, found)[2].startswith(("declined", "missing"))


def _places(found: Iterable[Reference], wanted: set[str]) -> str:
    return ", ".join(code(place) for place in sorted({each.place for each in found if each.part in wanted}))


def _equations(chapter: str, found: list[Reference]) -> Iterator[tuple[str, str]]:
    numbers = sorted({int(each.part[3:-1]) for each in found if each.part.startswith(f"({chapter}.")})
    for number in numbers:
        yield f"({chapter}.{number})", _places(found, {f"({chapter}.{number})"})
