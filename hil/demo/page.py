"""The demo's page: what the tool said, what was hidden, and how well the answer predicts."""

from __future__ import annotations

from pathlib import Path

from hil.demo.charts import held_out_charts
from hil.demo.recorded import REPEATS, TOLERANCE, TOUR
from hil.demo.told import Story
from hil.diagnosis.answered.values import unit_of
from hil.diagnosis.report.tables import findings, fit_table
from hil.pages import Page, Section, Table, Text, Verdict, write_page
from hil.pages.contents import Block, Kind
from hil.reports.made_from import files_fact, machine_fact
from virtual_bus.effects.registry import effects

KIND: dict[str, Kind] = {"right": "good", "listed": "unsure", "in part": "unsure", "silent": "bad", "wrong": "bad"}
INTRODUCTION = (
    "This is a demonstration. A seed drew what the emulated machine hides, over every effect and place that these recordings could show, at"
    " two to five times its detection limit; what the bench refuses to move is not drawn. The draw was sealed before anything was recorded."
    " The tool had the machine file, whose numbers it held to {tolerance}, and the recordings. How often it is right, on machines and"
    " recordings that it did not draw, is in the documentation, under “Proof of the diagnosis”."
)
RECORDED = (
    "{repeats} runs of one tour with {stops} stops, both axes at once, and one run of another tour, which is held out: nothing is fitted"
    " to it. {seconds:.0f} s of machine time; every CAN frame, serial byte and Modbus message was encoded and decoded."
)
SEAL = "Sealed before the first run: SHA-256 {seal}. The opened one is envelope.json, whose sum is the same."


def write_demo_page(story: Story, folder: Path) -> Path:
    """Write `index.html` into a folder and return its path."""
    return write_page(page_of(story, folder), folder / "index.html")


def page_of(story: Story, folder: Path) -> Page:
    """Return the page of a demo that was run into a folder."""
    diagnosis = story.answered.diagnosis
    held = diagnosis.fit.held_out
    fell = "" if held is None else f". Held-out error: {_number(held.nominal)} times noise before, {_number(held.extended)} after"
    recorded = RECORDED.format(repeats=REPEATS, stops=len(TOUR.stops), seconds=story.recorded_s)
    said: list[Block] = [Text(f"{diagnosis.verdict.replace('_', ' ').capitalize()}: {diagnosis.reason}.")]
    predicted: list[Block] = [Text("No fit was needed, so nothing was predicted.")]
    if diagnosis.fit.channels:
        predicted = [held_out_charts(story, folder), fit_table(diagnosis)]
    return Page(
        "Demo: what does the simulation of this C-arm lack?",
        Verdict(f"{story.judged.sentence}{fell}.", KIND[story.judged.worth]),
        [
            Section("What was done", [Text(INTRODUCTION.format(tolerance=f"{100.0 * TOLERANCE:g} %")), Text(recorded)]),
            Section("What the tool said, blind", [*said, *findings(diagnosis, None)]),
            Section("What was in the envelope", [_hidden(story), Text(SEAL.format(seal=story.envelope.seal))]),
            Section("How well it predicts another tour", predicted),
        ],
        next_command=f"isocenter demo --seed {story.envelope.seed + 1} --out another-demo",
        next_reason="hides something else. The whole report of this one is diagnosis/report.html.",
        facts={
            "Machine": machine_fact(story.machine),
            "Files": files_fact(story.paths),
            "Folder": str(folder),
            "Answer": diagnosis.verdict.replace("_", " "),
        },
        is_emulated=True,
    )


def _hidden(story: Story) -> Table:
    """Return what was hidden, beside what was found of the same effect at the same place."""
    found = {(one.effect.effect, one.effect.at): one.parameters for one in story.answered.diagnosis.findings}
    rows: list[tuple[str, ...]] = []
    for setting, times in zip(story.envelope.effects, story.envelope.times, strict=True):
        for parameter in effects()[setting.name].parameters:
            estimate = found.get((setting.name, setting.at), {}).get(parameter.name)
            beside = "-" if estimate is None else f"{estimate.value:.4g} ({estimate.ci95[0]:.4g} to {estimate.ci95[1]:.4g})"
            unit = unit_of(parameter, setting.at, story.machine.plant)
            name = f"{parameter.name} [{unit}]" if unit else parameter.name
            strong = f"{times:.3g}" if parameter.is_strength else "-"
            rows.append((f"{setting.name} at {setting.at}", name, f"{setting.parameters[parameter.name]:.4g}", beside, strong))
    head = ("hidden", "parameter", "value", "found (95 % interval)", "times the limit")
    return Table(head, rows, frozenset((2, 3, 4)))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
