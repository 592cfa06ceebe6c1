"""Commands of `isocenter` that a piece of work consists of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.console.facts import Facts

Answers = Mapping[str, Any]
"""JSON answers of the commands that have ended, by their key."""


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes
    ----------
    key : str
        Its JSON answer is kept under this name.
    arguments : callable
        From the answers of the commands before to its arguments, without `--json`.
    moves : bool
        Whether the machine may move: only then must the browser that ordered it keep answering.
    """

    key: str
    arguments: Callable[[Answers], list[str]]
    moves: bool = False


@dataclass(frozen=True)
class Order:
    """A piece of work: its commands in order, and what to tell of them.

    Attributes
    ----------
    title : str
    commands : tuple of Command
    step : str
        The step of the commissioning that it is; "" for any other work.
    judge : callable
        From the answers to a line that says why the work has passed, and whether it has.
    made : tuple of str
        Names of pages in the folder that are of interest afterwards.
    """

    title: str
    commands: tuple[Command, ...]
    step: str = ""
    judge: Callable[[Answers], tuple[bool, str]] = lambda answers: (True, "done")
    made: tuple[str, ...] = ()

    @property
    def moves(self) -> bool:
        """Whether any of its commands may move the machine."""
        return any(command.moves for command in self.commands)


def run_command(facts: Facts, folder: Path, name: str, text: str) -> Command:
    """Return the run of an experiment file, which is written into the folder, where the user finds it."""

    def arguments(answers: Answers) -> list[str]:
        path = folder / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        timing = [] if facts.real_time else ["--no-real-time"]
        # of an emulated machine no two recordings in the folder have the same noise: repeats would be one recording, twice
        noise = ["--seed", str(sum(1 for _ in folder.glob("*.mf4")))] if facts.is_lockstep else []
        return ["run", str(path), *on_the_bus(facts), "-o", str(folder / f"{name}.mf4"), *timing, *noise, "--tell"]

    return Command(name, arguments, moves=True)


def on_the_bus(facts: Facts) -> list[str]:
    """Return the options that say which machine, and where it is."""
    options = ["-m", facts.name, "--bus", facts.bus]
    if facts.imu:
        options += ["--imu", facts.imu]
    return options + (["--io", facts.io] if facts.io else [])


def recordings_of(answer: Mapping[str, Any]) -> list[str]:
    """Return the recordings that a run has made."""
    return [str(each["recording"]) for each in answer["recordings"]]
