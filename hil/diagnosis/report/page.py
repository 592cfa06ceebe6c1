"""The report page: the verdict, what stands for and against it, and where it shows. One self-contained HTML file."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hil.diagnosis.answering.misfit import misfit_E
from hil.diagnosis.diagnose import Outcome, first_effects
from hil.diagnosis.report.effect_map import effect_map, effect_map_figure
from hil.diagnosis.report.heat_maps import heat_map_figures
from hil.diagnosis.report.matrix import matrix_figure
from hil.diagnosis.report.missing_effort import missing_effort_figure
from hil.diagnosis.report.overlay import overlay_figure
from hil.diagnosis.report.style import STAGE_NAMES
from hil.diagnosis.report.tables import (
    disturbance_shares,
    falling,
    findings,
    fit_table,
    hypotheses,
    image,
    retuned_table,
    table,
    whole_page,
)
from hil.diagnosis.report.waterfall import waterfall_figure
from hil.diagnosis.result import Diagnosis, Finding, Location
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN
from hil.machine.model import AxisUnits
from virtual_bus.effects.registry import effects

SECTIONS = ("waterfall", "overlay", "effect", "heat", "disturbance", "matrix")
DRAWN = ("nominal", "retuned", "extended")
ONLY_HELD_OUT = "<p>Of the held-out recordings beside the machine that is re-tuned to them alone: training shows nothing.</p>"


def write_report(outcome: Outcome, folder: Path) -> Path:
    """Write `report.html` into a folder that is there; returns its path."""
    path = folder / "report.html"
    path.write_text(_document(outcome), encoding="utf-8")
    return path


def report_figures(outcome: Outcome) -> dict[str, list[tuple[str, Figure]]]:
    """Every figure of the page with its caption, by section."""
    train = outcome.train
    judged = outcome.held_out if outcome.held_out is not None else train
    stages = outcome.stages[HELD_OUT if outcome.held_out is not None else TRAIN]
    on_train = outcome.stages[TRAIN]
    named = bool(outcome.diagnosis.findings)
    sections: dict[str, list[tuple[str, Figure | None]]] = {name: [] for name in SECTIONS}
    simulated = outcome.simulated
    partial = [stages[first_effects(count)] for count in range(1, len(simulated))]
    first = [misfit_E(judged, rows) if all(np.isfinite(each).all() for each in rows) else None for rows in partial]
    sections["waterfall"].append(("Waterfall of the mismatch above noise", waterfall_figure(outcome.diagnosis.fit, simulated, first)))
    title = "Held-out" if outcome.held_out is not None else "Training"
    drawn = {name: stages[name] for name in DRAWN if outcome.selection.chosen is not None or name != "extended"}
    sections["overlay"].append((f"{title} recording and simulations", overlay_figure(judged, drawn, title)))
    if named:
        for finding in outcome.diagnosis.findings:
            period_s = _period_s(finding)
            own = effect_map(train, on_train["without_effects"], on_train["extended"], finding.effect, outcome.values, period_s)
            sections["effect"].append((str(finding.effect), None if own is None else effect_map_figure(own)))
    residuals = {"held-out, re-tuned to it alone" if outcome.is_only_held_out else STAGE_NAMES["retuned"]: outcome.short}
    if named and simulated:
        residuals[STAGE_NAMES["extended"]] = train.with_simulated(on_train["extended"])
    for axis in range(len(train.axes)):
        for said, found in residuals.items():
            for number, figure in enumerate(heat_map_figures(found, axis, said)):
                part = f", part {number + 1}" if number else ""
                sections["heat"].append((f"Residual over the pose of {train.axes[axis]}, {said}{part}", figure))
    missing = missing_effort_figure(outcome.short, outcome.short_values, outcome.diagnosis.disturbance)
    sections["disturbance"].append(("Missing effort on the joints, re-tuned", missing))
    sections["matrix"].append(("Identifiability matrix", matrix_figure(*_sensitivities(outcome))))
    return {name: [(caption, figure) for caption, figure in pairs if figure is not None] for name, pairs in sections.items()}


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


def _document(outcome: Outcome) -> str:
    diagnosis = outcome.diagnosis
    machine = outcome.train.machine
    figures = {name: "\n".join(image(*pair) for pair in pairs) for name, pairs in report_figures(outcome).items()}
    absent = {
        "effect": "<p>No effect is named.</p>",
        "heat": "<p>No axis moves in these recordings, or no encoder says where it is.</p>",
        "waterfall": "<p>Nothing stands above noise.</p>",
        "matrix": "<p>Fewer than two numbers show in these recordings.</p>",
    }
    groups = outcome.train.groups
    values = {
        "machine": html.escape(machine.name),
        "description": html.escape(machine.description),
        "verdict": html.escape(diagnosis.verdict.replace("_", " ")),
        "reason": html.escape(diagnosis.reason),
        "recordings": html.escape("; ".join(", ".join(group.labels) for group in groups)),
        "held_out": html.escape("; ".join(", ".join(g.labels) for g in outcome.held_out.groups) if outcome.held_out else "none"),
        "noise": {"repeats": "from repeats", "periods": "from periods", "assumed": "assumed: no repeats were recorded"}[diagnosis.noise],
        "seconds": f"{diagnosis.seconds:.1f}",
        "unexplained": f"{diagnosis.unexplained_share:.1%}",
        "findings": "".join(f"<p>{html.escape(said)}.</p>" for said in diagnosis.suspicions) + findings(diagnosis, outcome.proposal),
        "hypotheses": hypotheses(diagnosis),
        "location": (ONLY_HELD_OUT if outcome.is_only_held_out else "")
        + _location(diagnosis, {units.axis: units for units in machine.units}),
        "disturbance": disturbance_shares(diagnosis),
        "fit": fit_table(diagnosis),
        "retuned": retuned_table(diagnosis),
        **{f"figure_{name}": text or absent.get(name, "") for name, text in figures.items()},
    }
    return whole_page("page.html", values)


def _location(diagnosis: Diagnosis, units: Mapping[str, AxisUnits]) -> str:
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
    return table(("dimension", "where", "share of the power above noise there"), rows)


def _held(location: Location, dimension: str, part: str = "all") -> str:
    share = location.shares.get(dimension, {}).get(part)
    return "" if share is None else f"{share:.0%}"


def _spans(spans: Sequence[tuple[float, float]], unit: str) -> str:
    shown = ", ".join(f"{low:.4g} to {high:.4g}" for low, high in spans[:8]) + (f" and {len(spans) - 8} more" if len(spans) > 8 else "")
    return f"{shown} {unit}".rstrip()
