"""A tool cannot better its score by crashing, nor a run by leaving cases out or mixing commits."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from test_scoring import answer, finding, truth

if TYPE_CHECKING:
    from concealed.making import Places

NUMBERS = range(4)


def make_run(
    folder: Path,
    *,
    crashed: tuple[int, ...] = (),
    failed: tuple[object, ...] = (),
    left_out: tuple[object, ...] = (),
    commits: tuple[str] = ("a",),
    missed: tuple[int, ...] = (),
    faint: tuple[int, ...] = (),
) -> Places:
    """Two nulls and two singles; the tool is right where it answers."""
    from concealed.making import Places, seal

    places = Places(folder, "development")
    lines = []
    for number in NUMBERS:
        null = number < 2
        path = places.truth(number)
        path.parent.mkdir(parents=True, exist_ok=True)
        hidden = {"stratum": "null", "effects": [], "each": []} if null else {}
        if number in faint:
            hidden["each"] = [{"detectability": 0.4, "distances": {}, "separable": False}]
        path.write_text(json.dumps(truth(number=number, **hidden)))
        row = answer("consistent", []) if null else answer("explained", [finding("coulomb_friction", "roll")])
        if number in missed:
            row = answer("ambiguous", [finding("viscous_friction", "roll")])
        row |= {"number": number, "truth_sha256": seal(path), "commit": commits[number % len(commits)]}
        if number in crashed:
            del row["diagnosis"]
        if number in failed:
            row["exit_status"] = 2
        if number not in left_out:
            lines.append(json.dumps(row))
    (folder / "answers_development.jsonl").write_text("\n".join(lines) + "\n")
    return places


def bars_of(folder: Path, **run: tuple[int, ...]) -> tuple[dict[str, dict[str, object]], str]:
    from concealed.scoring import score

    text = score(make_run(folder, **run), folder, NUMBERS)
    bars = json.loads((folder / "scores_development.json").read_text())["bars"]
    return {bar["bar"].split(",")[0].split(" (")[0].split(":")[0]: bar for bar in bars}, text


def test_a_null_without_an_answer_is_an_alarm(tmp_path: Path) -> None:
    bars, _ = bars_of(tmp_path, crashed=(0, 3))
    assert (bars["false alarms on nulls"]["hits"], bars["false alarms on nulls"]["n"]) == (1, 2)
    assert (bars["no answer"]["hits"], bars["no answer"]["n"], bars["no answer"]["met"]) == (2, 4, False)


def test_sets_are_counted_with_and_without_effects_that_no_recording_shows(tmp_path: Path) -> None:
    bars, _ = bars_of(tmp_path, missed=(2, 3), faint=(3,))
    assert (bars["ambiguous sets hold the truth"]["hits"], bars["ambiguous sets hold the truth"]["n"]) == (0, 2)
    rows = json.loads((tmp_path / "scores_development.json").read_text())["bars"]
    shown = next(row for row in rows if "hardly show" in row["bar"])
    assert (shown["hits"], shown["n"], shown["met"]) == (0, 1, None)


def test_a_command_that_ends_in_an_error_has_not_answered_whatever_it_wrote_before(tmp_path: Path) -> None:
    bars, _ = bars_of(tmp_path, failed=(0, 3))
    assert (bars["no answer"]["hits"], bars["no answer"]["n"]) == (2, 4)
    assert bars["false alarms on nulls"]["hits"] == 1


def test_a_tool_that_always_answers_meets_that_bar_and_one_that_nobody_asks_for_is_not_met(tmp_path: Path) -> None:
    bars, text = bars_of(tmp_path)
    assert bars["no answer"]["met"]
    assert bars["false alarms on nulls"]["hits"] == 0
    assert bars["wrong among all confident answers"]["met"] is None
    lines = [line for line in text.splitlines() if "not asked" in line]
    assert lines
    assert all(line.endswith("| not asked | – |") for line in lines)


@pytest.mark.parametrize(
    ("run", "refused"), [({"left_out": (2,)}, r"1 cases have no answer \(2\)"), ({"commits": ("a", "b")}, r"2 commits \(a, b\)")]
)
def test_a_part_of_a_run_is_scored_only_on_request_and_says_so(tmp_path: Path, run: dict[str, tuple[object, ...]], refused: str) -> None:
    from concealed.scoring import score

    places = make_run(tmp_path, **run)
    with pytest.raises(SystemExit, match=refused):
        score(places, tmp_path, NUMBERS)
    score(places, tmp_path, NUMBERS, partial=True)
    table = json.loads((tmp_path / "scores_development.json").read_text())
    assert table["missing"] == list(run.get("left_out", ()))
    assert table["commits"] == list(run.get("commits", ("a",)))


def test_a_case_whose_recordings_a_killed_run_removed_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from concealed import making

    made = []
    monkeypatch.setattr(making, "case_of", lambda _places, number: type("Drawn", (), {"machine": "slider", "number": number})())
    monkeypatch.setattr(making, "machines", lambda _models: {"slider": None})
    monkeypatch.setattr(making, "make_case", lambda case, *_rest: made.append(case.number))
    places = make_run(tmp_path)
    places.case(1).mkdir(parents=True)
    for number in (1, 2):
        making.make(places, number)
    assert made == [2]


def test_a_truth_that_is_not_here_is_named_with_how_to_make_it(tmp_path: Path) -> None:
    from concealed.scoring import score

    places = make_run(tmp_path)
    places.truth(2).unlink()
    with pytest.raises(SystemExit, match=r"truth of case [2] is not here; .*make --seeds development --cases [2]"):
        score(places, tmp_path, NUMBERS)


def test_cases_that_another_computer_judged_keep_their_judgement_where_the_truth_made_here_is_another(tmp_path: Path) -> None:
    from concealed.scoring import score

    places = make_run(tmp_path)
    whole = score(places, tmp_path, NUMBERS)
    theirs = tmp_path / "theirs.json"
    table = json.loads((tmp_path / "scores_development.json").read_text())
    theirs.write_text(json.dumps(table | {"cases_judged": table["cases_judged"][2:3]}))
    other = places.truth(2).read_text().replace('"coulomb_friction"', '"cogging"')
    places.truth(2).write_text(other)
    with pytest.raises(SystemExit, match="not the truth that was sealed"):
        score(places, tmp_path, NUMBERS)
    assert score(places, tmp_path, NUMBERS, judged_before=theirs) == whole
    assert json.loads((tmp_path / "scores_development.json").read_text())["judged_before"] == [2]
    places.truth(3).write_text(other)
    with pytest.raises(SystemExit, match=r"not the truth that was sealed when case [3]"):
        score(places, tmp_path, NUMBERS, judged_before=theirs)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"commits": ["b"]}, "case 0 was judged by another answer"),
        ({"seeds": "sealed"}, "scores of sealed cases"),
        ({"cases_judged": [{"number": 2}]}, "no file of scores"),
        ({"commits": None}, "no file of scores"),
    ],
)
def test_what_is_no_file_of_scores_of_these_answers_is_refused(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    from concealed.scoring import score

    places = make_run(tmp_path)
    score(places, tmp_path, NUMBERS)
    table = json.loads((tmp_path / "scores_development.json").read_text())
    (tmp_path / "theirs.json").write_text(json.dumps(table | changes))
    with pytest.raises(SystemExit, match=said):
        score(places, tmp_path, NUMBERS, judged_before=tmp_path / "theirs.json")


def test_a_judgement_of_another_answer_is_refused(tmp_path: Path) -> None:
    from concealed.scoring import score

    places = make_run(tmp_path)
    score(places, tmp_path, NUMBERS)
    theirs = tmp_path / "theirs.json"
    theirs.write_text((tmp_path / "scores_development.json").read_text().replace('"explained"', '"ambiguous"'))
    with pytest.raises(SystemExit, match=r"case [2] was judged by another answer"):
        score(places, tmp_path, NUMBERS, judged_before=theirs)


def test_a_file_of_scores_that_is_not_there_is_said(tmp_path: Path) -> None:
    from concealed.scoring import score

    with pytest.raises(SystemExit, match="no file of scores"):
        score(make_run(tmp_path), tmp_path, NUMBERS, judged_before=tmp_path / "none.json")
