"""What the first use costs: processor time of commands with an empty cache of compiled code over that with a full one.

python benchmarks/cold_and_warm.py [--rounds 3] [--anew]

Each round runs every command with an empty cache and then again with what that left. Rounds that the result has already are not repeated,
so that an interrupted run goes on where it was; `--anew` begins again. Processor time includes that of processes begun by a command, which
a busy computer lengthens: read the ratio.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "benchmarks" / "results" / "cold_and_warm.json"
COMMANDS = {
    "--help": ("--help",),
    "stop": ("stop", "--bus", "socketcan:vcan0"),
    "machine show carm": ("machine", "show", "carm"),
    "run jog": ("run", "jog", "-m", "carm", "-b", "lockstep:", "-o", "jog.csv"),
    "demo": ("demo", "-o", "demo"),
}
NOBODY_TO_STOP = 3  # exit status of a stop where nothing runs
MOST = 1.5
"""Of the processor time of later uses, what the first may take."""


def taken(words: tuple[str, ...], cache: Path) -> tuple[float, float]:
    """Return processor time and time [s] that a command takes; all that it writes goes to a folder that is then gone."""
    environment = {**os.environ, "ISOCENTER_CACHE": str(cache), "NUMBA_CACHE_DIR": str(cache / "numba"), "PYTHONPATH": str(ROOT)}
    with tempfile.TemporaryDirectory() as folder:
        began = time.monotonic()
        silent = subprocess.DEVNULL
        process = subprocess.Popen([sys.executable, "-m", "hil", *words], cwd=folder, env=environment, stdout=silent, stderr=silent)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in (0, NOBODY_TO_STOP):
            sys.exit(f"isocenter {' '.join(words)}: exit status {process.returncode}")
        return used.ru_utime + used.ru_stime, time.monotonic() - began


def main() -> None:
    """Measure and write benchmarks/results/cold_and_warm.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--anew", action="store_true", help="forget the rounds that the result has")
    arguments = parser.parse_args()
    found = json.loads(OUT.read_text(encoding="utf-8")) if OUT.exists() and not arguments.anew else {}
    for number in range(arguments.rounds):
        for name, words in COMMANDS.items():
            own = found.setdefault(name, {"rounds": []})
            if len(own["rounds"]) > number:
                continue
            with tempfile.TemporaryDirectory() as cache:
                cold, warm = (taken(words, Path(cache)) for _ in range(2))
            own["rounds"].append([round(each, 2) for each in (*cold, *warm)])
            columns = ("cold_processor_s", "cold_s", "warm_processor_s", "warm_s")
            own |= {key: round(statistics.median(column), 2) for key, column in zip(columns, zip(*own["rounds"], strict=True), strict=True)}
            own["cold_over_warm"] = round(statistics.median(row[0] / row[2] for row in own["rounds"]), 2)
            OUT.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=1))
    if any(found[name]["cold_over_warm"] > MOST for name in ("run jog", "demo")):
        sys.exit(f"the first use takes more than {MOST:g} times the processor time of the next")


if __name__ == "__main__":
    main()
