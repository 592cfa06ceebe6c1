"""The reference of JSON answers, from the commands and the declared keys of `json_tables`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from docs.generate.command_line import commands
from docs.generate.format_tables import Entry
from docs.generate.json_tables import COMMANDS, DIAGNOSIS
from docs.generate.markdown import code, table
from docs.generate.markdown import page as whole
from hil.diagnosis.result import STAGES

INTRODUCTION = """
Every command takes `--json FILE` and writes its answer there, for programs. This page lists the keys. `--json -`, or
`--json` alone, writes to standard output and nothing else goes there. Numbers are in SI unless a key names a unit.
What is not a finite number is `null`. A command that ends with an error writes no JSON.
"""

DIAGNOSIS_TEXT = """
`isocenter diagnose ... -o DIR` writes `DIR/diagnosis.json`, and the same with `--json`. A *span* is `[low, high]`. An
*effect* is `{"effect": NAME, "at": PLACE}`, named as on the page of [effects](effects.md) and in the machine file.
*Stages* are an object of the six keys below. What the numbers mean is in [Diagnosis](../explanation/diagnosis.md).
Beside it DIR holds `report.html`, `effects.toml` (what was known and found), `machine.toml` (the re-tuned machine file, which
belongs to `effects.toml`) and, where one was found, `next_experiment.toml` for `isocenter run file`.
"""

_STAGE_TEXTS = {
    "nominal": "The simulation with the machine file as it is.",
    "retuned": "With numbers of the machine file re-tuned.",
    "extended": "With the findings as well.",
    "placebo": "Null: no change is tried backwards in time.",
    "noise_floor": "Noise alone.",
    "baseline": "With the engineer's fit: numbers, and friction and load of every driven joint.",
}


def page() -> str:
    """Write the page."""
    parts = [INTRODUCTION]
    for names in _alike(commands()):
        parts += ["## " + ", ".join(names), _keys(COMMANDS[names[0]]) if COMMANDS[names[0]][0].name else COMMANDS[names[0]][0].meaning]
    parts += ["## diagnosis.json", DIAGNOSIS_TEXT, table(("stage", "meaning"), ((code(stage), _STAGE_TEXTS[stage]) for stage in STAGES))]
    return whole("JSON answers", *parts, _keys(DIAGNOSIS))


def _alike(names: Iterable[str]) -> Iterator[list[str]]:
    """Yield the names of commands that answer alike together, in the order of the command line."""
    seen: list[tuple[Entry, ...]] = []
    names = list(names)
    for name in names:
        if COMMANDS[name] not in seen:
            seen.append(COMMANDS[name])
            yield [other for other in names if COMMANDS[other] == COMMANDS[name]]


def _keys(entries: Iterable[Entry]) -> str:
    rows = ((", ".join(code(name) for name in each.name.split(", ")), each.shape, each.meaning) for each in entries)
    return table(("key", "type", "meaning"), rows)
