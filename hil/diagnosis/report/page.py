"""The report page: the verdict, what stands for and against it, and where it shows. One self-contained HTML file."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hil.diagnosis.answering.misfit import misfit_E
from hil.diagnosis.diagnose import NEXT_EXPERIMENT, Outcome, first_effects
from hil.diagnosis.report.effect_map import effect_map, effect_map_charts
from hil.diagnosis.report.heat_maps import heat_map_figures
from hil.diagnosis.report.matrix import matrix_figure
from hil.diagnosis.report.missing_effort import missing_effort_charts
from hil.diagnosis.report.overlay import overlay_charts
from hil.diagnosis.report.style import STAGE_NAMES
from hil.diagnosis.report.tables import (
    disturbance_shares,
    falling,
    findings,
    fit_table,
    hypotheses,
    retuned_table,
    verdict,
)
from hil.diagnosis.report.waterfall import waterfall_figure
from hil.diagnosis.result import Diagnosis, Finding, Location
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN
from hil.machine.load import name_to_load
from hil.machine.model import AxisUnits
from hil.pages import Page, Section, Table, Text, write_page
from hil.pages.contents import Block
from hil.pages.picture import drawn as picture
from hil.reports.made_from import machine_fact
from virtual_bus.effects.registry import effects

SECTIONS = ("waterfall", "overlay", "effect", "heat", "disturbance", "matrix")
DRAWN = ("nominal", "retuned", "extended")
ONLY_HELD_OUT = "Of the held-out recordings beside the machine that is re-tuned to them alone: training shows nothing."
NOISE = {"repeats": "from repeats", "periods": "from periods", "assumed": "assumed: no repeats were recorded"}
ABSENT = {
    "effect": "No effect is named.",
    "heat": "No axis moves in these recordings, or no encoder says where it is.",
    "waterfall": "Nothing stands above noise.",
    "matrix": "Fewer than two numbers show in these recordings.",
}


def write_report(outcome: Outcome, folder: Path, is_emulated: bool = False) -> Path:
    """Write `report.html` into a folder that is there; returns its path."""
    return write_page(_page(outcome, folder, is_emulated), folder / "report.html")


def report_blocks(outcome: Outcome) -> dict[str, list[Block]]:
    """Every drawing of the page, by section."""
    train = outcome.train
    judged = outcome.held_out if outcome.held_out is not None else train
    stages = outcome.stages[HELD_OUT if outcome.held_out is not None else TRAIN]
    on_train = outcome.stages[TRAIN]
    named = bool(outcome.diagnosis.findings)
    sections: dict[str, list[Block]] = {name: [] for name in SECTIONS}
    simulated = outcome.simulated
    partial = [stages[first_effects(count)] for count in range(1, len(simulated))]
    first = [misfit_E(judged, rows) if all(np.isfinite(each).all() for each in rows) else None for rows in partial]
    if (waterfall := waterfall_figure(outcome.diagnosis.fit, simulated, first)) is not None:
        sections["waterfall"].append(picture(waterfall, "Waterfall of the mismatch above noise"))
    title = "Held-out" if outcome.held_out is not None else "Training"
    drawn = {name: stages[name] for name in DRAWN if outcome.selection.chosen is not None or name != "extended"}
    sections["overlay"].append(overlay_charts(judged, drawn, title))
    if named:
        for finding in outcome.diagnosis.findings:
            period_s = _period_s(finding)
            own = effect_map(train, on_train["without_effects"], on_train["extended"], finding.effect, outcome.values, period_s)
            if own is not None:
                sections["effect"].append(effect_map_charts(own))
    residuals = {"held-out, re-tuned to it alone" if outcome.is_only_held_out else STAGE_NAMES["retuned"]: outcome.short}
    if named and simulated:
        residuals[STAGE_NAMES["extended"]] = train.with_simulated(on_train["extended"])
    for axis in range(len(train.axes)):
        for said, found in residuals.items():
            for number, figure in enumerate(heat_map_figures(found, axis, said)):
                part = f", part {number + 1}" if number else ""
                sections["heat"].append(picture(figure, f"Residual over the pose of {train.axes[axis]}, {said}{part}"))
    missing = missing_effort_charts(outcome.short, outcome.short_values, outcome.diagnosis.disturbance)
    if missing is not None:
        sections["disturbance"].append(missing)
    if (matrix := matrix_figure(*_sensitivities(outcome))) is not None:
        sections["matrix"].append(picture(matrix, "Identifiability matrix"))
    return sections


def _period_s(finding: Finding) -> float | None:
    """Of what shakes the base; None of what the machine's own motion drives."""
    return 1.0 / finding.parameters["f"].value if finding.effect.effect == "base_motion" and finding.parameters["f"].value > 0.0 else None


def _sensitivities(outcome: Outcome) -> tuple[np.ndarray, list[str]]:
    """(M, P + F) columns of tuned numbers and effects' parameters, and their names."""
    columns, names = [outcome.tuning.jacobian], list(outcome.tuning.names)
    best = outcome.chosen
    if best is not None:
        columns.append(best.jacobian)
        names += [f"{best.effects[e]}: {effects()[best.effects[e].effect].parameters[k].name}" for e, k in best.free]
    return np.hstack(columns), names


