"""The thesis map leads from every section of the thesis to code that is there, or says why there is none."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from places import ROOT

from docs.generate.pages import GENERATED
from docs.generate.thesis_map import missing_rows, places_in, row
from docs.generate.thesis_references import Reference, parts_in, references_of, symbols
from docs.generate.thesis_sections import ALSO, DECLINED, SECTIONS, Section

PAGE = GENERATED / "thesis-map.md"

SECTIONS_OF_CHAPTERS = {"2": 5, "3": 6, "4": 9, "5": 6, "6": 6, "7": 5}
"""How many sections a chapter of the thesis has, by its table of contents."""

LAST_EQUATIONS = {"2": 21, "3": 48, "4": 55, "5": 38, "6": 12, "7": 40, "B": 19}


def gone(text: str, root: Path) -> list[str]:
    """List the places of a page whose file or symbol is not there."""
    lost = []
    for place in places_in(text):
        file, _, symbol = place.partition(":")
        path = root / file
        if not path.is_file() or (symbol and symbol not in symbols(path.read_text(encoding="utf-8"))):
            lost.append(place)
    return lost


def test_every_section_has_code_or_a_reason() -> None:
    """Chapters 2 to 8 and Appendix B."""
    assert missing_rows(PAGE.read_text(encoding="utf-8")) == []


def test_every_place_is_there() -> None:
    """File and symbol."""
    text = PAGE.read_text(encoding="utf-8")
    assert len(places_in(text)) > 100
    assert gone(text, ROOT) == []


METHODS = {
    "multisine": "controllers/multisine.py",
    "jog": "controllers/jog.py",
    "robust bla": "hil/identification/bla/robust_bla.py",
    "fast bla": "hil/identification/bla/fast_bla.py",
    "harmonic time delay": "controllers/shapers/harmonic_time_delay.py",
    "closed form htdf": "controllers/shapers/closed_form_htdf.py",
    "zero inversion": "controllers/shapers/zero_inversion.py",
    "shortest delays": "controllers/shapers/shortest_delays.py",
    "phantom calibration": "hil/calibration/phantom/phantom_calibration.py",
    "focal spot": "hil/calibration/marker/focal_spot.py",
    "kalman": "controllers/observers/kalman.py",
    "extended kalman": "controllers/observers/extended_kalman.py",
    "unscented kalman": "controllers/observers/unscented_kalman.py",
    "parameter states": "hil/calibration/parameter_states/filter.py",
    "parameter filter": "hil/calibration/data_driven/parameter_filter.py",
    "identify denavit hartenberg": "hil/calibration/kinematic/identify_denavit_hartenberg.py",
    "hybrid median": "hil/imaging/markers/hybrid_median.py",
    "canny hough": "hil/imaging/markers/canny_hough.py",
    "hadamard experiments": "controllers/hadamard_experiments.py",
    "detection lines": "hil/identification/bla/detection_lines.py",
    "nd lpm lrm": "hil/identification/lpm_lrm/nd_lpm_lrm.py",
    "wire profiles": "hil/reconstruction/wire_profiles.py",
}
"""Where a reader who knows the thesis and the list of files alone looks for a method."""

OF_THE_BUS = {
    "canopen heartbeat consumer": ("drivers/canopen/heartbeat_consumer.py", "virtual_bus/canopen/heartbeat_consumer.py"),
    "brake proof": ("drivers/canopen/brake_proof.py",),
    "quick stop": ("drivers/canopen/quick_stop.py",),
}
"""The same for what the standards of the bus name."""


def found_by(words: str) -> tuple[str, ...]:
    """Return the files of the four packages whose folders and names hold all the words."""
    files = [
        path.relative_to(ROOT).as_posix()
        for floor in ("hil", "virtual_bus", "controllers", "drivers")
        for path in (ROOT / floor).rglob("*.py")
    ]
    return tuple(sorted(file for file in files if set(words.split()) <= set(re.split(r"[/_.]", file))))


@pytest.mark.parametrize("method", METHODS)
def test_a_method_stands_under_its_name_and_in_the_map(method: str) -> None:
    assert METHODS[method] in found_by(method)
    assert METHODS[method] in {place.partition(":")[0] for place in places_in(PAGE.read_text(encoding="utf-8"))}


@pytest.mark.parametrize("method", OF_THE_BUS)
def test_what_the_standards_name_stands_under_its_name(method: str) -> None:
    assert found_by(method) == OF_THE_BUS[method]


def test_the_sections_are_those_of_the_thesis() -> None:
    """As many in every chapter, numbered without a hole, and equations from the first to the last."""
    for chapter, count in SECTIONS_OF_CHAPTERS.items():
        top = [section.number for section in SECTIONS if section.number.startswith(f"{chapter}.") and section.number.count(".") == 1]
        assert top == [f"{chapter}.{number}" for number in range(1, count + 1)]
        inner = [section.number for section in SECTIONS if section.number.startswith(f"{chapter}.") and section.number.count(".") == 2]
        parents = sorted({number.rpartition(".")[0] for number in inner})
        for parent in parents:
            mine = [number for number in inner if number.startswith(parent + ".")]
            assert mine == [f"{parent}.{number}" for number in range(1, len(mine) + 1)]
    for chapter, last in LAST_EQUATIONS.items():
        numbers = [
            n for section in SECTIONS if section.number[0] == chapter and section.last for n in range(section.first, section.last + 1)
        ]
        assert numbers == list(range(1, last + 1))


def test_reasons_and_further_places_are_of_sections_that_exist() -> None:
    """And no section has both code and a reason for having none."""
    numbers = {section.number for section in SECTIONS}
    assert set(DECLINED) <= numbers
    assert set(ALSO) <= numbers
    assert set(DECLINED).isdisjoint(ALSO)
    text = PAGE.read_text(encoding="utf-8")
    assert [number for number in DECLINED if f"\n| {number} | " not in text or f" | declined: {DECLINED[number]} |" not in text] == []


def test_a_symbol_that_goes_is_missed(tmp_path: Path) -> None:
    """A function renamed, or a file moved, and the place is lost."""
    source = '"""Thesis Sec. 3.3."""\n\n\ndef excite():\n    """Multisine (3.8)."""\n'
    (tmp_path / "hil").mkdir()
    (tmp_path / "hil" / "one.py").write_text(source)
    page = "| 3.3 | Experiment design | `hil/one.py`, `hil/one.py:excite` |\n"
    assert gone(page, tmp_path) == []
    (tmp_path / "hil" / "one.py").write_text(source.replace("excite", "excited"))
    assert gone(page, tmp_path) == ["hil/one.py:excite"]
    (tmp_path / "hil" / "one.py").unlink()
    assert gone(page, tmp_path) == ["hil/one.py", "hil/one.py:excite"]


def test_a_row_that_goes_is_missed() -> None:
    """So is a row that names neither code nor a reason."""
    text = PAGE.read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)
    without = "".join(line for line in lines if not line.startswith("| 5.3.3 |"))
    assert missing_rows(without) == ["5.3.3"]
    assert missing_rows(without + "| 5.3.3 | Unscented Kalman filter | missing |\n") == ["5.3.3"]


def test_references_are_found_where_they_stand() -> None:
    """In a module, a method, below a constant, and in a comment."""
    source = '''"""The BLA of Sec. 3.4.1."""

LINES = 3
"""Of (3.8)."""


class Model:
    """Chapter 5."""

    def fit(self):
        """Fit (4.39) to (4.41)."""
        return 2  # (4.47)
'''
    found = sorted(references_of(source, "a/b.py"))
    assert found == sorted(
        [
            Reference("3.4.1", "a/b.py"),
            Reference("(3.8)", "a/b.py:LINES"),
            Reference("5", "a/b.py:Model"),
            *(Reference(f"(4.{number})", "a/b.py:Model.fit") for number in (39, 40, 41, 47)),
        ]
    )


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("thesis Secs. 3.4 and 4.5", ["3.4", "4.5"]),
        ("(5.15)-(5.17)", ["(5.15)", "(5.16)", "(5.17)"]),
        ("Kak and Slaney, (3.41)", []),
        ("CiA 301 (7.5.2.36)", []),
        ("x = f(3.5) and (9.1)", ["(3.5)"]),
        ("(2.99)", []),
        ("Appendix B, (B.7)", ["B", "(B.7)"]),
    ],
)
def test_what_counts_as_a_reference(text: str, parts: list[str]) -> None:
    """Numbers of sections and equations that the thesis has; other sources are not the thesis."""
    assert list(parts_in(text)) == parts


def test_equations_count_for_the_section_they_stand_in() -> None:
    """A section without code of its own is found in its parts, else it is missing."""
    found = [Reference("(3.9)", "a.py:f")]
    assert row(Section("3.3", "Experiment design", 8, 9), found)[2] == "`a.py:f`"
    assert row(Section("3.4", "Nonparametric identification"), [Reference("3.4.2", "a.py")])[2] == "in its parts: 3.4.2"
    assert row(Section("3.4.2", "Local parametric approach", 24, 48), [])[2] == "missing"
