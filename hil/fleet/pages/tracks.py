"""Pages of one machine and of one parameter: their nights, what is common taken off, and their trend."""

from __future__ import annotations

import numpy as np

from hil.fleet.change import FleetChange, Parameter, Trend, sentence, trend_of
from hil.fleet.change.sentences import day, rounded
from hil.fleet.pages.fleet import changes_table, facts_of, how_found, page_of_machine, verdict_of
from hil.pages import Band, Bullets, Chart, Charts, Mark, Page, Scale, Section, Series, Table, Text, Verdict

YEAR = 365.25
TRENDS = "± at 95 %; levels in the middle of the nights. The fleet's common part is taken off."
SHOWN_MACHINES = 5
"""Machines that a parameter's chart draws by name, those with the greatest evidence; more curves are not told apart."""


def machine_page(found: FleetChange, machine: str, store: str) -> Page:
    """Return the page of one machine."""
    tracks = found.tracks
    index = list(tracks.machines).index(machine)
    changes = [change for change in found.changes if change.machine == machine]
    said = [sentence(each, len(tracks.machines) - sum(other.parameter == each.parameter for other in found.changes)) for each in changes]
    text = f"{machine} needs a visit: {said[0].partition(': ')[2]}." if said else f"{machine} did not change."
    verdict = verdict_of(found) if found.model is None else Verdict(text, "bad" if said else "good")
    order = np.argsort(-np.abs(found.evidence[index]), kind="stable")
    shown = [int(j) for j in order if np.isfinite(tracks.values[index, :, j]).any()]
    sections = []
    if found.model is not None:
        sections.append(Section("Trends", [_trends(found, index, trend_of(found, machine), shown), Text(TRENDS)]))
    cells = [_chart(found, index, j, [each for each in changes if each.parameter == tracks.parameters[j]]) for j in shown]
    sections.append(Section("Night by night", [Charts(cells, columns=2)]))
    sections.append(Section("How this was found", [Text(line) for line in how_found(found)], is_folded=True))
    return Page(machine, verdict, sections, facts=facts_of(found, store))


def parameter_page(found: FleetChange, parameter: Parameter, store: str) -> Page:
    """Return the page of one parameter over all machines."""
    tracks = found.tracks
    j = list(tracks.parameters).index(parameter)
    changes = [change for change in found.changes if change.parameter == parameter]
    others = len(tracks.machines) - len(changes)
    text = (
        f"{parameter.quantity} changed on {len(changes)} of {len(tracks.machines)} machines."
        if changes
        else f"{parameter.quantity} changed on no machine of its own."
    )
    verdict = verdict_of(found) if found.model is None else Verdict(text, "bad" if changes else "good")
    x = _days(found)
    own = tracks.values[..., j]
    measured = np.isfinite(own).any(axis=0)
    low, middle, high = (np.full(len(x), np.nan) for _ in range(3))
    low[measured], middle[measured], high[measured] = np.nanpercentile(own[:, measured], (5.0, 50.0, 95.0), axis=0)
    ranked = [int(m) for m in np.argsort(-np.abs(found.evidence[:, j]), kind="stable")[:SHOWN_MACHINES]]
    series = [Series("median machine", x, middle), *(Series(tracks.machines[m], x, own[m], is_points=True) for m in ranked)]
    fleet = Chart(
        f"{parameter.quantity}: all machines", _nights(found), _scale(parameter), series, [Band("90 % of the machines", x, low, high)],
        [Mark(float((each.since - tracks.nights[0]).astype(int)), each.machine) for each in changes[:SHOWN_MACHINES]], height=320,
    )  # fmt: skip
    common = Chart(
        "What all machines share, against the first nights", _nights(found), _scale(parameter), [Series("common", x, found.common[:, j])]
    )
    sections = [Section("All machines", [Charts([(fleet, common)])])]
    if changes:
        part = FleetChange(tracks, tuple(changes), found.common, found.evidence, found.threshold, found.per_machine_year, found.watched)
        sections.insert(0, Section("Machines that changed", [Bullets([sentence(each, others) for each in changes]), changes_table(part)]))
    rows = [
        (tracks.machines[m], _median(own[m]), f"{found.evidence[m, j]:+.1f}", page_of_machine(tracks.machines[m]))
        for m in np.argsort(-np.abs(found.evidence[:, j]), kind="stable")
    ]  # fmt: skip
    head = ("machine", f"median [{parameter.unit}]" if parameter.unit else "median", "sigma", "page")
    sections.append(Section("Machine by machine", [Table(head, rows, frozenset((1, 2)))], is_folded=True))
    sections.append(Section("How this was found", [Text(line) for line in how_found(found)], is_folded=True))
    return Page(
        f"{parameter.quantity}",
        verdict,
        sections,
        facts={"Task": parameter.task, "Experiment": parameter.experiment, **facts_of(found, store)},
    )


def _chart(found: FleetChange, index: int, j: int, changes: list) -> Chart:  # type: ignore[type-arg]
    tracks, parameter = found.tracks, found.tracks.parameters[j]
    x, values = _days(found), tracks.values[index, :, j]
    deviation = np.sqrt(tracks.covariances[index, :, j, j])
    series = [Series("night", x, values, is_points=True), Series("common taken off", x, values - found.common[:, j])]
    marks = [Mark(float((change.since - tracks.nights[0]).astype(int)), f"{change.kind} {change.sigma:+.1f} sigma") for change in changes]
    bands = [Band("95 % by the night's own covariance", x, values - 1.96 * deviation, values + 1.96 * deviation)] if deviation.any() else []
    return Chart(parameter.quantity, _nights(found), _scale(parameter), series, bands, marks, group="nights", height=180)


def _trends(found: FleetChange, index: int, trend: Trend, shown: list[int]) -> Table:
    count = len(trend.slope)
    deviations = np.sqrt(np.diag(trend.covariance))
    rows = []
    for j in shown:
        if not np.isfinite(trend.slope[j]):
            continue
        error = YEAR * deviations[count + j]
        parameter = found.tracks.parameters[j]
        rows.append(
            (
                parameter.quantity,
                f"{rounded(trend.level[j], deviations[j])} ± {1.96 * deviations[j]:.2g}",
                f"{rounded(YEAR * trend.slope[j], error, signed=True)} ± {1.96 * error:.2g}",
                rounded(YEAR * trend.shrunk_slope[j], error, signed=True),
                parameter.unit,
                f"{found.evidence[index, j]:+.1f}",
            )
        )
    head = ("parameter", "level", "trend a year", "drawn to the fleet's", "unit", "evidence for a change [sigma]")
    return Table(head, rows, frozenset((1, 2, 3, 5)))


def _median(values: np.ndarray) -> str:
    return f"{np.nanmedian(values):.4g}" if np.isfinite(values).any() else "–"


def _days(found: FleetChange) -> np.ndarray:
    return np.asarray((found.tracks.nights - found.tracks.nights[0]).astype(float))


def _nights(found: FleetChange) -> Scale:
    return Scale(f"nights from {day(found.tracks.nights[0])} [d]")


def _scale(parameter: Parameter) -> Scale:
    return Scale(f"{parameter.quantity} [{parameter.unit}]" if parameter.unit else parameter.quantity)
