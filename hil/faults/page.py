"""The page of the table of faults: one self-contained HTML file, and the same as data."""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from string import Template

from hil.bench.wiring import REST_AT_MOST_S
from hil.faults.check import TrialOutcome
from hil.faults.motion import MOTIONS, Motion
from hil.machine import Machine
from hil.version import software_version
from virtual_bus.faults.registry import fault_kinds

_TEMPLATE = Path(__file__).with_name("page.html")
PAGE, DATA = "faults.html", "faults.json"
BAD = ("not at rest", "did not end")
DOUBTFUL = ("unnoticed", "never began")
_HEAD = ("fault", "at", "during", "verdict", "rest [s]", "travel [{unit}]", "budget", "at the end", "rows", "said")


def document_of(machine: Machine, axis: str, outcomes: Sequence[TrialOutcome], motion: Motion) -> dict[str, object]:
    """Return the table as data."""
    return {
        "machine": machine.name,
        "hash": machine.hash,
        "software": software_version(),
        "axis": axis,
        "motion": motion.name,
        "speed": motion.speed,
        "unit": machine.units[machine.axis_index(axis)].position,
        "rows": motion.rows,
        "verdicts": Counter(outcome.verdict for outcome in outcomes),
        "processor_s": sum(outcome.processor_s for outcome in outcomes),
        "faults": outcomes,
    }


def write_page(machine: Machine, axis: str, outcomes: Sequence[TrialOutcome], folder: Path, motion: Motion) -> Path:
    """Write the page into a folder and return its path."""
    path = folder / PAGE
    path.write_text(page_of(machine, axis, outcomes, motion), encoding="utf-8")
    return path


def page_of(machine: Machine, axis: str, outcomes: Sequence[TrialOutcome], motion: Motion) -> str:
    """Return the page's text, the classes of faults in their own order and the worst of each first."""
    unit = machine.units[machine.axis_index(axis)].position
    groups = list(dict.fromkeys(outcome.group for outcome in outcomes))
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        machine=html.escape(machine.name),
        description=html.escape(machine.description),
        motion=html.escape(MOTIONS[motion.name].format(axis=axis, speed=motion.speed, unit=unit)),
        count=len(outcomes),
        seconds=f"{sum(outcome.processor_s for outcome in outcomes):.0f}",
        software=html.escape(software_version()),
        hash=machine.hash[:12],
        summary=html.escape(summary_of(outcomes)),
        watch=f"{REST_AT_MOST_S:g}",
        sections="\n".join(_section(group, [outcome for outcome in outcomes if outcome.group == group], unit) for group in groups),
    )


def summary_of(outcomes: Sequence[TrialOutcome]) -> str:
    """Return how many faults ended how, in a line."""
    counts = Counter(outcome.verdict for outcome in outcomes)
    faults = "1 fault" if len(outcomes) == 1 else f"{len(outcomes)} faults"
    over, false = sum(is_over_budget(outcome) for outcome in outcomes), sum(bool(outcome.contradicted) for outcome in outcomes)
    more = f"; {over} over their budget, {false} said what the truth contradicts"
    return f"{faults}: " + ", ".join(f"{number} {verdict}" for verdict, number in counts.most_common()) + more


def is_over_budget(outcome: TrialOutcome) -> bool:
    """Return whether a stop took more than the machine file allows."""
    return outcome.budget is not None and not outcome.budget.kept


def is_failure(outcome: TrialOutcome) -> bool:
    """Return whether an outcome is one that a machine must not have: moving, unnoticed, over its budget, or told wrongly."""
    return outcome.verdict in BAD + DOUBTFUL or is_over_budget(outcome) or bool(outcome.contradicted)


def _section(group: str, outcomes: Sequence[TrialOutcome], unit: str) -> str:
    head = "".join(f"<th>{cell.format(unit=unit)}</th>" for cell in _HEAD)
    ranked = sorted(outcomes, key=lambda outcome: 0 if outcome.verdict in BAD else 1 if is_failure(outcome) else 2)
    rows = "\n".join(_row(outcome) for outcome in ranked)
    return f"<h2>{html.escape(group[0].upper() + group[1:])}</h2>\n<table>\n<tr>{head}</tr>\n{rows}\n</table>"


def _row(outcome: TrialOutcome) -> str:
    look = "bad" if outcome.verdict in BAD else "doubtful" if is_failure(outcome) else "good"
    told = [f"NOT TRUE: {claim}" for claim in outcome.contradicted] + [f"stopping: {trouble}" for trouble in outcome.stopping]
    details = outcome.name.split("/")[3:]
    does = fault_kinds()[outcome.kind].does
    said = "<br>".join(html.escape(text) for text in (outcome.said, *told) if text)
    cells = (
        f"<td>{html.escape(outcome.kind)} {html.escape(' '.join(details))}<br><small>{html.escape(does)}</small></td>",
        f"<td>{html.escape(outcome.at)}</td>",
        f"<td>{html.escape(outcome.during)}</td>",
        f"<td>{html.escape(outcome.verdict)}<br><small>exit status {outcome.exit_status}</small></td>",
        f'<td class="number">{_number(outcome.rest_s, 2)}</td>',
        f'<td class="number">{_number(outcome.travel, 3)}</td>',
        f"<td>{html.escape(_budget(outcome))}</td>",
        f"<td>{html.escape(outcome.ending)}</td>",
        f'<td class="number">{outcome.rows} of {outcome.planned}</td>',
        f"<td>{said}</td>",
    )
    return f'<tr class="{look}">' + "".join(cells) + "</tr>"


def _budget(outcome: TrialOutcome) -> str:
    used = outcome.budget
    if used is None:
        return "–"
    kept = "kept" if used.kept else "EXCEEDED"
    return f"{used.name} {kept}: {used.time_s:.2f} of {used.allowed_s:g} s, {used.travel:.3f} of {used.allowed_travel:.3f}"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"
