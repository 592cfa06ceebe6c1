"""A job that hangs, dies or takes too much memory costs itself, is named, and costs nothing else."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from fleet_jobs import NEEDS, job

from hil.fleet.apart import end_own, run_apart
from hil.fleet.engine import one_by_one
from hil.fleet.job import Job, Outcome

SOUND = job("thirds", {"of": [1.0, 2.0]})


def outcomes(*jobs: Job) -> list[Outcome]:
    return list(one_by_one(jobs, threading.Event()))


def test_an_answer_has_every_digit_whatever_the_job_prints() -> None:
    [found] = outcomes(SOUND)
    assert found.value["thirds"] == [1.0 / 3.0, 2.0 / 3.0]
    assert found.failure == ""


def test_jobs_share_a_process_that_is_not_this_one() -> None:
    processes = {found.value["process"] for found in outcomes(SOUND, replace(SOUND, name="again"))}
    assert len(processes) == 1


@pytest.mark.parametrize(
    ("unsound", "said"),
    [
        (job("hang", needs=replace(NEEDS, time_s=2.0)), "gave no answer within 2 s and was ended (2 attempts)"),
        (job("die"), "its process ended by SIGKILL (2 attempts)"),
        (job("fail"), "this was not foreseen"),
        pytest.param(
            job("fill_memory", needs=replace(NEEDS, memory_GB=0.4)),
            "more than 0.4 GB, and was ended",
            marks=pytest.mark.skipif(sys.platform != "linux", reason="memory of other processes is known on Linux"),
        ),
    ],
    ids=lambda one: one.function.partition(":")[2] if isinstance(one, Job) else "",
)
def test_an_unsound_job_is_named_and_the_next_one_is_computed(unsound: Job, said: str) -> None:
    bad, good = outcomes(unsound, SOUND)
    assert said in bad.failure
    assert good.value["thirds"] == [1.0 / 3.0, 2.0 / 3.0]


def test_a_process_that_dies_once_costs_an_attempt_only(tmp_path: Path) -> None:
    [found] = outcomes(job("die_once", {"mark": str(tmp_path / "died")}))
    assert found == Outcome("die_once", "done")


def test_a_cancelled_run_ends_what_hangs() -> None:
    cancelled = threading.Event()
    timer = threading.Timer(0.5, cancelled.set)
    timer.start()
    assert list(one_by_one([job("hang"), SOUND], cancelled)) == []


def test_jobs_given_together_have_each_its_own_answer_and_a_slow_one_leaves_the_rest_undone() -> None:
    jobs = [replace(SOUND, name=str(number)) for number in range(3)]
    try:
        assert [found.name for found in run_apart(jobs, 60.0)] == ["0", "1", "2"]
        [failed] = run_apart([job("hang", needs=replace(NEEDS, time_s=1.0)), *jobs], 0.5)
    finally:
        end_own()
    assert "gave no answer within 1 s" in failed.failure
