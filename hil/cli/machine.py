"""isocenter machine list | show | check | export | convert | schema; `machine new` is in `machine_new`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli import machine_new
from hil.cli.asking import ask
from hil.cli.options import MachineArgument, can_be_written, load, not_an_input
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import working
from hil.verbs import check as verb

if TYPE_CHECKING:
    from hil.machine import Finding

app = typer.Typer(
    help="Machine files: list the shipped ones, show, check, export, convert, write new ones.\n\nExample:  isocenter machine check carm",
    no_args_is_help=True,
)


machine_new.register(app)


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
    """Print every finding on one line; of a file with open points these alone."""
    answer = Answer(json_to)
    found = ask(verb.answer, verb.CheckRequest(machine_name), answer)
    for line in found.lines:
        answer.say(line)
    answer.write(found)
    if not found.ok:
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


@app.command(
    help="The same machine file for another sample rate, comments and order kept; margins are checked and shown beside the old ones. "
    "Status 1 when a check fails; the file is written all the same."
    "\n\nExample:  isocenter machine convert carm --rate 512 -o carm_512.toml"
)
def convert(
    machine_name: MachineArgument,
    rate_Hz: Annotated[float, typer.Option("--rate", metavar="HZ", help="The new sample rate.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="Where to write the new machine file (.toml).")],
    json_to: JsonOption = None,
) -> None:
    """Write the file, then print what hangs on the rate, before and after."""
    from hil.machine import machine_from_text
    from hil.machine.convert import converted_text

    answer = Answer(json_to)
    can_be_written(out, suffixes=(".toml",))
    machine = load(machine_name)
    if machine.path is not None:
        not_an_input(out, machine.path)
    text, changes = converted_text(machine, rate_Hz)
    converted = machine_from_text(text, out)
    out.write_bytes(text.encode())
    answer.say(f"{out}: {machine.name} at {rate_Hz:g} Hz instead of {machine.sample_rate_Hz:g} Hz; comments are the old file's")
    for change in changes:
        if not isinstance(change.new, list):
            answer.say(f"     {change.key} = {change.new:.6g}, was {'not written' if change.old is None else format(change.old, '.6g')}")
    with working("checking both"):
        before, after = verb.findings_of(machine), verb.findings_of(converted)
    for line in _beside(before, after, (f"{machine.sample_rate_Hz:g} Hz", f"{rate_Hz:g} Hz")):
        answer.say(line)
    failed = [finding for finding in after if not finding.ok]
    for finding in failed:
        answer.say(f"FAIL {finding.text}")
    answer.write(
        {
            "machine_file": out,
            "hash": converted.hash,
            "changes": [vars(change) for change in changes],
            "ok": not failed,
            "before": [vars(finding) for finding in before],
            "findings": [vars(finding) for finding in after],
        }
    )
    if failed:
        raise typer.Exit(1)


@app.command(
    help="The JSON schema of machine files, by which editors complete and check them. It stands beside the file, whose first line names it."
    "\n\nExample:  isocenter machine schema -o isocenter-machine.schema.json"
)
def schema(
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FILE", help="Where to write it; standard output unless given.")
    ] = None,
    json_to: JsonOption = None,
) -> None:
    """Print or write the schema."""
    from hil.machine.editors import SCHEMA, SCHEMA_LINE

    answer = Answer(json_to)
    text = SCHEMA.read_text(encoding="utf-8")
    if out is None:
        answer.say(text.rstrip("\n"))
    else:
        can_be_written(out, suffixes=(".json",))
        out.write_text(text, encoding="utf-8")
        line = SCHEMA_LINE.replace(SCHEMA.name, out.name)
        answer.say(f"{out}: JSON schema of machine files; a file beside it names it in its first line: {line}")
    answer.write({"schema": out})


SHOWN = {
    "stability": ("largest pole radius", "pole_radius", ".6f", ""),
    "phase_margin": ("phase margin", "phase_deg", ".1f", "deg"),
    "gain_margin": ("gain margin", "gain_dB", ".1f", "dB"),
    "crossover": ("crossover", "crossover_Hz", ".2f", "Hz"),
    "bus_load": ("bus load", "share", ".1%", ""),
}
"""What of a check hangs on the sample rate: words, key of its value, format and unit."""


def _beside(before: list[Finding], after: list[Finding], rates: tuple[str, str]) -> list[str]:
    """Return a table of two checks of one machine, worst pose each."""
    lines = []
    for old, new in zip(*([finding for finding in check if finding.name in SHOWN] for check in (before, after)), strict=True):
        words, key, form, unit = SHOWN[old.name]
        cells = []
        for value in (old.values[key], new.values[key]):
            numbers = value if isinstance(value, list) else [value]
            cells.append(f"{' to '.join(format(number, form) for number in numbers)} {unit}".rstrip())
        named = f"{old.values.get('axis', '')} {words}".lstrip()
        lines.append(f"{new.mark:4s} {named:32s}{cells[0]:>20s}{cells[1]:>20s}")
    return [f"     {'':32s}{rates[0]:>20s}{rates[1]:>20s}", *lines] if lines else []
