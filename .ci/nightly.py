"""Run what is marked `nightly`, one proof after the other; go on where an earlier run of the same tree stopped."""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MINUTES = 90.0
FAILED, LEFT = 1, 3
SCRIPTS = ("wheel", "supervisor", "properties")
"""Proofs of their own beside this file: the journeys of the README from an installed wheel; the supervisor's coverage and mutants; every
property on all of its examples."""


def git(*words: str) -> str:
    """Return what git prints."""
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def tree() -> str:
    """Name what is checked out: the commit, and a digest of what was changed since."""
    commit, changes = git("rev-parse", "--short=12", "HEAD").strip(), git("diff", "HEAD")
    new = [ROOT / name for name in git("ls-files", "-z", "--others", "--exclude-standard").split("\0") if name]
    changes += "".join(f"{path}\0{path.read_bytes()!r}" for path in new)
    return f"{commit}-{hashlib.sha256(changes.encode()).hexdigest()[:12]}" if changes else commit


def tests() -> list[str]:
    """Collect the tests marked `nightly`, all parameters of one together; leave with a line where there is none."""
    words = [sys.executable, "-m", "pytest", "-m", "nightly", "--collect-only", "-q", "-o", "addopts="]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    found = list(dict.fromkeys(line.partition("[")[0] for line in done.stdout.splitlines() if "::" in line))
    if done.returncode or not found:
        sys.exit(f"the nightly tests cannot be collected (pytest's status {done.returncode}):\n{done.stdout}{done.stderr}")
    return found


def outcome(proof: str, seconds: float) -> str:
    """Run a proof and all it starts, for so long at most: `passed`, `failed`, `skipped` or `out of time`."""
    if proof in SCRIPTS:
        words = ["bash", str(ROOT / ".ci" / proof)]
    else:
        words = [sys.executable, "-m", "pytest", "-q", "-rs", "-o", "addopts=", "-p", "no:cacheprovider", proof]
    with subprocess.Popen(
        words, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    ) as process:
        try:
            printed, _ = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            return "out of time"
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    if process.returncode:
        print(printed, flush=True)
        return "failed"
    if proof not in SCRIPTS and (re.search(r"\d+ skipped", printed) or not re.search(r"[1-9]\d* passed", printed)):
        print(printed, flush=True)
        return "skipped"
    return "passed"


def main() -> int:
    """Run until all is done or the time is over; what did not pass before comes last."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=MINUTES, help="end after so many")
    parser.add_argument("--list", action="store_true", help="say what there is, and how it ended")
    options = parser.parse_args()
    os.environ["ISOCENTER_EXAMPLES"] = "all"  # of properties, in whatever a proof starts
    end = time.monotonic() + 60.0 * options.minutes
    path = ROOT / "build" / "nightly" / f"{tree()}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    kept: dict[str, str] = json.loads(path.read_text()) if path.exists() else {}
    proofs = [*SCRIPTS, *tests()]
    if options.list:
        for proof in proofs:
            print(f"{kept.get(proof, 'left'):12s} {proof}")
        return 0
    for proof in sorted((each for each in proofs if kept.get(each) != "passed"), key=lambda each: each in kept):
        if end - time.monotonic() <= 0.0:
            break
        began = time.monotonic()
        kept[proof] = outcome(proof, end - began)
        print(f"{kept[proof]} after {time.monotonic() - began:.0f} s: {proof}", flush=True)
        path.write_text(json.dumps(kept, indent=1) + "\n")
    ends = {
        how: [proof for proof in proofs if kept.get(proof, "left") == how] for how in ("passed", "failed", "skipped", "out of time", "left")
    }
    print(", ".join(f"{len(names)} {how}" for how, names in ends.items()))
    for how, names in ends.items():
        if how != "passed":
            print("".join(f"{how}: {name}\n" for name in names), end="")
    return FAILED if ends["failed"] else LEFT if len(ends["passed"]) < len(proofs) else 0


if __name__ == "__main__":
    sys.exit(main())
