"""The report page of a diagnosis along the recorded motion. One self-contained HTML file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hil.diagnosis.answered.answer import Answered
from hil.diagnosis.report.page import NOISE, next_command
from hil.diagnosis.report.style import STAGE_NAMES
from hil.diagnosis.report.tables import disturbance_shares, findings, fit_table, hypotheses, retuned_table, verdict
from hil.diagnosis.result import DetectionLimit
from hil.diagnosis.seen.see import Missing
from hil.machine.load import name_to_load
from hil.pages import Chart, Charts, Page, Scale, Section, Series, Table, Text, write_page
from hil.pages.contents import Block
from hil.reports.made_from import machine_fact

MOST_POINTS = 4000
"""Of a chart, a joint."""
SCATTER_PX = 300
MISSING = (
    "Black: the effort that the drive gave, less what the recorded motion takes by the machine file. Red: what the re-tuned numbers and"
    " the named effects say of it. The answer leaves {share:.1%} of what re-tuned numbers leave, by power."
)


def write_motion_report(answered: Answered, folder: Path, is_emulated: bool = False) -> Path:
    """Write `report.html` into a folder that is there; returns its path."""
    return write_page(_page(answered, folder, is_emulated), folder / "report.html")


def _page(answered: Answered, folder: Path, is_emulated: bool) -> Page:
    diagnosis, machine = answered.diagnosis, answered.machine
    horizon = diagnosis.fit.horizon_s
    runs = "over whole recordings" if horizon is None else f"of {horizon:g} s, begun again and again from the recorded state"
    if not diagnosis.fit.channels:
        runs = "stay near the recordings over no horizon"
    command, reason = next_command(diagnosis, name_to_load(machine), folder)
    missing: list[Block] = [Text(MISSING.format(share=diagnosis.unexplained_share)), *missing_charts(answered)]
    return Page(
        f"Diagnosis of {machine.name}",
        verdict(diagnosis),
        [
            Section("Findings", findings(diagnosis, None)),
            Section("What is missing, and what was named of it", [*missing, *disturbance_shares(diagnosis)]),
            Section("How well it predicts", [Text(f"Free runs driven by the recorded efforts, {runs}."), fit_table(diagnosis)]),
            Section("What else was weighed", hypotheses(diagnosis), is_folded=True),
            Section("Controllers", [_audit(answered)], is_folded=True),
            Section("Numbers of the machine file", retuned_table(diagnosis), is_folded=True),
            Section("What these recordings could not show", _limits(diagnosis.detection_limits), is_folded=True),
        ],
        command,
        reason,
        {
            "Machine": f"{machine_fact(machine)}, {machine.description}",
            "Recordings": ", ".join(answered.recordings),
            "Noise": NOISE[diagnosis.noise],
            "Computed in": f"{diagnosis.seconds:.1f} s",
        },
        is_emulated,
    )


def _audit(answered: Answered) -> Block:
    axes = answered.diagnosis.audit.get("axes", {})
    rows = []
    for name, axis in axes.items():
        gain = axis["gain"]["value"]
        rows.append((name, axis["status"].replace("_", " "), "-" if gain is None else f"{gain:.4g}", f"{axis['replayed_rms']:.2g}"))
    if not rows:
        return Text("No recording has the reference, position and command of an axis at the machine's sample rate.")
    return Table(("axis", "controller", "gain over the file's", "rms that its law leaves"), rows, frozenset((2, 3)))


def _limits(limits: tuple[DetectionLimit, ...]) -> list[Block]:
    rows = [
        (str(limit.effect), limit.parameter, "-" if limit.strength is None else f"{limit.strength:.3g} {limit.unit}".rstrip())
        for limit in limits
    ]
    if not rows:
        return [Text("None was computed.")]
    header = ("effect", "parameter", "least that would have shown")
    return [Text("An effect that is weaker than this would not have been named."), Table(header, rows, frozenset({2}))]


def missing_charts(answered: Answered) -> list[Charts]:
    """Return charts for every driven joint: what the machine file's equations lack over speed and position, and what was named of it."""
    if answered.named is None:
        return []
    seen = answered.named.seen
    missing, said = seen.missing(), seen.said_by(answered.values, answered.effects)
    named = {(each.recording, each.joint): effort for each, effort in zip(missing, said, strict=True)}
    joints: dict[str, list[Missing]] = {}
    for each in missing:
        joints.setdefault(each.joint, []).append(each)
    slides = {joint.name: joint.kind == "prismatic" for joint in answered.machine.plant.tree.joints}
    return [_of_joint(joint, parts, named if answered.effects else {}, slides[joint]) for joint, parts in joints.items()]


def _of_joint(joint: str, parts: list[Missing], named: dict[tuple[str, str], np.ndarray], slides: bool) -> Charts:
    length, effort = ("m", "N") if slides else ("rad", "Nm")
    every = max(1, sum(len(part.time) for part in parts) // MOST_POINTS)
    lacked = np.concatenate([part.missing[::every] for part in parts])
    middle = float(np.median(lacked))
    reach = 1.5 * float(np.quantile(np.abs(lacked - middle), 0.99))
    scale = Scale(f"effort on {joint} [{effort}]", ends=(middle - reach, middle + reach) if reach > 0.0 else None)
    charts = []
    for quantity, unit in (("speed", f"{length}/s"), ("position", length)):
        x = np.concatenate([getattr(part, quantity)[::every] for part in parts])
        series = [Series("given less taken by the machine file", x, lacked, is_points=True, look=0)]
        if named:
            fitted = np.concatenate([named[part.recording, joint][::every] for part in parts])
            series.append(Series(f"{STAGE_NAMES['extended']}: what the answer says of it", x, fitted, is_points=True, look=1))
        title = f"Missing effort on {joint} over its {quantity}"
        charts.append(Chart(title, Scale(f"{quantity} of {joint} [{unit}]"), scale, series, height=SCATTER_PX))
    return Charts(charts, columns=2)
