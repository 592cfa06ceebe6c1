"""Keep the table of `isocenter faults check` for the pages, without what differs from computer to computer.

isocenter faults check carm -o faults
python benchmarks/fault_table.py faults
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

VERDICTS = ("stopped", "noted", "within tolerance", "unnoticed", "cannot be held", "not at rest", "never began", "did not end")


def main() -> None:
    """Write benchmarks/results/faults_MACHINE.json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("folder", type=Path, help="that `faults check` wrote")
    table = json.loads((parser.parse_args().folder / "faults.json").read_text(encoding="utf-8"))
    counts = Counter(row["verdict"] for row in table["faults"])
    rows = [
        {
            "name": row["name"],
            "verdict": row["verdict"],
            "rest_s": row["rest_s"] if row["rest_s"] is None else round(row["rest_s"], 3),
            "travel": row["travel"] if row["travel"] is None else round(row["travel"], 4),
            "budget": row["budget"]
            and {key: round(value, 4) if isinstance(value, float) else value for key, value in row["budget"].items()},
            "ending": row["ending"],
            "contradicted": row["contradicted"],
            "said": row["said"],
        }
        for row in table["faults"]
    ]
    kept = {key: table[key] for key in ("machine", "axis", "speed", "unit")}
    path = Path(__file__).parent / "results" / f"faults_{table['machine']}.json"
    told = {"over_budget": sum(_is_over(row["budget"]) for row in rows), "contradicted": sum(bool(row["contradicted"]) for row in rows)}
    document = {**kept, "faults": len(rows), "verdicts": {verdict: counts[verdict] for verdict in VERDICTS}, **told, "rows": rows}
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"{path}: {len(rows)} faults")


def _is_over(used: dict[str, float | None] | None) -> bool:
    """Return whether a stop took more than its budget; null is endless."""
    if used is None:
        return False
    took = [(used["time_s"], used["allowed_s"]), (used["travel"], used["allowed_travel"])]
    return any(value is None or (allowed is not None and value > allowed) for value, allowed in took)


if __name__ == "__main__":
    main()
