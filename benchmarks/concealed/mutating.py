"""Mutations: what must make a finding vanish or move. A strong single effect is diagnosed as it is, with its efforts' signs turned, its
time shuffled, its axes swapped, and at 0.5, 1, 2 and 4 detection limits.
"""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from concealed.making import Places, case_of, machines
from concealed.preloaded import isocenter
from concealed.truth.build import make_case
from concealed.truth.draw import Case

STRENGTHS = (0.5, 1.0, 2.0, 4.0)
STRONG = 8.0
BLOCK_S = 0.5
MEASURED = ("current_", "effort_", "position_", "link_position_", "imu_", "gyro_")


def mutate_case(places: Places, number: int) -> dict[str, Any]:
    """Diagnose a single-effect case and its mutations; returns the findings of each."""
    case = case_of(places, number)
    assert case.stratum == "single", f"case {number} is no single effect"
    machine = machines(places.models)[case.machine]
    folder = places.work / places.seeds / "mutations" / f"{number:04d}"
    row: dict[str, Any] = {"number": number, "machine": case.machine, "kind": case.hidden[0].kind.name, "at": case.hidden[0].place}
    for strength in (*STRENGTHS, STRONG):
        made = folder / f"times_{strength:g}"
        make_case(_at_strength(case, strength), machine, made, folder / f"times_{strength:g}.json")
        row[f"times_{strength:g}"] = _diagnose(made)
    original = folder / f"times_{STRONG:g}"
    for name, change in (("negated", _negate), ("shuffled", _shuffle), ("swapped", _swap)):
        if name == "swapped" and len(machine.axes) < 2:
            row[name] = {"verdict": "does not apply to a machine of one axis", "findings": []}
            continue
        mutated = folder / name
        shutil.copytree(original, mutated, dirs_exist_ok=True)
        for path in mutated.glob("*.csv"):
            _rewrite(path, change, machine.axes, machine.rate_Hz)
        row[name] = _diagnose(mutated)
    shutil.rmtree(folder)
    return row


def _at_strength(case: Case, strength: float) -> Case:
    return replace(case, condition="plain", hidden=tuple(replace(hidden, times_limit=strength) for hidden in case.hidden))


def _diagnose(folder: Path) -> dict[str, Any]:
    out = folder.with_name(folder.name + "_out")
    runs = sorted(str(path) for path in folder.glob("run_*.csv"))
    done = isocenter("diagnose", str(folder / "machine.toml"), *runs, "--held-out", str(folder / "held_out.csv"), "-o", str(out))
    answer = out / "diagnosis.json"
    if done.exit_status != 0 or not answer.exists():
        return {"verdict": "refused", "findings": []}
    found = json.loads(answer.read_text(encoding="utf-8"))
    return {"verdict": found["verdict"], "findings": [f"{finding['effect']}@{finding['at']}" for finding in found["findings"]]}


Table = dict[str, np.ndarray]


def _rewrite(path: Path, change: Any, axes: list[str], rate_Hz: float) -> None:
    with path.open(newline="", encoding="utf-8") as stream:
        header, *rows = list(csv.reader(stream))
    values = np.array(rows, dtype=float)
    table = change({cell: values[:, i] for i, cell in enumerate(header)}, axes, rate_Hz)
    lines = [",".join(header)] + [",".join(f"{value:.9g}" for value in row) for row in np.column_stack([table[cell] for cell in header])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _negate(table: Table, _axes: list[str], _rate_Hz: float) -> Table:
    return {name: -values if name.startswith(("current_", "effort_")) else values for name, values in table.items()}


def _shuffle(table: Table, _axes: list[str], rate_Hz: float) -> Table:
    """Blocks of the measured channels in another order, the same in every recording of this length."""
    rows, block = len(next(iter(table.values()))), round(BLOCK_S * rate_Hz)
    blocks = np.random.default_rng(rows).permutation(rows // block)
    order = np.concatenate([np.arange(b * block, (b + 1) * block) for b in blocks] + [np.arange(rows // block * block, rows)])
    return {name: values[order] if name.startswith(MEASURED) else values for name, values in table.items()}


def _swap(table: Table, axes: list[str], _rate_Hz: float) -> Table:
    first, second = axes[:2]
    swapped = dict(table)
    for name in table:
        if name.startswith(MEASURED) and f"_{first} " in name:
            other = name.replace(f"_{first} ", f"_{second} ")
            swapped[name], swapped[other] = table[other], table[name]
    return swapped
