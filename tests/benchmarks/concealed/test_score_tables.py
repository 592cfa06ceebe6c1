"""The tables that `score` prints: what counts against a bar stands there by its number, and the documentation shows no other figures."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_incomplete_runs import bars_of


def printed(path: Path) -> None:
    from concealed.command import main

    assert main(["tables", "--scores", str(path)]) == 0


def test_cases_that_were_missed_are_listed_with_what_they_were_called(tmp_path: Path) -> None:
    _, text = bars_of(tmp_path, missed=(3,), crashed=(0,))
    lines = text.splitlines()
    assert "- **Alarms**, 1: carm, no answer (0)" in lines
    assert "- **Singles missed**, 1: coulomb_friction at 9.0, called viscous_friction, `ambiguous` (3)" in lines
    assert "- **Sets without the truth**, 1: asked 3" in lines
    assert "- **Confidently wrong**, none" in lines
    assert (
        "| false alarms on nulls (no answer counts as one), one-sided upper bound | 1 of 2, 50.0 % | 1.3 to 98.7 %, upper 97.5 % |" in text
    )


def test_the_command_prints_a_committed_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, text = bars_of(tmp_path)
    printed(tmp_path / "scores_development.json")
    assert capsys.readouterr().out.strip() == text.strip()


@pytest.mark.parametrize("wrong", ["", "[]", '{"bars": []}'])
def test_another_file_is_refused_in_one_line(tmp_path: Path, wrong: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(wrong)
    with pytest.raises(SystemExit, match=r"other\.json: no file of scores as `score` writes it"):
        printed(path)
