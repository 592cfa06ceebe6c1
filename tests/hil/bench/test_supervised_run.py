"""A run whose supervisor takes its permission back ends, with the reason in its line and its events."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from bench_machines import CARM

from drivers.supervisor.supervisor import Supervisor
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import LoopAbortedError
from hil.experiments import Static


def test_a_run_ends_when_the_supervisor_takes_its_permission_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    supervisors: list[Supervisor] = []
    begin = Supervisor.begin
    monkeypatch.setattr(Supervisor, "begin", lambda self: (supervisors.append(self), begin(self))[1])
    plan = Static(1.0, {}).plans(CARM)[0]
    with (
        pytest.raises(LoopAbortedError, match="the supervisor took its permission back: a reason; the motors were stopped"),
        open_bench(CARM, BenchOptions("lockstep:"), plan.start_pose) as bench,
    ):
        bench.run(plan, tmp_path / "run.mf4", lambda row: supervisors[-1].refuse(0.0, "a reason"))
    events = [json.loads(line) for line in (tmp_path / "run.events.jsonl").read_text(encoding="utf-8").splitlines()]
    (asked,) = [event for event in events if event["what"] == "stop asked"]
    assert (asked["who"], asked["reason"]) == ("supervisor", "the supervisor took its permission back: a reason")
