"""The folder a diagnosis is written to."""

from __future__ import annotations

import json
import math
from pathlib import Path

from hil.diagnosis.report.page import write_report
from hil.diagnosis.result import Diagnosis
from hil.diagnosis.verdict.answer import NEXT_EXPERIMENT
from hil.diagnosis.verdict.values import Outcome
from hil.errors import UnusableInputError
from hil.experiments.file_text import experiment_text
from hil.machine import Machine
from hil.machine.effects_file import effects_text
from hil.machine.retuned_file import retuned_text
from virtual_bus.plant.parameters import plant_parameters


def write_diagnosis(outcome: Outcome, machine: Machine, folder: Path, is_emulated: bool = False) -> None:
    """Write diagnosis.json, effects.toml, the re-tuned machine.toml and report.html, which says where the recordings are an emulator's.

    And the next experiment where there is one; one that an earlier answer left there is removed.

    Raises
    ------
    UnusableInputError
        The folder cannot be written to.
    """
    write_answer(outcome.diagnosis, folder)
    parameters, proposal = plant_parameters(machine.plant), outcome.proposal
    try:
        (folder / "effects.toml").write_text(effects_text((*machine.added_effects, *outcome.effects), machine), encoding="utf-8")
        intervals = {name: number.ci95 for name, number in outcome.diagnosis.retuned.items()}
        (folder / "machine.toml").write_text(retuned_text(machine, parameters, outcome.values, intervals), encoding="utf-8")
        if proposal is not None:
            text = proposal.header() + experiment_text(proposal.experiment, machine)  # what it is for, as comments
            (folder / NEXT_EXPERIMENT).write_text(text, encoding="utf-8")
        else:  # an earlier answer's is none of this one
            (folder / NEXT_EXPERIMENT).unlink(missing_ok=True)
        write_report(outcome, folder, is_emulated)
    except OSError as error:
        raise UnusableInputError(f"{folder}: cannot be written to: {error.strerror}") from None


def write_answer(diagnosis: Diagnosis, folder: Path) -> None:
    """Write diagnosis.json.

    Raises
    ------
    UnusableInputError
        The folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        document = json.dumps(_finite(diagnosis.document()), indent=2, ensure_ascii=False)
        (folder / "diagnosis.json").write_text(document + "\n", encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(f"{folder}: cannot be written to: {error.strerror}") from None


def _finite(value: object) -> object:
    """NaN and infinities as null: JSON has neither."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
