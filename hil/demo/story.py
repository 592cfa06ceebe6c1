"""The demo, step by step: what is hidden is sealed, the bench records, the tool answers blind, the envelope is opened."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from drivers.errors import DriverError
from hil.demo.hidden import drawn, to_be_seen
from hil.demo.judged import judged
from hil.demo.page import plainly, write_demo_page
from hil.demo.recorded import answered_by, demo_machine, recorded
from hil.demo.told import Story
from hil.diagnosis.files import write_diagnosis
from hil.errors import BenchError, UnusableInputError
from hil.files.unused import told_of, unused_folder
from hil.recording import read_recording
from hil.terminal.output import Answer
from hil.terminal.progress import progress

SEAL = "envelope.sha256"


def run_demo(out: Path, answer: Answer, seed: int | None) -> dict[str, Any]:
    """Run the demo into the folder `out`, or into a new one beside it where that is in use; return the JSON document.

    Without a seed it hides an effect that is seen; a seed draws over everything that the recordings could show.

    Raises
    ------
    UnusableInputError
        The folder cannot be written to.
    BenchError
        The bench does not record the machine that the seed draws.
    """
    began = time.perf_counter()
    wanted, out = out, unused_folder(out)
    if told := told_of(wanted, out):
        answer.say(told)
    machine = demo_machine(out)
    answer.say(f"{machine.name}: {machine.description}, EMULATED")
    envelope = to_be_seen(machine) if seed is None else drawn(machine, seed)
    _write(out / SEAL, f"{envelope.seal}  envelope.json\n")
    hider = "the demo" if seed is None else f"seed {seed}"
    answer.say(f"sealed what {hider} hides in the emulated machine: SHA-256 {envelope.seal}")
    with progress() as bars:
        try:
            paths, recorded_s = recorded(machine, envelope, out, bars)
        except DriverError as error:
            lost = " ".join(str(error).split())
            raise BenchError(f"{hider}: the bench does not record what it hides; another --seed hides something else: {lost}") from None
        answer.say(f"recorded {recorded_s:.0f} s of machine time over the CANopen stack, after {time.perf_counter() - began:.1f} s")
        answered = answered_by(machine, paths, bars)
    diagnosis = answered.diagnosis
    write_diagnosis(answered, machine, out / "diagnosis", is_emulated=True)
    answer.say(f"blind, from these recordings: {diagnosis.verdict}: {diagnosis.reason}")
    _write(out / "envelope.json", envelope.text)
    story = Story(
        machine, envelope, tuple(paths), read_recording(paths[-1]), answered, judged(diagnosis, envelope.effects), recorded_s
    )  # fmt: skip
    answer.say(f"the envelope is open. {story.judged.sentence}.")
    for line in plainly(envelope):
        answer.say(line)
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
        "says": f"{story.judged.sentence}.",
        "recordings": paths,
        "diagnosis": out / "diagnosis" / "diagnosis.json",
        "verdict": diagnosis.verdict,
        "findings": [finding.effect.document() for finding in diagnosis.findings],
        "held_out": None if diagnosis.fit.held_out is None else diagnosis.fit.held_out.document(),
    }


def _write(path: Path, text: str) -> None:
    """Write a text with the same bytes on every system: the envelope's have the sum that is its seal."""
    try:
        path.write_bytes(text.encode())
    except OSError as error:
        raise UnusableInputError(f"{path}: cannot be written: {error.strerror}; give --out another folder") from None
