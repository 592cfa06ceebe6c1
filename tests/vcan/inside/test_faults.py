"""The most dangerous faults over vcan0, emulator and loop in two processes, end as in lockstep: stopped, and at rest by the truth."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest
from at_rest import SHIPPED
from most_dangerous import MOST_DANGEROUS
from places import BENCHMARKS
from processes import start, start_until_ready

from hil.faults.check import run_trial
from hil.faults.motion import motion_of
from hil.faults.trials import trials
from hil.machine import load_machine

sys.path.insert(0, str(BENCHMARKS))
from faults_over_processes import TRUTH, WATCHED_S, commands, ended, judged

ATTEMPTS = 3
"""A user-mode kernel stalls now and then for so long that a run ends by that."""


@pytest.mark.vcan
@pytest.mark.nightly
def test_they_end_as_in_lockstep(interface: str, tmp_path: Path) -> None:
    machine = load_machine(SHIPPED)
    motion = motion_of(machine, "roll")
    seen, in_lockstep = {}, {}
    for (row,) in (trials(machine, "roll", [name]) for name in MOST_DANGEROUS):
        in_lockstep[row.name] = run_trial(machine, "roll", row, motion).verdict
        for attempt in range(ATTEMPTS):
            folder = tmp_path / f"{len(in_lockstep)}_{attempt}"
            folder.mkdir()
            emulate, run = commands(row, machine, f"socketcan:{interface}", folder, "roll")
            emulator, _ = start_until_ready(folder, *emulate, "--no-real-time")
            bench = start(folder, *run, "--no-real-time")
            status = ended(bench.process.pid, lambda process=bench.process: process.exitcode, bench.errors)
            bench.process.join()
            time.sleep(WATCHED_S)
            emulator.end()
            outcome = judged(bench.errors.read_text(), status, folder / TRUTH, machine, "roll")
            print(f"{row.name}: {outcome}", flush=True)
            seen[row.name] = outcome.verdict
            if seen[row.name] == in_lockstep[row.name]:
                break
    assert seen == in_lockstep
    assert set(seen.values()) == {"stopped"}
    assert len(seen) >= 10
