"""Jobs in processes of their own: one that hangs, dies or takes too much memory is ended, tried once more, and then named."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

from hil.fleet.job import GB, Job, Outcome

ATTEMPTS = 2
"""How often a job is tried whose process did not answer: a second time may find more memory or a quieter computer."""

LOOK_S = 0.1
"""Period at which the memory of a process is looked at."""

SINGLE_THREADED = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
"""As on the command line: the order of sums, and so their last digit, shall not depend on the computer."""

_own = threading.local()


class _NoAnswerError(Exception):
    """The process of a job did not answer."""


class Child:
    """A process that computes one job after the other, started when there is one; it is ended when `cancelled` says so."""

    def __init__(self, cancelled: Callable[[], bool] = lambda: False) -> None:
        self._cancelled = cancelled
        self._process: subprocess.Popen[bytes] | None = None
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def run(self, job: Job) -> Outcome:
        """Compute a job; where its process does not answer, in a new one once more."""
        failure, began_s = "", time.monotonic()
        for _ in range(ATTEMPTS):
            try:
                answer = self._ask(job)
            except _NoAnswerError as problem:
                self.end()
                failure = f"{problem} ({ATTEMPTS} attempts)"
                if self._cancelled():
                    break
            except BaseException:
                self.end()
                raise
            else:
                return Outcome(job.name, answer.get("value"), answer.get("failure", ""), time.monotonic() - began_s)
        return Outcome(job.name, failure=failure, wall_s=time.monotonic() - began_s)

    def end(self) -> None:
        """End the process; the next job has a new one."""
        process, self._process = self._process, None
        if process is None:
            return
        with contextlib.suppress(OSError):
            process.kill()
        process.wait()
        if process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()

    def _ask(self, job: Job) -> dict[str, Any]:
        if self._process is not None and self._process.poll() is not None:
            self.end()
        if self._process is None:
            self._start()
        process = self._process
        assert process is not None
        assert process.stdin is not None
        call = json.dumps({"function": job.function, "argument": job.argument}) + "\n"
        try:
            process.stdin.write(call.encode("utf-8"))
            process.stdin.flush()
        except OSError:
            raise _NoAnswerError(_ended(process)) from None
        answer: dict[str, Any] = json.loads(self._answered(process, job))
        return answer

    def _start(self) -> None:
        path = os.pathsep.join(part for part in sys.path if part)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hil.fleet.child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **SINGLE_THREADED, "PYTHONPATH": path},
        )
        self._lines = queue.SimpleQueue()
        threading.Thread(target=_read, args=(self._process.stdout, self._lines), daemon=True).start()

    def _answered(self, process: subprocess.Popen[bytes], job: Job) -> bytes:
        """Wait for the line of an answer; one that comes too late is none, however busy this process was."""
        until_s = time.monotonic() + job.needs.time_s
        while True:
            with contextlib.suppress(queue.Empty):
                line = self._lines.get(timeout=min(LOOK_S, max(until_s - time.monotonic(), 0.0)))
                if not line:
                    raise _NoAnswerError(_ended(process))
                if time.monotonic() <= until_s:
                    return line
            if self._cancelled():
                raise _NoAnswerError("was cancelled")
            if (used := resident_bytes(process.pid)) > job.needs.memory_GB * GB:
                raise _NoAnswerError(f"took {used / GB:.3g} GB of memory, more than {job.needs.memory_GB:g} GB, and was ended")
            if time.monotonic() > until_s:
                raise _NoAnswerError(f"gave no answer within {job.needs.time_s:g} s and was ended")


def _read(answers: IO[bytes], lines: queue.SimpleQueue[bytes]) -> None:
    """Hand on every answer, and at the end, also in the midst of an answer, an empty one."""
    with answers:
        for line in answers:
            if line.endswith(b"\n"):
                lines.put(line)
    lines.put(b"")


def _ended(process: subprocess.Popen[bytes]) -> str:
    status = process.wait()
    return f"its process ended by {signal.Signals(-status).name}" if status < 0 else f"its process ended with status {status}"


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process; 0 where the system does not tell it (only Linux is asked)."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0


def run_apart(jobs: Sequence[Job], batch_s: float) -> list[Outcome]:
    """Compute jobs one after the other in the process that this thread has for jobs; none is begun after `batch_s` but the first."""
    child: Child | None = getattr(_own, "child", None)
    if child is None:
        child = _own.child = Child()
    until_s = time.monotonic() + batch_s
    outcomes = [child.run(jobs[0])]
    for job in jobs[1:]:
        if time.monotonic() > until_s:
            break
        outcomes.append(child.run(job))
    return outcomes


def end_own() -> None:
    """End the process that this thread has for jobs."""
    child: Child | None = getattr(_own, "child", None)
    if child is not None:
        child.end()
