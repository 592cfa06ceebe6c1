"""The tables that `score` prints: what counts against a bar stands there by its number, and the documentation shows no other figures."""

from __future__ import annotations

import re

import pytest
from places import ROOT
from test_incomplete_runs import bars_of

RESULTS = ROOT / "benchmarks" / "results" / "concealed"
TOLD = re.compile(r"^\*\*\d+ sealed cases, .* at commit (\w+)\*\*", re.M)


def printed(path):
    from concealed.command import main

    assert main(["tables", "--scores", str(path)]) == 0


def test_cases_that_were_missed_are_listed_with_what_they_were_called(tmp_path):
    _, text = bars_of(tmp_path, missed=(3,), crashed=(0,))
    lines = text.splitlines()
    assert "- **Alarms**, 1: carm, no answer (0)" in lines
    assert "- **Singles missed**, 1: coulomb_friction at 9.0, called viscous_friction, `ambiguous` (3)" in lines
    assert "- **Sets without the truth**, 1: asked 3" in lines
    assert "- **Confidently wrong**, none" in lines
    assert (
        "| false alarms on nulls (no answer counts as one), one-sided upper bound | 1 of 2, 50.0 % | 1.3 to 98.7 %, upper 97.5 % |" in text
    )


def test_the_command_prints_a_committed_file(tmp_path, capsys):
    _, text = bars_of(tmp_path)
    printed(tmp_path / "scores_development.json")
    assert capsys.readouterr().out.strip() == text.strip()


@pytest.mark.parametrize("wrong", ["", "[]", '{"bars": []}'])
def test_another_file_is_refused_in_one_line(tmp_path, wrong):
    path = tmp_path / "other.json"
    path.write_text(wrong)
    with pytest.raises(SystemExit, match=r"other\.json: no file of scores as `score` writes it"):
        printed(path)


@pytest.fixture
def page():
    return (ROOT / "docs" / "concealed.md").read_text(encoding="utf-8")


def rows_of(commit, capsys):
    """Printed rows and lists, heads left out."""
    printed(RESULTS / f"scores_sealed_{commit}.json")
    return [line for line in capsys.readouterr().out.splitlines() if line.startswith(("| ", "- **")) and not line.startswith("| bar ")]


def test_the_proofs_page_shows_what_its_first_file_of_scores_holds(page, capsys):
    """Bars may have a column more at the right."""
    rows, shown = rows_of(TOLD.findall(page)[0], capsys), page.splitlines()
    assert len(rows) > 80
    assert [row for row in rows if not any(line.startswith(row) for line in shown)] == []


def test_its_last_column_and_the_lists_of_the_second_run_are_those_of_the_second_file(page, capsys):
    rows, shown = rows_of(TOLD.findall(page)[1], capsys), page.splitlines()
    lists = [row for row in rows if row.startswith("- **")]
    assert len(lists) == 7 and [row for row in lists if row not in shown] == []
    cells = [[cell.strip() for cell in row.strip("| ").split("|")] for row in rows]
    bars = [each for each in cells if each[-1] in ("yes", "no", "–")]
    assert len(bars) == 21
    for name, measured, *_ in bars[:-1]:  # of confidences, the last, the column says how many there were
        (line,) = [line for line in shown if line.startswith(f"| {name} | ")]
        assert line.strip("| ").split("|")[-1].split(", upper")[0].strip() == measured, name
