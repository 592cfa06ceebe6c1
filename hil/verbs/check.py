"""Is a machine file fit to be run: open points of it or, where there are none, what a check of the machine finds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hil.verbs.verb import NOBODY, Listener

if TYPE_CHECKING:
    from hil.machine import Finding, Machine
    from virtual_bus.linear.left_out import LeftOut


@dataclass(frozen=True)
class CheckRequest:
    """A machine by its name or file."""

    machine: str | Path


@dataclass(frozen=True)
class CheckAnswer:
    """What a check found."""

    machine: str
    """The machine."""
    ok: bool
    """Whether every check is passed."""
    findings: tuple[Finding, ...]
    """One per check; of a file with open points these alone."""
    left_out: tuple[LeftOut, ...]
    """Effects of the machine file that the linear model of this answer does not hold."""

    @property
    def lines(self) -> list[str]:
        """The answer in words, a line per finding."""
        return [f"{finding.mark:4s} {finding.text}" for finding in self.findings]


def answer(request: CheckRequest, listener: Listener = NOBODY) -> CheckAnswer:
    """Check a machine file; MachineFileError where it cannot be read."""
    from hil.machine import load_machine
    from hil.machine.finding import Finding
    from hil.machine.load import text_of
    from hil.machine.open_points import marks
    from virtual_bus.linear.left_out import LeftOut

    missing, assumed = marks(text_of(request.machine))
    name = str(request.machine)
    findings = [Finding("open", False, f"line {mark.line}: {mark.key} is to be filled in: {mark.says}") for mark in missing]
    if not missing:
        machine = load_machine(request.machine)
        name, findings = machine.name, findings_of(machine, listener)
    findings += [Finding("assumed", True, f"line {mark.line}: {mark.key} = {mark.value} is assumed: {mark.says}") for mark in assumed]
    left_out = tuple(LeftOut(**each) for finding in findings for each in finding.values.get("left_out", ()))
    return CheckAnswer(name, all(finding.ok for finding in findings), tuple(findings), left_out)


def findings_of(machine: Machine, listener: Listener = NOBODY) -> list[Finding]:
    """Return what is found of a machine that has been read: modes, margins, holding efforts, bus load; those that fail have `ok` False."""
    from hil.machine import check_machine

    with listener.working(f"checking {machine.name}"):
        return check_machine(machine)
