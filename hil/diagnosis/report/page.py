"""The report page: the verdict, what stands for and against it, and where it shows. One self-contained HTML file."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hil.diagnosis.report.matrix import matrix_figure
from hil.diagnosis.report.style import STAGE_NAMES
from hil.diagnosis.report.tables import disturbance_shares, falling, findings, fit_table, hypotheses, retuned_table, verdict
from hil.diagnosis.report.waterfall import waterfall_figure
from hil.diagnosis.residuals.residuals import Missing
from hil.diagnosis.result import DetectionLimit, Diagnosis, Location
from hil.diagnosis.verdict.answer import NEXT_EXPERIMENT
from hil.diagnosis.verdict.values import Outcome
from hil.machine.load import name_to_load
from hil.machine.machine import AxisUnits
from hil.pages import Chart, Charts, Page, Scale, Section, Series, Table, Text, write_page
from hil.pages.chart import means_along
from hil.pages.contents import Block
from hil.pages.picture import drawn as picture
from hil.reports.made_from import machine_fact

MOST_POINTS = 4000
"""Of a chart, a joint."""
SCATTER_PX = 300
NOISE = {"repeats": "from repeats", "periods": "from periods", "assumed": "assumed: no repeats were recorded"}
MISSING = (
    "Black: the effort that the drive gave, less what the recorded motion takes by the machine file; blue: their mean. Orange: what the"
    " re-tuned numbers and the named effects say of it. The answer leaves {share:.1%} of what re-tuned numbers leave, by power."
)


def write_report(outcome: Outcome, folder: Path, is_emulated: bool = False) -> Path:
    """Write `report.html` into a folder that is there; returns its path."""
    return write_page(_page(outcome, folder, is_emulated), folder / "report.html")


def _page(outcome: Outcome, folder: Path, is_emulated: bool) -> Page:
    diagnosis, machine = outcome.diagnosis, outcome.machine
    command, reason = next_command(diagnosis, name_to_load(machine), folder)
    units = {units.axis: units for units in machine.units}
    is_searched = outcome.residuals is not None
    sections = [Section("Findings", findings(diagnosis, outcome.proposal))]
    if is_searched:
        sections += _what_it_leaves(outcome)
    if diagnosis.location.channels:
        sections.append(Section("Where it is", [_location(diagnosis, units)], is_folded=True))
    if is_searched:
        sections.append(Section("What else was weighed", hypotheses(diagnosis), is_folded=True))
    if not diagnosis.audit.get("recordings"):  # else controllers were not audited
        sections.append(Section("Controllers", [_audit(outcome)], is_folded=True))
    if is_searched:
        sections += _what_it_shows(outcome)
    return Page(
        f"Diagnosis of {machine.name}",
        verdict(diagnosis),
        sections,
        command,
        reason,
        {
            "Machine": f"{machine_fact(machine)}, {machine.description}",
            "Recordings": ", ".join(outcome.recordings),
            **({"Noise": NOISE[diagnosis.noise]} if is_searched else {}),
            "Computed in": f"{diagnosis.seconds:.1f} s",
        },
        is_emulated,
    )


def _what_it_leaves(outcome: Outcome) -> list[Section]:
    """Return what the machine file's equations lack, and how well what was named of it predicts."""
    diagnosis = outcome.diagnosis
    waterfall = waterfall_figure(diagnosis.fit, [finding.effect for finding in diagnosis.findings if finding.kind == "effect"])
    fell: list[Block] = [] if waterfall is None else [picture(waterfall, "Waterfall of the mismatch above noise")]
    missing: list[Block] = [Text(MISSING.format(share=diagnosis.unexplained_share)), *missing_charts(outcome)]
    return [
        Section("What is missing, and what was named of it", [*missing, *disturbance_shares(diagnosis)]),
        Section("How well it predicts", [Text(_how_predicted(diagnosis)), *fell, fit_table(diagnosis)]),
    ]


def _what_it_shows(outcome: Outcome) -> list[Section]:
    """Return the numbers that a search fitted, and what it could not have shown."""
    numbers: list[Block] = [*retuned_table(outcome.diagnosis), *_matrix(outcome)]
    return [
        Section("Numbers of the machine file", numbers, is_folded=True),
        Section("What these recordings could not show", _limits(outcome.diagnosis.detection_limits), is_folded=True),
    ]