def _page(outcome: Outcome, folder: Path, is_emulated: bool) -> Page:
    diagnosis, machine = outcome.diagnosis, outcome.train.machine
    drawn = {name: blocks or ([Text(ABSENT[name])] if name in ABSENT else []) for name, blocks in report_blocks(outcome).items()}
    units = {units.axis: units for units in machine.units}
    where: list[Block] = [Text(ONLY_HELD_OUT)] if outcome.is_only_held_out else []
    unexplained = f"Unexplained share of what stood above noise in the training recordings: {diagnosis.unexplained_share:.1%}."
    said = [Text(f"{suspicion}.") for suspicion in diagnosis.suspicions]
    command, reason = next_command(diagnosis, name_to_load(machine), folder)
    return Page(
        f"Diagnosis of {machine.name}",
        verdict(diagnosis),
        [
            Section("Findings", [*said, *findings(diagnosis, outcome.proposal)]),
            Section("Recorded and simulated", drawn["overlay"]),
            Section("Where the mismatch went", [Text(unexplained), *drawn["waterfall"], fit_table(diagnosis)]),
            Section("What the effects look like", drawn["effect"]),
            Section("What else was weighed", hypotheses(diagnosis), is_folded=True),
            Section("Where it is", [*where, _location(diagnosis, units), *drawn["heat"]], is_folded=True),
            Section("Which equation is short", [*disturbance_shares(diagnosis), *drawn["disturbance"]], is_folded=True),
            Section("Re-tuned numbers", [*retuned_table(diagnosis), *drawn["matrix"]], is_folded=True),
        ],
        command,
        reason,
        {
            "Machine": f"{machine_fact(machine)}, {machine.description}",
            "Recordings": "; ".join(", ".join(group.labels) for group in outcome.train.groups),
            "Held out": "; ".join(", ".join(g.labels) for g in outcome.held_out.groups) if outcome.held_out else "none",
            "Noise": NOISE[diagnosis.noise],
            "Computed in": f"{diagnosis.seconds:.1f} s",
        },
        is_emulated,
    )


def next_command(diagnosis: Diagnosis, machine: str, folder: Path) -> tuple[str, str]:
    """Return what to type after an answer, and what it brings; neither where the reason says what is missing.

    `machine` is the name or path by which it is loaded.
    """
    at, machine = shlex.quote(str(folder)), shlex.quote(machine)
    if any(finding.separating_experiment for finding in diagnosis.findings):
        return f"isocenter run file {at}/{NEXT_EXPERIMENT} -m {machine} -b BUS -o next.mf4", "is the experiment that separates them best."
    if diagnosis.verdict in ("explained", "ambiguous"):
        files = f"-m {at}/machine.toml --effects {at}/effects.toml"
        return f"isocenter plot RECORDING --simulate {files} -o explained.html", "shows the simulation with what was found."
    if diagnosis.verdict == "retuned":
        return f"isocenter plot RECORDING --simulate -m {at}/machine.toml -o retuned.html", "shows the simulation with the new numbers."
    if diagnosis.verdict == "misconfigured":
        return f"isocenter machine show {machine}", "shows what the recordings contradict."
    if diagnosis.verdict == "unknown_physics":
        return f"isocenter plot RECORDING --simulate -m {machine} -o left.html", "shows what is left, to zoom into."
    return "", ""


def _location(diagnosis: Diagnosis, units: Mapping[str, AxisUnits]) -> Table:
    location = diagnosis.location
    rows = [("channels", ", ".join(f"{name} {share:.0%}" for name, share in falling(location.channels)), "")]
    for name, spans in location.time_s.items():
        rows.append((f"time in {name}", _spans(spans, "s"), _held(location, "time_s")))
    if location.frequency_hz:
        rows.append(("frequency", _spans(location.frequency_hz, "Hz"), _held(location, "frequency_hz")))
    for quantity in ("position", "speed", "effort"):
        for axis, spans in getattr(location, quantity).items():
            own = units[axis]
            unit = {"position": own.position, "speed": f"{own.position}/s", "effort": own.effort}[quantity]
            rows.append((f"{quantity} of {axis}", _spans(spans, unit), _held(location, quantity, axis)))
    rows += [(f"direction of {axis}", way, _held(location, "direction", axis)) for axis, way in location.direction.items()]
    return Table(("dimension", "where", "share of the power above noise there"), rows, frozenset({2}))


def _held(location: Location, dimension: str, part: str = "all") -> str:
    share = location.shares.get(dimension, {}).get(part)
    return "" if share is None else f"{share:.0%}"


def _spans(spans: Sequence[tuple[float, float]], unit: str) -> str:
    shown = ", ".join(f"{low:.4g} to {high:.4g}" for low, high in spans[:8]) + (f" and {len(spans) - 8} more" if len(spans) > 8 else "")
    return f"{shown} {unit}".rstrip()
