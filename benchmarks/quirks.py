"""Bring up, home, run and stop the C-arm with every quirk of a drive, in lockstep, and keep what became of each.

In torque mode the axis is homed where it stands, and sweeps; in velocity mode it homes at a limit switch; where units or modes of
operation matter it also sweeps in velocity mode.

    python benchmarks/quirks.py [NAME ...]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from quirk_trials import tried, verdict_of, ways_of

from virtual_bus.quirks.quirk import Quirk
from virtual_bus.quirks.registry import quirks

RESULTS = Path(__file__).parent / "results" / "quirks_carm.json"
SAID = 300  # characters


def outcomes(quirk: Quirk, known: dict[str, dict[str, str]]) -> dict[str, dict[str, str]]:
    """Return verdict and words of a quirk, by way; those that are known are not tried."""
    found = {}
    for way in ways_of(quirk):
        if way in known:
            found[way] = known[way]
            continue
        with tempfile.TemporaryDirectory() as folder:
            outcome = tried(quirk, way, Path(folder))
        said = outcome.said.partition("; the motors were stopped")[0]
        found[way] = {
            "verdict": verdict_of(quirk, way, outcome),
            "said": said if len(said) <= SAID else said[: SAID - 1] + "…",
        }
    return found


def main() -> None:
    """Try what the results lack, or the quirks that are named, and write after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="quirks to try anew")
    names = parser.parse_args().names
    rows = json.loads(RESULTS.read_text(encoding="utf-8"))["rows"] if RESULTS.exists() else {}
    for quirk in quirks().values():
        known = {} if quirk.name in names else rows.get(quirk.name, {})
        rows[quirk.name] = outcomes(quirk, known)
        if rows[quirk.name] != known:
            print(quirk.name, rows[quirk.name], flush=True)
        kept = {name: rows[name] for name in quirks() if name in rows}
        counts = Counter(way["verdict"].partition(" at ")[0] for row in kept.values() for way in row.values())
        document = {"machine": "carm", "quirks": len(kept), "trials": sum(map(len, kept.values())), "verdicts": dict(counts), "rows": kept}
        RESULTS.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
