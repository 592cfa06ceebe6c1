"""The report page of a diagnosis along the recorded motion. One self-contained HTML file."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hil.diagnosis.answered.answer import Answered
from hil.diagnosis.report.style import BLUE, STAGE_NAMES
from hil.diagnosis.report.tables import disturbance_shares, findings, fit_table, hypotheses, image, retuned_table, table, whole_page
from hil.diagnosis.result import DetectionLimit
from hil.diagnosis.seen.see import Missing

MOST_POINTS = 4000
"""Of a figure, a joint."""
GREY = "0.6"
HEADINGS = {"assumed": "assumed: no repeats were recorded", "repeats": "from repeats", "periods": "from periods"}


def write_motion_report(answered: Answered, folder: Path) -> Path:
    """Write `report.html` into a folder that is there; returns its path."""
    path = folder / "report.html"
    path.write_text(_document(answered), encoding="utf-8")
    return path


def _document(answered: Answered) -> str:
    diagnosis, machine = answered.diagnosis, answered.machine
    horizon = diagnosis.fit.horizon_s
    runs = "over whole recordings" if horizon is None else f"of {horizon:g} s, begun again and again from the recorded state"
    if not diagnosis.fit.channels:
        runs = "stay near the recordings over no horizon"
    values = {
        "machine": html.escape(machine.name),
        "description": html.escape(machine.description),
        "verdict": html.escape(diagnosis.verdict.replace("_", " ")),
        "reason": html.escape(diagnosis.reason),
        "recordings": html.escape(", ".join(answered.recordings)),
        "noise": HEADINGS[diagnosis.noise],
        "seconds": f"{diagnosis.seconds:.1f}",
        "unexplained": f"{diagnosis.unexplained_share:.1%}",
        "findings": findings(diagnosis, None),
        "hypotheses": hypotheses(diagnosis),
        "audit": _audit(answered),
        "runs": runs,
        "fit": fit_table(diagnosis),
        "disturbance": disturbance_shares(diagnosis),
        "efforts": "\n".join(image(f"Missing effort on {figure[0]}", figure[1]) for figure in missing_figures(answered)),
        "retuned": retuned_table(diagnosis),
        "limits": _limits(diagnosis.detection_limits),
    }
    return whole_page("motion_page.html", values)


def _audit(answered: Answered) -> str:
    axes = answered.diagnosis.audit.get("axes", {})
    rows = []
    for name, axis in axes.items():
        gain = axis["gain"]["value"]
        rows.append((name, axis["status"].replace("_", " "), "-" if gain is None else f"{gain:.4g}", f"{axis['replayed_rms']:.2g}"))
    if not rows:
        return "<p>No recording has the reference, position and command of an axis at the machine's sample rate.</p>"
    return table(("axis", "controller", "gain over the file's", "rms that its law leaves"), rows)


def _limits(limits: tuple[DetectionLimit, ...]) -> str:
    rows = [
        (str(limit.effect), limit.parameter, "-" if limit.strength is None else f"{limit.strength:.3g} {limit.unit}".rstrip())
        for limit in limits
    ]
    return table(("effect", "parameter", "least that would have shown"), rows) if rows else "<p>None was computed.</p>"


def missing_figures(answered: Answered) -> list[tuple[str, Figure]]:
    """Return a figure for every driven joint: what the machine file's equations lack over speed and position, and what was named of it."""
    if answered.named is None:
        return []
    seen = answered.named.seen
    missing, said = seen.missing(), seen.said_by(answered.values, answered.effects)
    named = {(each.recording, each.joint): effort for each, effort in zip(missing, said, strict=True)}
    joints: dict[str, list[Missing]] = {}
    for each in missing:
        joints.setdefault(each.joint, []).append(each)
    slides = {joint.name: joint.kind == "prismatic" for joint in answered.machine.plant.tree.joints}
    figures = []
    for joint, parts in joints.items():
        length, effort = ("m", "N") if slides[joint] else ("rad", "Nm")
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        every = max(1, sum(len(part.time) for part in parts) // MOST_POINTS)
        for part in parts:
            blue = named[part.recording, part.joint]
            for place, x in zip(axes, (part.speed, part.position), strict=True):
                place.plot(x[::every], part.missing[::every], ".", ms=2, color=GREY, rasterized=True)
                if answered.effects:
                    place.plot(x[::every], blue[::every], ".", ms=2, color=BLUE, rasterized=True)
        axes[0].set_xlabel(f"speed of {joint} [{length}/s]")
        axes[1].set_xlabel(f"position of {joint} [{length}]")
        axes[0].set_ylabel(f"effort [{effort}]")
        middle = np.median(np.concatenate([part.missing for part in parts]))
        reach = 1.5 * np.quantile(np.abs(np.concatenate([part.missing for part in parts]) - middle), 0.99)
        if reach > 0.0:
            axes[0].set_ylim(middle - reach, middle + reach)
        axes[0].plot([], [], "o", ms=4, color=GREY, label="given less taken by the machine file")
        if answered.effects:
            axes[0].plot([], [], "o", ms=4, color=BLUE, label=f"{STAGE_NAMES['extended']}: what the answer says of it")
        figure.legend(loc="outside upper left", ncols=2, frameon=False, fontsize="small")
        figures.append((joint, figure))
    return figures
