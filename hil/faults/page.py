"""The page of the table of faults: one self-contained HTML file, and the same as data."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from hil.bench.wiring import REST_AT_MOST_S
from hil.faults.check import TrialOutcome
from hil.faults.motion import MOTIONS, Motion
from hil.machine import Machine
from hil.pages import Page, Section, Table, Text, Verdict
from hil.pages import write_page as write
from hil.pages.contents import Kind
from hil.reports.made_from import machine_fact
from hil.version import software_version
from virtual_bus.faults.registry import fault_kinds

PAGE, DATA = "faults.html", "faults.json"
BAD = ("not at rest", "did not end")
DOUBTFUL = ("unnoticed", "never began")
MEANINGS = {
    "stopped": "the run ended with an error and every axis is at rest.",
    "noted": "the run went on and said something of it.",
    "within tolerance": "the run ended as if nothing had been, and every recorded position is that of a run without the fault.",
    "unnoticed": "the run ended as if nothing had been; the fault may be harmless.",
    "cannot be held": "brake and drive are both lost: the run named the emergency stop, and no drive gives it an effort.",
    "not at rest": f"an axis still moved when the watch ended, {REST_AT_MOST_S:g} s after the last SYNC at most.",
}
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
    return write(page_of(machine, axis, outcomes, motion), folder / PAGE)


def page_of(machine: Machine, axis: str, outcomes: Sequence[TrialOutcome], motion: Motion) -> Page:
    """Return the page: what failed on top, then the classes of faults in their own order and the worst of each first."""
    unit = machine.units[machine.axis_index(axis)].position
    groups = list(dict.fromkeys(outcome.group for outcome in outcomes))
    failed = [outcome for outcome in outcomes if is_failure(outcome)]
    moved = MOTIONS[motion.name].format(axis=axis, speed=motion.speed, unit=unit)
    made = f"Each fault was injected into the emulated machine during one short session: boot, first-move check, homing, and {moved}"
    counted = "Time and travel count from the fault; a fault of a stop counts from the release of hold-to-run."
    sections = [Section("What failed", [_table(failed, unit)])] if failed else []
    for group in groups:
        sections.append(
            Section(_capital(group), [_table([each for each in outcomes if each.group == group], unit)], is_folded=bool(failed))
        )
    words = Section("What the words mean", [Text(f"{made} (sweep: near its greatest speed). {counted}"), *_meanings()], is_folded=True)
    command, reason = _next(machine, failed)
    return Page(
        f"Faults of {machine.name}",
        Verdict(_verdict(outcomes, failed), "bad" if failed else "good"),
        [*sections, words],
        command,
        reason,
        {
            "Machine": f"{machine_fact(machine)}, {machine.description}",
            "Moved by": moved,
            "Faults": summary_of(outcomes),
            "Processor": f"{sum(outcome.processor_s for outcome in outcomes):.0f} s",
        },
        is_emulated=True,
    )


def _verdict(outcomes: Sequence[TrialOutcome], failed: Sequence[TrialOutcome]) -> str:
    count = "The fault" if len(outcomes) == 1 else f"All {len(outcomes)} faults"
    if not failed:
        who = "it" if len(outcomes) == 1 else "they"
        return f"{count} ended as {who} must: stopped within the budget, noted, or said to be beyond holding."
    how = Counter(_failure(outcome) for outcome in failed)
    return f"{len(failed)} of {len(outcomes)} faults failed: " + ", ".join(f"{number} {word}" for word, number in how.most_common()) + "."


def _failure(outcome: TrialOutcome) -> str:
    if outcome.verdict in BAD + DOUBTFUL:
        return outcome.verdict
    return "over the budget" if is_over_budget(outcome) else "told wrongly"


def _next(machine: Machine, failed: Sequence[TrialOutcome]) -> tuple[str, str]:
    if not failed:
        return "", ""
    only = shlex.quote(failed[0].name)
    return f"isocenter faults check {machine.name} --only {only} -o again", "tries the first of them alone."


def _meanings() -> list[Text]:
    return [Text(f"{word}: {meaning}") for word, meaning in MEANINGS.items()]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


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


def _table(outcomes: Sequence[TrialOutcome], unit: str) -> Table:
    ranked = sorted(outcomes, key=lambda outcome: 0 if outcome.verdict in BAD else 1 if is_failure(outcome) else 2)
    kinds: list[Kind] = ["bad" if each.verdict in BAD else "unsure" if is_failure(each) else "good" for each in ranked]
    return Table([cell.format(unit=unit) for cell in _HEAD], [_row(outcome) for outcome in ranked], frozenset((4, 5, 8)), kinds)


def _row(outcome: TrialOutcome) -> list[str]:
    told = [f"NOT TRUE: {claim}" for claim in outcome.contradicted] + [f"stopping: {trouble}" for trouble in outcome.stopping]
    details = outcome.name.split("/")[3:]
    return [
        f"{outcome.kind} {' '.join(details)}".rstrip() + f"\n{fault_kinds()[outcome.kind].does}",
        outcome.at,
        outcome.during,
        f"{outcome.verdict}\nexit status {outcome.exit_status}",
        _number(outcome.rest_s, 2),
        _number(outcome.travel, 3),
        _budget(outcome),
        outcome.ending,
        f"{outcome.rows} of {outcome.planned}",
        "\n".join(text for text in (outcome.said, *told) if text),
    ]


def _budget(outcome: TrialOutcome) -> str:
    used = outcome.budget
    if used is None:
        return "–"
    kept = "kept" if used.kept else "EXCEEDED"
    return f"{used.name} {kept}: {used.time_s:.2f} of {used.allowed_s:g} s, {used.travel:.3f} of {used.allowed_travel:.3f}"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"
