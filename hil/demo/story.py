"""The demo, step by step: what is hidden is sealed, the bench records, the tool answers blind, the envelope is opened."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from hil.demo.hidden import drawn
from hil.demo.judged import judged
from hil.demo.page import write_demo_page
from hil.demo.recorded import answered_by, demo_machine, recorded
from hil.demo.told import Story
from hil.diagnosis.files import write_diagnosis
from hil.recording import read_recording
from hil.terminal.output import Answer
from hil.terminal.progress import progress


def run_demo(out: Path, answer: Answer, seed: int) -> dict[str, Any]:
    """Run the demo into the folder `out`; return the JSON document."""
    began = time.perf_counter()
    machine = demo_machine(out)
    answer.say(f"{machine.name}: {machine.description}, EMULATED")
    envelope = drawn(machine, seed)
    answer.say(f"sealed what seed {seed} hides in the emulated machine: SHA-256 {envelope.seal}")
    with progress() as bars:
        paths, recorded_s = recorded(machine, envelope, out, bars)
        answer.say(f"recorded {recorded_s:.0f} s of machine time over the CANopen stack, after {time.perf_counter() - began:.1f} s")
        answered = answered_by(machine, paths, bars)
    diagnosis = answered.diagnosis
    write_diagnosis(answered, machine, out / "diagnosis", is_emulated=True)
    answer.say(f"blind, from these recordings: {diagnosis.verdict}: {diagnosis.reason}")
    (out / "envelope.json").write_text(envelope.text, encoding="utf-8")
    story = Story(
        machine, envelope, tuple(paths), read_recording(paths[-1]), answered, judged(diagnosis, envelope.effects), recorded_s
    )  # fmt: skip
    answer.say(f"the envelope is open. {story.judged.sentence}.")
    page = write_demo_page(story, out)
    seconds = time.perf_counter() - began
    answer.say(f"{page}: the page, after {seconds:.1f} s")
    return {
        "page": page,
        "seconds": seconds,
        "seed": seed,
        "seal": envelope.seal,
        "envelope": out / "envelope.json",
        "hidden": [{"effect": one.name, "at": one.at, "parameters": one.parameters} for one in envelope.effects],
        "worth": story.judged.worth,
        "recordings": paths,
        "diagnosis": out / "diagnosis" / "diagnosis.json",
        "verdict": diagnosis.verdict,
        "findings": [finding.effect.document() for finding in diagnosis.findings],
        "held_out": None if diagnosis.fit.held_out is None else diagnosis.fit.held_out.document(),
    }
