"""isocenter machine list | show | check | export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import MachineArgument, can_be_written, load
from hil.terminal.output import Answer, JsonOption

app = typer.Typer(
    help="Machine files: list the shipped ones, show, check, export.\n\nExample:  isocenter machine check carm", no_args_is_help=True
)


@app.command("list", help="The machines that are shipped.\n\nExample:  isocenter machine list")
def list_machines(json_to: JsonOption = None) -> None:
    """Print names and descriptions."""
    from hil.machine import list_shipped, load_machine

    answer = Answer(json_to)
    machines = [load_machine(name) for name in list_shipped()]
    width = max(len(machine.name) for machine in machines)
    for machine in machines:
        answer.say(f"{machine.name:{width}s} {machine.description}")
    answer.write(
        [{"name": machine.name, "description": machine.description, "axes": machine.axes, "hash": machine.hash} for machine in machines]
    )


@app.command(help="What a machine file says: bodies, drives, sensors, limits, bus.\n\nExample:  isocenter machine show carm")
def show(
    machine_name: MachineArgument,
    toml: Annotated[bool, typer.Option("--toml", help="Print the machine file itself, to begin one of your own.")] = False,
    json_to: JsonOption = None,
) -> None:
    """Print a summary for a person; with --json the numbers in SI."""
    from hil.machine.summary import machine_document, machine_lines

    machine = load(machine_name)
    answer = Answer(json_to)
    if toml:
        answer.say(machine.text.rstrip("\n"))
        answer.write(machine_document(machine))
        return
    for line in machine_lines(machine):
        answer.say(line)
    answer.write(machine_document(machine))


@app.command(
    help="Check a machine: closed-loop margins and natural frequencies over its poses, holding effort, bus load. "
    "Status 1 when a check fails.\n\nExample:  isocenter machine check carm"
)
def check(machine_name: MachineArgument, json_to: JsonOption = None) -> None:
    """Print every finding on one line."""
    from hil.machine import check_machine

    machine = load(machine_name)
    answer = Answer(json_to)
    findings = check_machine(machine)
    for finding in findings:
        answer.say(f"{'ok  ' if finding.ok else 'FAIL'} {finding.text}")
    answer.write({"machine": machine.name, "ok": all(f.ok for f in findings), "findings": [vars(f) for f in findings]})
    if not all(finding.ok for finding in findings):
        raise typer.Exit(1)


@app.command(help="Write the plant as a MuJoCo model.\n\nExample:  isocenter machine export carm --mjcf carm.xml")
def export(
    machine_name: MachineArgument,
    mjcf: Annotated[Path, typer.Option("--mjcf", metavar="FILE", help="Where to write the MuJoCo model.")],
    json_to: JsonOption = None,
) -> None:
    """Export the machine; bodies, joints, actuators and sensors bear the machine file's names."""
    from hil.machine.mjcf import to_mjcf

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(mjcf)
    mjcf.write_text(to_mjcf(machine.plant, machine.name), encoding="utf-8")
    answer.say(f"{mjcf}: MuJoCo model of {machine.name}")
    answer.write({"mjcf": mjcf, "machine": machine.name, "hash": machine.hash})
