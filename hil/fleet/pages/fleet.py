"""The page of a fleet: who needs a visit, and what all machines share."""

from __future__ import annotations

import shlex

import numpy as np

from hil.fleet.change import FleetChange, Parameter
from hil.fleet.change.bank import CUT
from hil.fleet.change.sentences import common_sentences, day, fleet_sentence, rounded, sentences
from hil.fleet.change.threshold import SETTLING
from hil.pages import Bullets, Page, Section, Table, Text, Verdict
from hil.pages.contents import Block

HEAD = ("machine", "what changed", "since", "95 % interval", "before", "now", "unit", "sigma", "said on")


def fleet_page(found: FleetChange, store: str) -> Page:
    """Return the page of who needs a visit."""
    blocks: list[Block] = [Bullets(sentences(found)), changes_table(found)] if found.changes else []
    sections = [Section("Who needs a visit", blocks)] if blocks else []
    if common := common_sentences(found):
        sections.append(Section("What all machines share", [Bullets(common)]))
    sections.append(Section("Machines", [_machines(found)], is_folded=bool(found.changes)))
    sections.append(Section("Parameters", [_parameters(found)], is_folded=True))
    sections.append(Section("How this was found", [Text(line) for line in how_found(found)], is_folded=True))
    command = f"isocenter fleet change {shlex.quote(store)} --json -"
    return Page("Fleet", verdict_of(found), sections, command if found.changes else "", "gives the same as data.", facts_of(found, store))


def verdict_of(found: FleetChange) -> Verdict:
    """Return who needs a visit, as the sentence on top."""
    kind = "unsure" if found.model is None else "bad" if found.changes else "good"
    return Verdict(". ".join([_capital(fleet_sentence(found)), *map(_capital, found.notes)]) + ".", kind)  # type: ignore[arg-type]


def facts_of(found: FleetChange, store: str) -> dict[str, str]:
    """Return what a page was made from."""
    nights = found.tracks.nights
    return {
        "Results": store,
        "Machines": str(len(found.tracks.machines)),
        "Nights": f"{len(nights)}, {day(nights[0])} to {day(nights[-1])}",
        "Stated": f"at most {100.0 * found.per_machine_year:g} false alarms in 100 machine-years, {int(found.watched.sum())} parameters",
    }


def how_found(found: FleetChange) -> list[str]:
    """Return what a reader must know of the method."""
    if found.model is None:
        return [f"Scatter is learned from the first {SETTLING} nights; nothing is said before."]
    least = int(np.ceil((found.threshold / CUT) ** 2))
    return [
        f"A machine is named once the evidence for a step or a growth passes {found.threshold:.2f} standard deviations. Sound machines,"
        " drawn with the scatter and the share of bad nights seen here, pass it at the stated rate.",
        f"A night says {CUT:g} deviations at most, so at least {least} nights must agree; a few bad nights do not alarm.",
        "What the median machine does is common to all and is taken off. So is what the others' scatter predicts of a parameter.",
        f"{found.watched_years:.1f} machine-years were watched; {100.0 * found.model.bad_nights:.1f} % of the results are farther out than"
        " noise explains.",
    ]


def changes_table(found: FleetChange) -> Table:
    """Return the changes as a table."""
    rows = [
        (
            change.machine,
            f"{change.parameter.quantity}\n{change.kind}",
            day(change.since),
            f"{day(change.since_from)} to {day(change.since_to)}",
            rounded(change.before, change.deviation),
            rounded(change.now, change.deviation),
            change.parameter.unit,
            f"{change.sigma:+.1f}",
            day(change.alarm),
        )
        for change in found.changes
    ]
    return Table(HEAD, rows, frozenset((4, 5, 7)), ["bad"] * len(rows))


def page_of_machine(machine: str) -> str:
    """Return the file name of a machine's page."""
    return f"machine-{_file_name(machine)}.html"


def page_of_parameter(parameter: Parameter) -> str:
    """Return the file name of a parameter's page."""
    return f"parameter-{_file_name(parameter.key)}.html"


def _file_name(text: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in text)


def _machines(found: FleetChange) -> Table:
    bad = {change.machine for change in found.changes}
    order = np.argsort(-np.abs(found.evidence).max(axis=1))
    rows = []
    for index in order:
        machine = found.tracks.machines[index]
        most = int(np.abs(found.evidence[index]).argmax())
        quantity = found.tracks.parameters[most].quantity
        rows.append(
            (machine, "visit" if machine in bad else "–", f"{found.evidence[index, most]:+.1f}", quantity, page_of_machine(machine))
        )
    kinds = ["bad" if found.tracks.machines[index] in bad else "good" for index in order]
    return Table(("machine", "visit", "sigma", "greatest in", "page"), rows, frozenset((2,)), kinds)  # type: ignore[arg-type]


def _parameters(found: FleetChange) -> Table:
    rows = []
    for j, parameter in enumerate(found.tracks.parameters):
        changed = sum(change.parameter == parameter for change in found.changes)
        middle = np.nanmedian(found.tracks.values[..., j])
        scatter = found.model.scale[j] if found.model is not None else np.nan
        watched = "" if found.watched[j] else "too few results"
        rows.append(
            (parameter.quantity, f"{middle:.4g}", f"{scatter:.2g}", parameter.unit, str(changed), watched, page_of_parameter(parameter))
        )
    head = ("parameter", "median", "nightly scatter", "unit", "machines changed", "", "page")
    return Table(head, rows, frozenset((1, 2, 4)))


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
