"""The folder a diagnosis is written to."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from hil.diagnosis.answering.machine_file import retuned_text
from hil.diagnosis.diagnose import NEXT_EXPERIMENT, Outcome
from hil.diagnosis.report import write_report
from hil.errors import UnusableInputError
from hil.experiments.file_text import experiment_text
from hil.machine import Machine
from hil.machine.effects_file import effects_text


def write_diagnosis(outcome: Outcome, machine: Machine, folder: Path) -> None:
    """Write diagnosis.json, effects.toml, the re-tuned machine.toml and report.html.

    And the next experiment where there is one; one that an earlier answer left there is removed.

    Raises
    ------
    UnusableInputError
        The folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        document = json.dumps(_finite(outcome.diagnosis.document()), indent=2, ensure_ascii=False)
        (folder / "diagnosis.json").write_text(document + "\n", encoding="utf-8")
        (folder / "effects.toml").write_text(effects_text(outcome.effects, machine), encoding="utf-8")
        text = retuned_text(machine, outcome.tuning.parameters, outcome.values)
        (folder / "machine.toml").write_text(text, encoding="utf-8")
        if outcome.proposal is not None:
            (folder / NEXT_EXPERIMENT).write_text(_experiment_text(outcome, machine), encoding="utf-8")
        else:  # an earlier answer's is none of this one
            (folder / NEXT_EXPERIMENT).unlink(missing_ok=True)
        write_report(outcome, folder)
    except OSError as error:
        raise UnusableInputError(f"{folder}: cannot be written to: {error.strerror}") from None


def _experiment_text(outcome: Outcome, machine: Machine) -> str:
    """The next experiment's file, with what it is for and what it should bring as comments."""
    assert outcome.proposal is not None
    return outcome.proposal.header() + experiment_text(outcome.proposal.experiment, machine)


def _finite(value: Any) -> Any:
    """NaN and infinities as null: JSON has neither."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
