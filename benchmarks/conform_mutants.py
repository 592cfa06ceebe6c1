"""Whether `isocenter conform` finds what implementers of a CANopen node get wrong, and passes nodes that are sound.

Each defect of tests/support/node_mutants.py is put into an emulated bare device that has every service, in virtual time: the thirty that a
fixed seed draws, and all there are. All but one of the defects were written before the checks.

    python benchmarks/conform_mutants.py --json benchmarks/results/conform_mutants.json
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from full_device import NODE, full_device_eds
from node_mutants import SEED, Mutant, all_mutants, drawn_mutants
from places import DATA, ROOT

from drivers.canopen.eds import load_object_dictionary
from hil.conform.all_checks import Conformance, conform
from virtual_bus.canopen.bare import BareMachine
from virtual_bus.canopen.device_bus import DeviceBus


def checked(machine: BareMachine, eds: Path, *, writes: bool, until_failed: bool) -> Conformance:
    """Check one device."""
    bus = DeviceBus(machine)
    try:
        dictionary = load_object_dictionary(eds, machine.node.node_id)
        return conform(bus, bus.now, machine.node.node_id, dictionary, writes=writes, until_failed=until_failed)
    finally:
        bus.shutdown()


def judged(mutants: list[Mutant], eds: Path, *, writes: bool) -> list[dict[str, object]]:
    """Return for each defect the check that found it; "" where none did."""
    rows: list[dict[str, object]] = []
    for mutant in mutants:
        found = checked(mutant.machine(eds, NODE), eds, writes=writes, until_failed=True)
        failed = next((result for result in found.results if result.result == "fail"), None)
        row = {"kind": mutant.kind, "variant": mutant.variant, "found_by": failed.check if failed else ""}
        rows.append(row | {"clause": failed.clause if failed else ""})
    return rows


def counted(rows: list[dict[str, object]]) -> dict[str, object]:
    """Return how many were found, and which were not."""
    escaped = [f"{row['kind']} [{row['variant']}]" for row in rows if not row["found_by"]]
    return {"tried": len(rows), "found": len(rows) - len(escaped), "escaped": escaped}


def sound(full: Path) -> dict[str, dict[str, int]]:
    """Return the counts of devices without a defect."""
    shipped = sorted((ROOT / "drivers" / "canopen" / "eds_files").glob("*.eds"))
    makers = sorted(path for path in (DATA / "canopen").glob("*") if path.suffix in (".eds", ".dcf"))
    devices = {}
    for eds in [full, *shipped, *makers]:
        node_id = load_object_dictionary(eds).node_id or NODE
        found = checked(BareMachine(eds, node_id), eds, writes=True, until_failed=False)
        devices[eds.stem] = {kind: found.count(kind) for kind in ("pass", "fail", "skip")} | {"not_restored": len(found.not_restored)}
        print(f"{eds.stem}: {devices[eds.stem]}")
    return devices


def main() -> None:
    """Write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--json", type=Path, metavar="OUT")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        full = Path(folder) / "every_service.eds"
        full.write_text(full_device_eds())
        rows = judged(drawn_mutants(), full, writes=True)
        document = {
            "seed": SEED,
            "drawn": counted(rows),
            "all": counted(judged(all_mutants(), full, writes=True)),
            "all_without_writes": counted(judged(all_mutants(), full, writes=False)),
            "rows": rows,
            "sound": sound(full),
        }
    for name in ("drawn", "all", "all_without_writes"):
        print(f"{name}: {document[name]}")
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
