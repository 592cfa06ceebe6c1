"""Runs over vcan0: what stops one on a late computer, and another attempt then."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from processes import Done

from hil.doctor.trial import wake_ups

ATTEMPTS = 8
"""A computer that others use stalls now and then for so long that a limit of the machine file stops a run."""

WATCHED_S = 4.0
TOLD, DESIGN, SHAPER = "told.txt", "carm.observer.npz", "roll.shaper.npz"
"""Files in the folder of `tests/vcan/prepared.py`: lines for the summary of the tests; what is prepared."""

LIMITS = (
    r"the loop lost \d+ ticks in a row; timing.overrun_ticks bridges 8",
    r"no position for \d+ ticks, timing.stale_ticks bridges 3",
    r"no answer to 512 SYNCs within 0.00\d+ s each",
    r"position too late for 0.\d+ s, 0.250 s allowed, as for a heartbeat",
    r"no node has answered for 0.\d+ s, 0.250 s allowed, as for a heartbeat",
    r"no heartbeat for 0.\d+ s, 0.250 s allowed",
    r"the supervisor does not answer for 0.\d+ s",
    r"the I/O has given no valid state for \d+.\d+ s, 0.50 s are allowed",
    r"\w+ held by its drive: its position is not known, so its brake cannot be proven",
    r"^(KEEP AWAY, PRESS THE EMERGENCY STOP: )?\w+(, \w+)* not proven at rest: its drive does not answer",
    r"sensors not to be believed: imu: ",
)
"""What stops the machine on a late computer: overrun_ticks, stale_ticks, boot_timeout_s and
answer_timeout_s, heartbeat_s, the I/O's watchdog, and stale_after_s; then the stop itself, where answers come too late to prove anything.
The IMU's age and rate are marked, and told at the end."""


def why_it_ended(done: Done, answer: Path) -> str:
    """Why a run did not end with status 0, in its words; '' where it did."""
    if done.returncode == 0:
        return ""
    if answer.exists():
        return "sensors not to be believed: " + "; ".join(json.loads(answer.read_text())["recordings"][0]["judged"])
    lines = [line for line in done.stderr.splitlines() if line.startswith("isocenter: ")]
    return lines[-1].removeprefix("isocenter: ") if lines else f"status {done.returncode}: {done.stderr}"


def by_a_limit(said: str) -> bool:
    """Whether a limit of the machine file ended a run."""
    return any(re.search(limit, said) for limit in LIMITS)


def run_to_its_end(run: Callable[..., Done], folder: Path) -> Path:
    """Run, again where a limit stopped it; the recording, which may have marks of the IMU, on which no motion depends."""
    for attempt in range(ATTEMPTS):
        out, answer = folder / f"run_{attempt}.mf4", folder / f"run_{attempt}.json"
        done = run("-o", str(out), "--json", str(answer))
        if done.returncode == 0 or answer.exists():
            return out
        said = why_it_ended(done, answer)
        assert by_a_limit(said), said
    raise AssertionError(f"no run came to its end: {said}")


def timing_told(answer: Path) -> str:
    """Timing of the one recording in the JSON of a run, in words."""
    timing = json.loads(answer.read_text())["recordings"][0]["timing"]
    whole = " ".join(f"{name} {timing[f'work_time_{name}_us'] / 1e3:.2f}" for name in ("p50", "p99", "max"))
    return f"{timing['ticks']:g} rows, {timing['missed']:g} ticks missed, {timing['unanswered']:g} unanswered, a tick's work {whole} ms"


def late_answers(answer: Path) -> dict[str, int]:
    """SYNCs that were not answered in time, by node, as the run has noted."""
    notes = json.loads(answer.read_text())["recordings"][0]["notes"]
    found = (re.match(r"(\w+): TPDO .*?: (\d+) SYNCs were not answered in time", note) for note in notes)
    return {match[1]: int(match[2]) for match in found if match}


def told_wake_ups(rate_Hz: float) -> str:
    """How late a loop is that does nothing, in words."""
    late = np.percentile(wake_ups(1.0 / rate_Hz, WATCHED_S), [50.0, 99.9, 100.0]) * 1e3
    return "a bare loop at {:g} Hz is late by p50 {:.3f}, p99.9 {:.3f}, max {:.3f} ms".format(rate_Hz, *late)
