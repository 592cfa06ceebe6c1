"""Faults over two processes on UDP end as in lockstep; the whole list with the C-arm's own time-outs is a benchmark."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from bench_machines import patient_text
from places import BENCHMARKS

from hil.faults.check import run_trial
from hil.faults.motion import motion_of
from hil.faults.trials import trials
from hil.machine import machine_from_text

sys.path.insert(0, str(BENCHMARKS))
from faults_over_processes import over_processes

BUS = "udp:239.74.163.69"
ROWS = ("brake_feedback_stuck_open/roll/stop", "motor_encoder_frozen/roll_drive/sweep")
"""A stop that the operator asks for, after which the run stays to serve a hold, and one that the loop finds."""
LATE = 0.1
"""rad that the arm may go further: on a busy computer the I/O is polled a quarter of a second late."""


@pytest.mark.slow
@pytest.mark.parametrize("name", [ROWS[0], pytest.param(ROWS[1], marks=pytest.mark.nightly)])
def test_it_ends_as_in_lockstep(name: str, tmp_path: Path) -> None:
    machine = machine_from_text(patient_text('5000\noverrun = "wait"'))  # none of these faults is found by a time-out
    (row,) = trials(machine, "roll", [name])
    in_lockstep = run_trial(machine, "roll", row, motion_of(machine, "roll"))
    outcome = over_processes(row, machine, BUS, tmp_path, "--no-real-time")
    assert outcome.verdict == in_lockstep.verdict == "stopped", outcome.said
    assert outcome.travel < in_lockstep.travel + LATE
