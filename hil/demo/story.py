"""The demo, step by step: what is hidden is sealed, the bench records, the tool answers blind, the envelope is opened."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

from drivers.errors import DriverError
from hil.demo.hidden import drawn
from hil.demo.judged import judged
from hil.demo.page import write_demo_page
from hil.demo.recorded import RECORDINGS, answered_by, demo_machine, recorded
from hil.demo.told import Story
from hil.diagnosis.files import write_diagnosis
from hil.errors import BenchError, UnusableInputError
from hil.recording import read_recording
from hil.terminal.output import Answer
from hil.terminal.progress import progress

SEAL = "envelope.sha256"


def run_demo(out: Path, answer: Answer, seed: int) -> dict[str, Any]:
    """Run the demo into the folder `out`; return the JSON document.

    Raises
    ------
    UnusableInputError
        The folder holds other files than an earlier demo's, or cannot be written to.
    BenchError
        The bench does not record the machine that the seed draws.
    """
    began = time.perf_counter()
    _cleared(out)
    machine = demo_machine(out)
    answer.say(f"{machine.name}: {machine.description}, EMULATED")
    envelope = drawn(machine, seed)
    _write(out / SEAL, f"{envelope.seal}  envelope.json\n")
    answer.say(f"sealed what seed {seed} hides in the emulated machine: SHA-256 {envelope.seal}")
    with progress() as bars:
        try:
            paths, recorded_s = recorded(machine, envelope, out, bars)
        except DriverError as error:
            lost = " ".join(str(error).split())
            raise BenchError(f"seed {seed}: the bench does not record what it hides; another --seed hides something else: {lost}") from None
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


def _cleared(out: Path) -> None:
    """Take an earlier demo out of a folder: beside a new seal its envelope would say something else."""
    if not out.is_dir() or not any(out.iterdir()):
        return
    if not (out / SEAL).exists():
        raise UnusableInputError(f"{out}: holds files that are no demo's; give --out an empty folder or a new one")
    for path in (out / name for name in ("index.html", "envelope.json", "diagnosis", *RECORDINGS)):
        try:
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        except OSError as error:
            raise UnusableInputError(f"{path}: an earlier demo's, cannot be removed: {error.strerror}; give another --out") from None


def _write(path: Path, text: str) -> None:
    """Write a text with the same bytes on every system: the envelope's have the sum that is its seal."""
    try:
        path.write_bytes(text.encode())
    except OSError as error:
        raise UnusableInputError(f"{path}: cannot be written: {error.strerror}; give --out another folder") from None
