"""Recordings as an outside user writes them: a CSV with `name [unit]` cells and a TOML of that name (docs/generated/file-formats.md)."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from concealed.truth.plant import Machine


def write_recording(
    path: Path, machine: Machine, columns: dict[str, np.ndarray], experiment: dict[str, object], initial: dict[str, object] | None
) -> None:
    """Write `path` and its metadata; nine significant digits."""
    names = [f"{name} [{_unit(machine, name)}]" for name in columns]
    table = np.column_stack(list(columns.values()))
    lines = [",".join(names), *(",".join(["%.9g"] * table.shape[1]) % tuple(row) for row in table.tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    path.with_suffix(".toml").write_text(_metadata(machine, len(table), experiment, initial), encoding="utf-8")


def _unit(machine: Machine, name: str) -> str:
    if name == "time":
        return "s"
    if name.startswith("imu"):
        return "m/s^2"
    if name.startswith("gyro"):
        return "rad/s"
    group, axis = next((name.removesuffix(f"_{axis}"), axis) for axis in machine.axes if name.endswith(f"_{axis}"))
    i = machine.axes.index(axis)
    if group in ("reference", "position", "link_position"):
        return "m" if machine.length[i] else "rad"
    return str(machine.units[i])


def _metadata(machine: Machine, rows: int, experiment: dict[str, object], initial: dict[str, object] | None) -> str:
    digest = hashlib.sha256(machine.text.encode("utf-8")).hexdigest()
    parts = [
        "recording_format = 1",
        'software = "concealed benchmark"',
        f"rows = {rows}",
        "",
        "[machine]",
        f"name = {json.dumps(machine.name)}",
    ]
    parts += [
        f"hash = {json.dumps(digest)}",
        f"axes = {json.dumps(machine.axes)}",
        f"text = {json.dumps(machine.text)}",
        "",
        "[experiment]",
    ]
    parts += [f"{key} = {json.dumps(value)}" for key, value in experiment.items()]
    for axis, states in (initial or {}).items():
        parts += ["", f"[initial.controller_states.{axis}]", *(f"{name} = {json.dumps(rows)}" for name, rows in dict(states).items())]  # type: ignore[call-overload]
    return "\n".join(parts) + "\n"
