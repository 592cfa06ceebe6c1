"""The demo's page: what the tool said, what was hidden, and how well the answer predicts."""

from __future__ import annotations

from pathlib import Path

from hil.demo.charts import held_out_charts
from hil.demo.hidden import Envelope
from hil.demo.judged import in_words
from hil.demo.recorded import REPEATS, TOLERANCE, TOUR
from hil.demo.told import Story
from hil.diagnosis.report.page import telling_charts
from hil.diagnosis.report.tables import findings, fit_table
from hil.diagnosis.verdict.values import unit_of
from hil.pages import Page, Section, Table, Text, Verdict, write_page
from hil.pages.contents import Block, Kind
from hil.reports.made_from import files_fact, machine_fact
from virtual_bus.effects.registry import effects

KIND: dict[str, Kind] = {"right": "good", "listed": "unsure", "in part": "unsure", "silent": "bad", "wrong": "bad"}
INTRODUCTION = (
    "This is a demonstration. {drawn} It was sealed before anything was recorded. The tool had the machine file, whose numbers it held to"
    " {tolerance}, and the recordings. How often it is right, on machines and recordings that it did not draw, is in the documentation,"
    " under “Proof of the diagnosis”."
)
DRAWN = (
    "A seed drew what the emulated machine hides, over every effect and place that these recordings could show, at two to five times its"
    " detection limit; what the bench refuses to move is not drawn."
)
CHOSEN = (
    "The emulated machine hides what it always hides where no --seed is given: an effect {times:g} times as strong as the least that these"
    " recordings could show, so that the eye finds it, too."
)
MISSING = (
    "Each black point is the effort that the drive gave from one sample to the next, less what the machine file's equations say that the"
    " motion takes; blue is their mean. Were the file complete, they would lie about a straight line at zero. Orange is the law that the"
    " tool named, with the numbers that it found."
)
HELPS = (
    "Neither simulation has seen this recording. One is of the machine file as it is, the other of the tool's answer; of all channels this"
    " is the one in which the answer makes the error smaller by most."
)
FOUND = "An interval holds the truth with 95 % if the named law is the right one. A number in brackets is the effect's own name for it."
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
    fell = ""
    if held is not None:
        before, after = _number(held.nominal), _number(held.extended)
        fell = f". Simulations of a recording that it had not seen err by {before} times the noise before, {after} after"
    recorded = RECORDED.format(repeats=REPEATS, stops=len(TOUR.stops), seconds=story.recorded_s)
    said: list[Block] = [Text(f"{diagnosis.verdict.replace('_', ' ').capitalize()}: {diagnosis.reason}.")]
    missing: list[Block] = [Text(MISSING), *charts] if (charts := telling_charts(story.answered)) else []
    predicted: list[Block] = [Text("No fit was needed, so nothing was predicted.")]
    errors: list[Section] = []
    if diagnosis.fit.channels:
        predicted = [held_out_charts(story, folder), Text(HELPS)]
        errors = [Section("Errors of every channel", [fit_table(diagnosis)], is_folded=True)]
    drawn = CHOSEN.format(times=story.envelope.times[0]) if story.envelope.seed is None else DRAWN
    return Page(
        "Demo: what does the simulation of this C-arm lack?",
        Verdict(f"{story.judged.sentence}{fell}.", KIND[story.judged.worth]),
        [
            *([Section("What the machine file lacks, and the law that was found in it", missing)] if missing else []),
            Section("A recording, simulated before and after", predicted),
            Section("What it is", [Text(line) for line in plainly(story.envelope)]),
            Section("What was done", [Text(INTRODUCTION.format(tolerance=f"{100.0 * TOLERANCE:g} %", drawn=drawn)), Text(recorded)]),
            Section("What was in the envelope", [_hidden(story), Text(FOUND), Text(SEAL.format(seal=story.envelope.seal))]),
            Section("What the tool said, blind, word for word", [*said, *findings(diagnosis, None)], is_folded=True),
            *errors,
        ],
        next_command=f"isocenter demo --seed {1 if story.envelope.seed is None else story.envelope.seed + 1} --out another-demo",
        next_reason="hides something else. The whole report of this one is diagnosis/report.html.",
        facts={
            "Machine": machine_fact(story.machine),
            "Files": files_fact(story.paths),
            "Folder": str(folder),
            "Answer": diagnosis.verdict.replace("_", " "),
        },
        is_emulated=True,
    )


def plainly(envelope: Envelope) -> list[str]:
    """Return what each hidden effect is, in the plain words of its own file."""
    return [f"{in_words(one.name, one.at).capitalize()}: {effects()[one.name].plain}" for one in envelope.effects]


def _hidden(story: Story) -> Table:
    """Return what was hidden, beside what was found of the same effect at the same place."""
    found = {(one.effect.effect, one.effect.at): one.parameters for one in story.answered.diagnosis.findings}
    rows: list[tuple[str, ...]] = []
    for setting, times in zip(story.envelope.effects, story.envelope.times, strict=True):
        for parameter in effects()[setting.name].parameters:
            estimate = found.get((setting.name, setting.at), {}).get(parameter.name)
            beside = "-" if estimate is None else f"{estimate.value:.4g} ({estimate.ci95[0]:.4g} to {estimate.ci95[1]:.4g})"
            unit = unit_of(parameter, setting.at, story.machine.plant)
            name = f"{parameter.description} ({parameter.name})" + (f" [{unit}]" if unit else "")
            strong = f"{times:.3g}" if parameter.is_strength else "-"
            rows.append((in_words(setting.name, setting.at), name, f"{setting.parameters[parameter.name]:.4g}", beside, strong))
    head = ("hidden", "parameter", "value", "found (95 % interval)", "times the least that shows")
    return Table(head, rows, frozenset((2, 3, 4)))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