def _how_predicted(diagnosis: Diagnosis) -> str:
    """Return in words by what the answer was judged."""
    horizon = diagnosis.fit.horizon_s
    if diagnosis.fit.errors_of == "rows":
        return "Every row predicted from those before it, in units of the noise that repeats show: 1 is noise alone."
    if not diagnosis.fit.channels:
        return "Free runs driven by the recorded efforts stay near the recordings over no horizon."
    if diagnosis.fit.errors_of == "closed_loop":
        return "Free runs of the closed loop over whole recordings: their rms errors as shares of each channel's rms about its mean."
    runs = "over whole recordings" if horizon is None else f"of {horizon:g} s, begun again and again from the recorded state"
    return f"Free runs driven by the recorded efforts, {runs}: their rms errors as shares of each channel's rms about its mean."


def _audit(outcome: Outcome) -> Block:
    axes = outcome.diagnosis.audit.get("axes", {})
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


def missing_charts(outcome: Outcome) -> list[Charts]:
    """Return charts for every driven joint: what the machine file's equations lack over speed and position, and what was named of it."""
    joints, explained = _missing_and_explained(outcome)
    return [_of_joint(outcome, joint, parts, explained) for joint, parts in joints.items()]


def telling_charts(outcome: Outcome) -> list[Charts]:
    """Return the charts of `missing_charts` for the joint of which the answer says most, by power; none where it says nothing of any."""
    joints, explained = _missing_and_explained(outcome)

    def said(joint: str) -> float:
        pairs = [(part.missing, explained[part.recording, joint]) for part in joints[joint]]
        return sum(float(np.sum(missing**2) - np.sum((missing - effort) ** 2)) for missing, effort in pairs)

    told = max(joints, key=said, default="") if explained else ""
    return [_of_joint(outcome, told, joints[told], explained)] if told and said(told) > 0.0 else []


def _missing_and_explained(outcome: Outcome) -> tuple[dict[str, list[Missing]], dict[tuple[str, str], np.ndarray]]:
    """Return what the machine file's equations lack, by joint, and what was named of it, by recording and joint."""
    joints: dict[str, list[Missing]] = {}
    if outcome.residuals is None:
        return joints, {}
    missing = outcome.residuals.missing()
    for each in missing:
        joints.setdefault(each.joint, []).append(each)
    if not outcome.effects:
        return joints, {}
    said = outcome.residuals.said_by(outcome.values, outcome.effects)
    return joints, {(each.recording, each.joint): effort for each, effort in zip(missing, said, strict=True)}


def _of_joint(outcome: Outcome, joint: str, parts: list[Missing], explained: dict[tuple[str, str], np.ndarray]) -> Charts:
    slides = any(each.name == joint and each.kind == "prismatic" for each in outcome.machine.plant.tree.joints)
    length, effort, scaled = ("m", "N", 1.0) if slides else ("deg", "Nm", 180.0 / np.pi)
    every = max(1, sum(len(part.time) for part in parts) // MOST_POINTS)
    lacked = np.concatenate([part.missing[::every] for part in parts])
    middle = float(np.median(lacked))
    reach = 1.5 * float(np.quantile(np.abs(lacked - middle), 0.99))
    scale = Scale(f"effort on {joint} [{effort}]", ends=(middle - reach, middle + reach) if reach > 0.0 else None)
    charts = []
    for quantity, unit in (("speed", f"{length}/s"), ("position", length)):
        x = scaled * np.concatenate([getattr(part, quantity)[::every] for part in parts])
        series = [Series("given less taken by the machine file", x, lacked, is_points=True, look=0)]
        if explained:
            fitted = np.concatenate([explained[part.recording, joint][::every] for part in parts])
            series.append(Series(f"{STAGE_NAMES['extended']}: what the answer says of it", x, fitted, is_points=True, look=1))
        series.append(Series("mean of the points", *means_along(x, lacked), look=6))
        along = Scale(f"{quantity} of {joint} [{unit}]")
        charts.append(Chart(f"Missing effort on {joint} over its {quantity}", along, scale, series, height=SCATTER_PX))
    return Charts(charts, columns=2)


def _matrix(outcome: Outcome) -> list[Block]:
    """Return how alike the numbers' and parameters' columns are behind the filter."""
    if outcome.columns is None or not len(outcome.columns[0]):
        return []
    figure = matrix_figure(*outcome.columns)
    return [] if figure is None else [picture(figure, "Identifiability matrix")]


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
