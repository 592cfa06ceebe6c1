"""The report page: the verdict, what stands for and against it, and where it shows. One self-contained HTML file."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hil.diagnosis.answering.misfit import misfit_E
from hil.diagnosis.diagnose import Outcome, first_effects
from hil.diagnosis.report.effect_map import effect_map, effect_map_figure
from hil.diagnosis.report.heat_maps import heat_map_figures
from hil.diagnosis.report.matrix import matrix_figure
from hil.diagnosis.report.missing_effort import missing_effort_figure
from hil.diagnosis.report.overlay import overlay_figure
from hil.diagnosis.report.style import STAGE_NAMES
from hil.diagnosis.report.waterfall import waterfall_figure
from hil.diagnosis.result import STAGES, Diagnosis, Estimate, Finding, Location, Stages
from hil.diagnosis.separating.next_experiment import Proposal
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN
from hil.machine.model import AxisUnits
from virtual_bus.effects.registry import effects

_TEMPLATE = Path(__file__).with_name("page.html")
SECTIONS = ("waterfall", "overlay", "effect", "heat", "disturbance", "matrix")
DRAWN = ("nominal", "retuned", "extended")
DPI = 100
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
    figures = {name: "\n".join(_image(*pair) for pair in pairs) for name, pairs in report_figures(outcome).items()}
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
        "findings": "".join(f"<p>{html.escape(said)}.</p>" for said in diagnosis.suspicions) + _findings(diagnosis, outcome.proposal),
        "hypotheses": _hypotheses(diagnosis),
        "location": (ONLY_HELD_OUT if outcome.is_only_held_out else "")
        + _location(diagnosis, {units.axis: units for units in machine.units}),
        "disturbance": _disturbance(diagnosis),
        "fit": _fit(diagnosis),
        "retuned": _retuned(diagnosis),
        **{f"figure_{name}": text or absent.get(name, "") for name, text in figures.items()},
    }
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(values)


def _image(caption: str, figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.set_dpi(DPI)
    FigureCanvasAgg(figure).print_png(buffer)  # `savefig` would draw every figure twice
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="{html.escape(caption)}" src="data:image/png;base64,{data}">'


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "\n".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table>\n<tr>{head}</tr>\n{body}\n</table>"


def _findings(diagnosis: Diagnosis, proposal: Proposal | None) -> str:
    parts = []
    for finding in diagnosis.findings:
        numbers = ", ".join(f"{name} = {_estimate(estimate)}" for name, estimate in finding.parameters.items())
        lines = [f"<h3>{html.escape(str(finding.effect))}, confidence {finding.confidence:.2f}</h3>", f"<p>{html.escape(numbers)}</p>"]
        for heading, evidence in (("For", finding.evidence_for), ("Against", finding.evidence_against)):
            if evidence:
                lines.append(f"<p>{heading}:</p><ul>" + "".join(f"<li>{html.escape(text)}</li>" for text in evidence) + "</ul>")
        if finding.ambiguous_sets:
            others = "; ".join(" and ".join(map(str, one)) for one in finding.ambiguous_sets)
            lines.append(f"<p>In its place, or with more beside it, these recordings allow: {html.escape(others)}.</p>")
        if finding.separating_experiment and proposal is not None:
            lines.append(f"<p>The next experiment: {html.escape(proposal.said(finding.separating_experiment))}.</p>")
        parts.append("\n".join(lines))
    return "\n".join(parts) or "<p>No effect is named.</p>"


def _estimate(estimate: Estimate) -> str:
    unit = f" {estimate.unit}" if estimate.unit else ""
    return f"{estimate.value:.4g}{unit} ({estimate.ci95[0]:.4g} to {estimate.ci95[1]:.4g})"


def _hypotheses(diagnosis: Diagnosis) -> str:
    rows = [
        (
            " and ".join(str(e) for e in h.effects) or "no effect",
            f"{h.confidence:.3f}",
            f"{h.gained:.4g}",
            "-" if h.gained_held_out is None else f"{h.gained_held_out:.4g}",
            str(h.parameters),
            ("yes" if h.is_confirmed else "no") if h.parameters else "-",
        )
        for h in diagnosis.hypotheses
    ]
    said = "<p>For a set: by how much it lowers the sum of squares in units of noise, in training and held out. Against it: how many"
    said += " parameters it takes for that, and where chance may gain as much (not confirmed).</p>"
    lacking = "<p>What these confidences lack of 1 is for physics that none of them holds.</p>"
    header = ("hypothesis", "confidence", "lowers training by", "lowers held-out by", "parameters", "confirmed")
    return said + _table(header, rows) + lacking if rows else ""


def _location(diagnosis: Diagnosis, units: Mapping[str, AxisUnits]) -> str:
    location = diagnosis.location
    rows = [("channels", ", ".join(f"{name} {share:.0%}" for name, share in _falling(location.channels)), "")]
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
    return _table(("dimension", "where", "share of the power above noise there"), rows)


def _held(location: Location, dimension: str, part: str = "all") -> str:
    share = location.shares.get(dimension, {}).get(part)
    return "" if share is None else f"{share:.0%}"


def _disturbance(diagnosis: Diagnosis) -> str:
    """Which equation is short."""
    rows = [(f"effort on {name}", f"{share:.0%}") for name, share in _falling(diagnosis.disturbance.joints)]
    rows += [(f"sensor of {name}", f"{share:.0%}") for name, share in _falling(diagnosis.disturbance.sensors)]
    said = "<p>Of the re-tuned mismatch above noise: what an effort on one joint would reproduce by itself (joints move together, so these"
    said += " need not add up to 1), and what of a channel no efforts do. Readings of an IMU count where no encoder is recorded.</p>"
    return said + _table(("equation", "share"), rows) if rows else "<p>Nothing is above noise for certain.</p>"


def _falling(shares) -> list[tuple[str, float]]:  # type: ignore[no-untyped-def]
    return sorted(((name, share) for name, share in shares.items() if share >= 0.005), key=lambda pair: -pair[1])


def _spans(spans: Sequence[tuple[float, float]], unit: str) -> str:
    shown = ", ".join(f"{low:.4g} to {high:.4g}" for low, high in spans[:8]) + (f" and {len(spans) - 8} more" if len(spans) > 8 else "")
    return f"{shown} {unit}".rstrip()


def _fit(diagnosis: Diagnosis) -> str:
    fit = diagnosis.fit
    rows = [(name, *_percent(stages)) for name, stages in fit.channels.items()]
    rows.append(("E, training (units of noise)", *_numbers(fit.train)))
    if fit.held_out is not None:
        rows.append(("E, held-out (units of noise)", *_numbers(fit.held_out)))
    return _table(("free-run NRMSE", *(STAGE_NAMES.get(stage, stage.replace("_", " ")) for stage in STAGES)), rows)


def _percent(stages: Stages) -> list[str]:
    return ["-" if (value := getattr(stages, stage)) is None else f"{100.0 * value:.3g} %" for stage in STAGES]


def _numbers(stages: Stages) -> list[str]:
    return ["-" if (value := getattr(stages, stage)) is None else f"{value:.3g}" for stage in STAGES]


def _retuned(diagnosis: Diagnosis) -> str:
    rows = [
        (name, f"{v.nominal:.5g}", f"{v.value:.5g}", f"{v.ci95[0]:.5g} to {v.ci95[1]:.5g}", v.unit) for name, v in diagnosis.retuned.items()
    ]
    table = (
        _table(("number", "machine file", "re-tuned", "95 % interval", "unit"), rows) if rows else "<p>None shows in these recordings.</p>"
    )
    frozen = "".join(f"<li>{html.escape(name)}: {html.escape(reason)}</li>" for name, reason in diagnosis.frozen.items())
    return table + (f"<p>Not shown or not decided by these recordings:</p><ul>{frozen}</ul>" if frozen else "")
