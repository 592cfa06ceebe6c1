"""Figures and tables of the report page as HTML."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hil.diagnosis.report.style import STAGE_NAMES
from hil.diagnosis.result import STAGES, Diagnosis, Estimate, Stages
from hil.diagnosis.separating.next_experiment import Proposal

DPI = 100


def whole_page(body: str, values: Mapping[str, str]) -> str:
    """Return a page: the head that all pages share, and the body of this file, with its values."""
    here = Path(__file__).parent
    return Template("".join((here / name).read_text(encoding="utf-8") for name in ("head.html", body))).substitute(values)


def image(caption: str, figure: Figure) -> str:
    """Return a figure as a picture within the page."""
    buffer = io.BytesIO()
    figure.set_dpi(DPI)
    FigureCanvasAgg(figure).print_png(buffer)  # `savefig` would draw every figure twice
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="{html.escape(caption)}" src="data:image/png;base64,{data}">'


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table."""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "\n".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table>\n<tr>{head}</tr>\n{body}\n</table>"


def findings(diagnosis: Diagnosis, proposal: Proposal | None) -> str:
    """Return what was known and what was found, with its evidence."""
    parts = [f"<p>Known, and in every simulation: {html.escape(known(diagnosis))}.</p>"] if diagnosis.known else []
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
    return "\n".join(parts if diagnosis.findings else [*parts, "<p>No effect is named.</p>"])


def known(diagnosis: Diagnosis) -> str:
    """Return the effects that were given, with their numbers."""
    return "; ".join(
        f"{one.effect}: " + ", ".join(f"{name} = {value:.4g} {unit}".rstrip() for name, (value, unit) in one.parameters.items())
        for one in diagnosis.known
    )


def _estimate(estimate: Estimate) -> str:
    unit = f" {estimate.unit}" if estimate.unit else ""
    return f"{estimate.value:.4g}{unit} ({estimate.ci95[0]:.4g} to {estimate.ci95[1]:.4g})"


def hypotheses(diagnosis: Diagnosis) -> str:
    """Return the sets of effects that were weighed."""
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
    return said + table(header, rows) + lacking if rows else ""


def disturbance_shares(diagnosis: Diagnosis) -> str:
    """Which equation is short."""
    rows = [(f"effort on {name}", f"{share:.0%}") for name, share in falling(diagnosis.disturbance.joints)]
    rows += [(f"sensor of {name}", f"{share:.0%}") for name, share in falling(diagnosis.disturbance.sensors)]
    said = "<p>Of the re-tuned mismatch above noise: what an effort on one joint would reproduce by itself (joints move together, so these"
    said += " need not add up to 1), and what of a channel no efforts do. Readings of an IMU count where no encoder is recorded.</p>"
    return said + table(("equation", "share"), rows) if rows else "<p>Nothing is above noise for certain.</p>"


def falling(shares: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return names and shares, the largest first, without the smallest."""
    return sorted(((name, share) for name, share in shares.items() if share >= 0.005), key=lambda pair: -pair[1])


def fit_table(diagnosis: Diagnosis) -> str:
    """Return how far every stage is from the recordings."""
    fit = diagnosis.fit
    rows = [(name, *_percent(stages)) for name, stages in fit.channels.items()]
    rows.append(("E, training (units of noise)", *_numbers(fit.train)))
    if fit.held_out is not None:
        rows.append(("E, held-out (units of noise)", *_numbers(fit.held_out)))
    return table(("free-run NRMSE", *(STAGE_NAMES.get(stage, stage.replace("_", " ")) for stage in STAGES)), rows)


def _percent(stages: Stages) -> list[str]:
    return ["-" if (value := getattr(stages, stage)) is None else f"{100.0 * value:.3g} %" for stage in STAGES]


def _numbers(stages: Stages) -> list[str]:
    return ["-" if (value := getattr(stages, stage)) is None else f"{value:.3g}" for stage in STAGES]


def retuned_table(diagnosis: Diagnosis) -> str:
    """Return the numbers of the machine file."""
    rows = [
        (name, f"{v.nominal:.5g}", f"{v.value:.5g}", f"{v.ci95[0]:.5g} to {v.ci95[1]:.5g}", v.unit) for name, v in diagnosis.retuned.items()
    ]
    shown = (
        table(("number", "machine file", "re-tuned", "95 % interval", "unit"), rows) if rows else "<p>None shows in these recordings.</p>"
    )
    frozen = "".join(f"<li>{html.escape(name)}: {html.escape(reason)}</li>" for name, reason in diagnosis.frozen.items())
    return shown + (f"<p>Not shown or not decided by these recordings:</p><ul>{frozen}</ul>" if frozen else "")
