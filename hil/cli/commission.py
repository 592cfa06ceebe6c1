"""isocenter commission: from a machine file to an identified, shaped and checked machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.emulated import EMULATED
from hil.cli.options import BusOption, EffectsOption, ImuOption, IoOption, MachineArgument, folder_can_be_written, load
from hil.errors import UnusableInputError
from hil.files.unused import told_of, unused_folder
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import progress


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Check, home, record, identify, shape and scan, in one go.",
        help="Commission a machine: check its file, home, record it at rest and in motion, identify it, design its shapers, scan with one,"
        " and say whether the simulation agrees. Status 1 where a step fails."
        "\n\nExample:  isocenter commission carm --bus lockstep: -o arm",
    )(commission)


def commission(
    machine_name: MachineArgument,
    bus: BusOption,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for recordings, frequency response and shapers.")],
    effects: EffectsOption = None,
    seed: Annotated[int, typer.Option("--seed", help="In lockstep: seed of the emulated sensors' noise.")] = 0,
    imu: ImuOption = "",
    io: IoOption = "",
    observer: Annotated[bool, typer.Option("--observer", help="Design the observer as well, which takes a minute.")] = False,
    json_to: JsonOption = None,
) -> None:
    """Say of every step what it found."""
    from hil.verbs.commission import Step
    from hil.verbs.commission import commission as commission_machine

    if effects is not None and not bus.startswith("lockstep:"):
        raise UnusableInputError("--effects: only a run on lockstep: emulates; give them to `isocenter emulate`")
    machine = load(machine_name)
    answer = Answer(json_to)
    folder_can_be_written(out)
    wanted, out = out, unused_folder(out)
    if told_elsewhere := told_of(wanted, out):
        answer.say(told_elsewhere)
    with progress(live=bus.startswith("lockstep:")) as bars:
        task = bars.add_task("commissioning", total=None)

        def told(step: Step) -> None:
            for line in step.said:
                answer.say(f"{'ok  ' if step.ok else 'FAIL'} {step.name:8s} {line}")

        def follow(name: str, done: int, total: int) -> None:
            bars.update(task, description=name, completed=done, total=total)

        found = commission_machine(
            machine,
            bus,
            out,
            emulated=None if effects is None else load(machine_name, effects),
            seed=seed,
            imu=imu,
            io=io,
            observer=observer,
            told=told,
            progress=follow,
        )
    if found.emulated:
        answer.say(f"{EMULATED}all of it was recorded on the emulator, not on a real machine")
    answer.say(found.verdict)
    if found.page is not None:
        answer.say(f"{found.page}: the page")
    if found.next_command[0]:
        answer.say(f"next: {found.next_command[0]}")
    answer.write(found.document())
    if not found.ok:
        raise typer.Exit(1)
