"""The page of both C-arms side by side: what every method errs and states on `carm` and on `carm-real`, from benchmarks/results."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from docs.generate.markdown import block, table
from docs.generate.markdown import page as whole
from docs.generate.results import FOLDER, shown_value

MACHINES = ("carm", "carm-real")

INTRODUCTION = """
Every method on the shipped C-arm, whose joints have viscous damping and nothing else, and on its hard sister
([how they differ](../explanation/carm.md)). *True* is the root mean square error against the emulator's truth, *stated* the
standard deviation that the method gives with its answer, *ratio* stated over true: 1 is right, less promises too much.
*NIS* is per measurement. Empty cells: the method says nothing of it. What is bad stands here, too, with its reason below.
"""


class Cell(NamedTuple):
    """What one method says on one machine."""

    true: float | None = None
    stated: float | None = None
    ratio: float | None = None
    nis: float | None = None
    told: str = ""


class Part(NamedTuple):
    """One results file: how its rows are read, what `told` counts, and why what is bad is so."""

    file: str
    title: str
    command: str
    told: str
    rows: Callable[[dict[str, Any]], Iterator[tuple[str, Mapping[str, Cell]]]]
    reasons: str


def page(folder: Path = FOLDER) -> str:
    """Write the page; a results file that is not there is left out with its section."""
    parts = [INTRODUCTION]
    for part in PARTS:
        if not (folder / part.file).exists():
            continue
        found = json.loads((folder / part.file).read_text(encoding="utf-8"))
        heads = [f"{machine}: {head}" for machine in MACHINES for head in ("true", "stated", "ratio", "NIS", part.told)]
        lines = [[label, *(text for machine in MACHINES for text in _texts(cells.get(machine)))] for label, cells in part.rows(found)]
        used = [0, *(k for k in range(1, len(heads) + 1) if any(line[k] for line in lines))]
        header = ["method", *heads]
        parts += [
            f"## {part.title}",
            block(part.command, "sh"),
            table([header[k] for k in used], [[line[k] for k in used] for line in lines]),
        ]
        parts.append(part.reasons)
    return whole("Both C-arms, side by side", *parts)


def _texts(cell: Cell | None) -> list[str]:
    if cell is None:
        return [""] * 5
    return [*("" if value is None else shown_value(value) for value in cell[:4]), cell.told]


def _observer(found: dict[str, Any]) -> Iterator[tuple[str, Mapping[str, Cell]]]:
    """Rows `machine, scan: method`, each with three places."""
    labels = dict.fromkeys(key.split(", ", 1)[1] for key in found["rows"])
    for label in labels:
        for place, unit in (("isocentre", "um"), ("focal_spot", "um"), ("orientation", "urad")):
            cells = {}
            for machine in MACHINES:
                row = found["rows"].get(f"{machine}, {label}")
                if row is not None:
                    alarms = row.get("false_alarms_in_ten_minutes")
                    cells[machine] = Cell(
                        row.get(f"{place}_true_{unit}"),
                        row.get(f"{place}_stated_{unit}"),
                        row.get(f"{place}_ratio"),
                        row.get("nis_per_measurement"),
                        "" if alarms is None else shown_value(alarms),
                    )
            yield f"{label}: {place.replace('_', ' ')} [{unit.replace('u', 'µ', 1)}]", cells


def _shaping(found: dict[str, Any]) -> Iterator[tuple[str, Mapping[str, Cell]]]:
    for label, row in found["rows"].items():
        yield (
            f"{label}: vibration left [%]",
            {
                machine: Cell(100.0 * each["left"], 100.0 * each["stated"] if "stated" in each else None, told=_acceleration(each))
                for machine, each in row.items()
            },
        )
        yield f"{label}: tracking error [mdeg]", {machine: Cell(each["tracking_mdeg"]) for machine, each in row.items()}


def _acceleration(row: Mapping[str, float]) -> str:
    scatter = f" ± {shown_value(row['scatter_m_s2'], 1e3)}" if row["scatter_m_s2"] else ""
    return f"{shown_value(row['vibration_m_s2'], 1e3)}{scatter}"


def _identification(found: dict[str, Any]) -> Iterator[tuple[str, Mapping[str, Cell]]]:
    for label, row in found["modes"].items():
        for what in ("frequency", "damping"):
            cells = {
                machine: Cell(
                    each.get(f"{what}_error_percent"),
                    each.get(f"{what}_stated_percent"),
                    each.get(f"{what}_ratio"),
                    told=f"{each['found']} of {each['of']}" + (f", {each[f'{what}_bias_percent']:+.2g} %" if each["found"] else ""),
                )
                for machine, each in row.items()
            }
            yield f"{label}, {what} [%]", cells
    for label, row in found["response"].items():
        yield (
            f"{label}: response [%]",
            {machine: Cell(each["error_percent"], each["stated_percent"], each["ratio"]) for machine, each in row.items()},
        )


KINDS = {"": ("repeatable", "real"), ", shaken, mount moved": ("not_repeatable", "real_not_repeatable")}


def _calibration(found: dict[str, Any]) -> Iterator[tuple[str, Mapping[str, Cell]]]:
    for kind, files in KINDS.items():
        machines = {machine: found[name] for machine, name in zip(MACHINES, files, strict=True) if name in found}
        labels = dict.fromkeys(label for each in machines.values() for label in each["rows"])
        for label in labels:
            rows = {machine: each["rows"][label] for machine, each in machines.items() if label in each["rows"]}
            for place, unit in (("source", "mm"), ("phantom", "mm"), ("rotation", "mrad")):
                cells = {machine: _place(machines[machine], label, row, f"{place}_{unit}") for machine, row in rows.items()}
                if any(cell.true is not None for cell in cells.values()):
                    yield f"{label}{kind}: {dict(source='focal spot', phantom='isocentre').get(place, place)} [{unit}]", cells
            yield from _use(f"{label}{kind}", rows)


def _place(found: dict[str, Any], label: str, row: dict[str, Any], key: str) -> Cell:
    true = row.get(key)
    run = label.removesuffix(", live")
    if true is None or run not in found["sigma"] or (run == label and f"{label}, live" in found["rows"]):
        return Cell(true)  # what is stated is that of the live estimate
    place = ("source_mm", "phantom_mm", "rotation_mrad").index(key)
    stated = 1e3 * sum(value**2 for value in found["sigma"][run][3 * place : 3 * place + 3]) ** 0.5
    images = found["images"][run]
    return Cell(true, stated, stated / true, told=f"{len(images['refused'])}, {len(images['changes'])}")


def _use(label: str, rows: Mapping[str, dict[str, Any]]) -> Iterator[tuple[str, Mapping[str, Cell]]]:
    """Overlay and reconstruction."""
    seen = {machine: row["overlay_mm"]["centre"]["mean"] for machine, row in rows.items() if "overlay_mm" in row}
    if seen:
        yield f"{label}: overlay, centre, mean [mm]", {machine: Cell(value) for machine, value in seen.items()}
    wires = {machine: row["wires"] for machine, row in rows.items() if "wires" in row}
    if wires:
        for what, unit in (("off", "mm"), ("peak", "1_m")):
            mean = {machine: sum(row[f"{what}_{axis}_{unit}"] for axis in "xyz") / 3.0 for machine, row in wires.items()}
            name = {"off": "reconstructed wires, off [mm]", "peak": "reconstructed wires, peak [1/m]"}[what]
            yield f"{label}: {name}", {machine: Cell(value) for machine, value in mean.items()}


PARTS = (
    Part(
        "observer_variances.json",
        "Observer",
        "python benchmarks/observer_variances.py --own-model --json benchmarks/results/observer_variances.json",
        "false alarms in ten minutes",
        _observer,
        "Why ratios and alarms are bad where they are: [results](results.md).",
    ),
    Part(
        "shaping.json",
        "Shapers",
        "python benchmarks/shaping.py --json benchmarks/results/shaping.json",
        "vibration, rms [mm/s²]",
        _shaping,
        "Vibration left is that of a run without shaper; *stated* is what the design says of a linear machine after a move. On `carm`, "
        "0.2 mm/s² is what the drives' steps of command shake at standstill, which shapers come near. On `carm-real` the propeller's move "
        "ends with nine times the vibration, as dry friction stops the drive behind the shaper: ZV leaves most of it, harmonic shapers a "
        "tenth. Roll, whose gear is stiff, hardly changes. What is stated does not count friction. A shaper without a row would take "
        "more than 90 % of a drive's limit. One run a row; sweeps and rasters are not kept here yet.",
    ),
    Part(
        "identification_resonances.json",
        "Identification",
        "python benchmarks/identification_resonances.py --out benchmarks/results/identification_resonances.json",
        "found, and mean error",
        _identification,
        "Stated bounds say what the same excitation finds again; without jog and friction they hold against the plant, too. On `carm-real` "
        "they do not. Dry friction damps like 4F/(aT) ([the jog](../explanation/experiments.md)): the gears' modes, 1 and 3, show it, "
        "those of detector and mount hardly. Constant speed with short turns leaves a quarter of the damping too much, of which most is "
        "the poses that the jog averages: it is there on `carm`, too. Play softens gears that bear no load: small motions, by which the "
        "plant is linearised, see a softer gear than the excitation. What is not there was not measured yet; the last jog has one seed.",
    ),
    Part(
        "calibration_side_by_side.json",
        "Calibration",
        "python benchmarks/calibration_side_by_side.py --work WORK --json benchmarks/results/calibration_side_by_side.json",
        "images refused, mount found moved",
        _calibration,
        "*Stated* is the median over the scan of what was known live; tables, models and final parameters state nothing of a sample. "
        "`carm-real`'s runs scatter by its effects alone, and its observer has the file's own numbers: the modes that multisines with the "
        "usual jog find there are not alike from pose to pose, so that an identified design is refused. One scan.",
    ),
)
