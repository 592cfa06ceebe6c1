"""Run what is marked `nightly`, one test after the other; go on where an earlier run of the same commit stopped."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MINUTES = 90.0
FAILED, LEFT = 1, 3


def commit() -> str:
    """Name what is checked out, with a mark where it was changed since."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=12"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return described.stdout.strip()


def tests() -> list[str]:
    """Collect the tests marked `nightly`, by their pytest names."""
    words = [sys.executable, "-m", "pytest", "-m", "nightly", "--collect-only", "-q", "-o", "addopts="]
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False).stdout
    return [line for line in listed.splitlines() if "::" in line]


def command_of(proof: str) -> list[str]:
    """Return the command of a proof: a test's, or that of the journeys from a wheel."""
    if proof == "wheel":
        return ["bash", str(ROOT / ".ci" / "wheel")]
    return [sys.executable, "-m", "pytest", "-q", "-rs", "-o", "addopts=", "-p", "no:cacheprovider", proof]


def main() -> int:
    """Run until all is done or the time is over."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=MINUTES, help="end after so many")
    parser.add_argument("--list", action="store_true", help="say what there is, and what of it is done")
    options = parser.parse_args()
    end = time.monotonic() + 60.0 * options.minutes
    path = ROOT / "build" / "nightly" / f"{commit()}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    done: dict[str, float] = json.loads(path.read_text()) if path.exists() else {}
    proofs = ["wheel", *tests()]
    if options.list:
        for proof in proofs:
            print(f"{'done' if proof in done else 'left'}  {proof}")
        return 0
    failed = []
    for proof in [each for each in proofs if each not in done]:
        left_s = end - time.monotonic()
        if left_s <= 0.0:
            break
        began = time.monotonic()
        try:
            status = subprocess.run(command_of(proof), cwd=ROOT, timeout=left_s, check=False).returncode
        except subprocess.TimeoutExpired:
            print(f"out of time in {proof}")
            break
        seconds = time.monotonic() - began
        print(f"{'passed' if status == 0 else 'FAILED'} in {seconds:.0f} s: {proof}", flush=True)
        if status:
            failed.append(proof)
        else:
            done[proof] = round(seconds, 1)
            path.write_text(json.dumps(done, indent=1) + "\n")
    left = [proof for proof in proofs if proof not in done and proof not in failed]
    print(f"{len(done)} passed, {len(failed)} failed, {len(left)} left" + "".join(f"\nleft: {proof}" for proof in left))
    return FAILED if failed else LEFT if left else 0


if __name__ == "__main__":
    sys.exit(main())
