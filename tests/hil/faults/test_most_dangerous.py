"""The faults that left an arm moving before stops were proven, with every change; all of the table at night."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest
from bench_machines import CARM
from most_dangerous import MOST_DANGEROUS
from places import ROOT

from hil.faults.check import check_faults, run_trial
from hil.faults.claims import unlisted
from hil.faults.motion import motion_of
from hil.faults.page import is_failure
from hil.faults.trials import trials

TABLE = json.loads((ROOT / "benchmarks" / "results" / "faults_carm.json").read_text(encoding="utf-8"))
KEPT = {row["name"]: row for row in TABLE["rows"]}


def test_they_are_twelve_at_least() -> None:
    assert len(set(MOST_DANGEROUS)) >= 12


@pytest.mark.slow
@pytest.mark.parametrize("name", MOST_DANGEROUS)
def test_it_is_stopped_and_everything_is_at_rest_and_held(name: str) -> None:
    (row,) = trials(CARM, "roll", [name])
    outcome = run_trial(CARM, "roll", row, motion_of(CARM, "roll"))
    assert outcome.verdict == KEPT[name]["verdict"] == "stopped"
    assert outcome.exit_status == 1
    assert not is_failure(outcome), (outcome.budget, outcome.contradicted)
    assert not unlisted(outcome.said, CARM.axes), "a sentence that no truth is known of: add it to hil.faults.causes or claims"
    assert all(axis.at_rest and axis.ending.startswith("held") for axis in outcome.axes)
    assert outcome.travel == pytest.approx(KEPT[name]["travel"], rel=0.1, abs=2e-3)


def test_waiting_for_frames_that_do_not_come_is_no_time_of_the_machine() -> None:
    (row,) = trials(CARM, "roll", ["pdos_lost/roll_encoder/sweep"])
    outcome = run_trial(CARM, "roll", row, motion_of(CARM, "roll"))
    assert "standstill 0.16 s after the stop began" in outcome.said
    assert not outcome.contradicted


@pytest.mark.nightly
def test_every_fault_of_the_table_ends_as_its_page_says(tmp_path: Path) -> None:
    outcomes = check_faults(CARM, "roll", trials(CARM, "roll"), tmp_path)
    assert not [outcome.name for outcome in outcomes if is_failure(outcome)]
    assert not [sentence for outcome in outcomes for sentence in unlisted(outcome.said, CARM.axes)]
    assert {outcome.name: outcome.verdict for outcome in outcomes} == {name: row["verdict"] for name, row in KEPT.items()}
    assert Counter(outcome.verdict for outcome in outcomes) == Counter(TABLE["verdicts"])
