"""At which rate this kernel carries the shipped machine: measured, and told outside."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from processes import Done

from hil.doctor.trial import wake_ups
from hil.machine import Machine, load_machine

SHIPPED, SLOWER_Hz = "carm", 128
SPARE_SHARE = 0.5
ATTEMPTS = 8
"""A user-mode kernel on a computer that others use stalls now and then for so long that a limit of the machine file stops a run."""

AT_REST = ("static", "--seconds", "1", "--seed", "3")
WATCHED_S = 4.0
TOLD, RATE, DESIGN, SHAPER = "told.txt", "rate", "carm.observer.npz", "roll.shaper.npz"
"""Files in the folder of `tests/vcan/prepared.py`: lines for the summary of the tests; the rate to prepare for; what is prepared."""

LIMITS = (
    r"the loop lost \d+ ticks in a row; timing.overrun_ticks bridges [84]",
    r"no position for \d+ ticks, timing.stale_ticks bridges [31]",
    r"no answer to (512|256) SYNCs within 0.00\d+ s each",
    r"position too late for 0.\d+ s, 0.250 s allowed, as for a heartbeat",
    r"no node has answered for 0.\d+ s, 0.250 s allowed, as for a heartbeat",
    r"no heartbeat for 0.\d+ s, 0.250 s allowed",
    r"the supervisor does not answer for 0.\d+ s",
    r"the I/O has given no valid state for \d+.\d+ s, 0.50 s are allowed",
    r"\w+ held by its drive: its position is not known, so its brake cannot be proven",
    r"^(KEEP AWAY, PRESS THE EMERGENCY STOP: )?\w+(, \w+)* not proven at rest: its drive does not answer",
    r"sensors not to be believed: imu: ",
)
"""What stops the machine on a late computer by the shipped file or the converted one: overrun_ticks, stale_ticks, boot_timeout_s and
answer_timeout_s, heartbeat_s, the I/O's watchdog, and stale_after_s; then the stop itself, where answers come too late to prove anything.
The IMU's age and rate are marked, and told at the end."""


@dataclass(frozen=True)
class Carried:
    """The shipped machine, or the same at a lower rate, as this kernel carries it."""

    file: str
    options: tuple[str, ...]  # of `isocenter run`
    at_256_Hz: Done
    said: str  # why it ended there

    @property
    def machine(self) -> Machine:
        """The machine."""
        return load_machine(self.file)


def carried(folder: Path, run: Callable[..., Done], answer: Path) -> Carried:
    """Measure, decide, and tell.

    Parameters
    ----------
    folder : Path
        Of what is prepared.
    run : callable
        `isocenter run` of the shipped machine at rest, with more options.
    answer : Path
        File for its JSON.
    """
    told = [_told_wake_ups(rate) for rate in (256, SLOWER_Hz)]
    done = run(*AT_REST, "--machine", SHIPPED, "--json", str(answer), "-o", str(answer.with_suffix(".mf4")))
    said = why_it_ended(done, answer)
    if done.returncode == 0 and carries(answer):
        told.append(f"shipped machine at 256 Hz: {timing_told(answer)}")
        found = Carried(SHIPPED, (), done, said)
    else:
        told.append(f"shipped machine at 256 Hz: {said or timing_told(answer)}")
        told.append(f"so it runs at {SLOWER_Hz} Hz (isocenter machine convert), its margins accepted: {_failing(folder)}")
        found = Carried(str(folder / f"{SHIPPED}_{SLOWER_Hz}.toml"), ("--accept-margins",), done, said)
    (folder / TOLD).write_text("".join(f"{line}\n" for line in told))
    part = (folder / RATE).with_suffix(".part")
    part.write_text(f"{found.machine.sample_rate_Hz:g}")
    part.rename(folder / RATE)  # whole or not there, for who looks for it outside
    return found


def carries(answer: Path) -> bool:
    """Whether a run at 256 Hz has left time to spare: the observer's, and that of a busier minute."""
    timing = json.loads(answer.read_text())["recordings"][0]["timing"]
    return bool(timing["missed"] == 0 and timing["work_time_p99_us"] <= SPARE_SHARE * 1e6 / 256.0)


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


def _told_wake_ups(rate_Hz: int) -> str:
    late = np.percentile(wake_ups(1.0 / rate_Hz, WATCHED_S), [50.0, 99.9, 100.0]) * 1e3
    return "a bare loop at {} Hz is late by p50 {:.3f}, p99.9 {:.3f}, max {:.3f} ms".format(rate_Hz, *late)


def _failing(folder: Path) -> str:
    lines = (folder / "converted.txt").read_text().splitlines()
    return "; ".join(line.removeprefix("FAIL ") for line in lines if line.startswith("FAIL") and ": " in line) or "none fails"
