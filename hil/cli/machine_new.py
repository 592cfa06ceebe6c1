"""isocenter machine new: a machine file from answers, from MJCF or URDF, with data sheets of drives."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import can_be_written
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption

if TYPE_CHECKING:
    from hil.machine.machine import Machine
    from hil.machine.new.draft import Answers, Draft, Question
    from hil.machine.new.questions import KnownDrive


def register(machine: typer.Typer) -> None:
    """Add the command to the group."""
    machine.command(
        short_help="Write a machine file: by questions, from MJCF or URDF, with EDS files.",
        help="Write a machine file, with comments. In a terminal it asks; every answer may also be given as an option. What nobody says is "
        "assumed, marked in the file and printed, or left to be filled in. Without --eds the machine has no bus: it can be simulated."
        "\n\nExample:  isocenter machine new -o mine.toml --from arm.xml --eds drive.eds -a shoulder.constant=0.09",
    )(new)


def new(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="Where to write the machine file (.toml).")],
    source: Annotated[
        Path | None, typer.Option("--from", metavar="MODEL", help="MJCF (.xml) or URDF, read by MuJoCo: bodies and axes.")
    ] = None,
    eds: Annotated[
        list[Path] | None,
        typer.Option("--eds", metavar="FILE", help="Data sheets of drives, and of link encoders: one for all axes, or one for each."),
    ] = None,
    name: Annotated[str, typer.Option("--name", metavar="NAME", help="Name of the machine; the file's unless given.")] = "",
    answers: Annotated[
        list[str] | None,
        typer.Option(
            "-a", "--answer", metavar="KEY=VALUE", help="An answer, once for each: `turn.mass_kg=30`. Keys are those of the questions."
        ),
    ] = None,
    ask: Annotated[bool, typer.Option("--ask/--no-ask", help="Ask for what is not given, where there is a terminal.")] = True,
    json_to: JsonOption = None,
) -> None:
    """Ask, write, and say what is assumed and what is open."""
    from hil.machine.load import machine_from_text
    from hil.machine.new.draft import Answers
    from hil.machine.new.text import machine_text
    from hil.machine.open_points import marks

    answer = Answer(json_to)
    can_be_written(out, suffixes=(".toml",))
    if out.exists():
        raise UnusableInputError(f"{out}: is there already; a file that may hold work of yours is not written over")
    asks = _ask if ask and sys.stdin.isatty() and json_to != "-" else None
    if asks is not None:
        answer.say("Enter alone takes what stands in parentheses, or leaves the point to be filled in.")
    replies = Answers(_given(answers or []), asks)
    draft = _draft(replies, source, name or _name_of(out), eds or [], out.absolute().parent)
    simulated = machine_text(_without_bus(draft))
    if not marks(simulated)[0]:
        _design(draft, machine_from_text(simulated, out))
    text = machine_text(draft)
    missing, assumed = marks(text)
    if not missing:
        machine_from_text(text, out)
    out.write_text(text, encoding="utf-8")
    answer.say(
        f"{out}: {draft.name}, bodies {', '.join(body.name for body in draft.bodies)}; axes {', '.join(axis.name for axis in draft.axes)}"
    )
    for left in draft.left:
        answer.say(f"     not taken over: {left}")
    for mark in assumed:
        answer.say(f"     line {mark.line}: {mark.key} = {mark.value} is assumed: {mark.says}")
    if draft.designed:
        answer.say(f"     controllers are assumed: {draft.designed}")
    for mark in missing:
        answer.say(f"OPEN line {mark.line}: {mark.key}: {mark.says}")
    answer.say(f"then: isocenter machine check {out}" + (" lists what is still open" if missing else ""))
    answer.write(
        {
            "machine_file": out,
            "axes": [axis.name for axis in draft.axes],
            "assumed": [vars(mark) for mark in assumed],
            "open": [vars(mark) for mark in missing],
            "left": draft.left,
            "controllers": draft.sections,
        }
    )


def _ask(question: Question) -> str:
    otherwise = question.otherwise
    if otherwise is None:
        assumed = ""
    else:
        value = otherwise.value
        shown = ", ".join(f"{each:g}" for each in value) if isinstance(value, list) else f"{value:g}" if isinstance(value, float) else value
        assumed = f" ({shown}: {otherwise.why})"
    typer.echo(f"{question.words}{assumed}: ", nl=False)
    return sys.stdin.readline()


def _given(entries: list[str]) -> dict[str, str]:
    given: dict[str, str] = {}
    for entry in entries:
        key, equals, value = entry.partition("=")
        if not (key and equals and value):
            raise UnusableInputError(f"--answer {entry}: must be KEY=VALUE, such as turn.mass_kg=30")
        if key in given:
            raise UnusableInputError(f"--answer {entry}: {key} is answered already")
        given[key] = value
    return given


def _name_of(out: Path) -> str:
    plain = "".join(letter if letter.isascii() and (letter.isalnum() or letter == "_") else "_" for letter in out.stem)
    return plain if plain[:1].isalpha() else f"machine_{plain}"


def _draft(replies: Answers, source: Path | None, name: str, eds: list[Path], folder: Path) -> Draft:
    from hil.machine.new.questions import ask_drive, draft_of, rate_of
    from hil.machine.new.readers import name_of

    try:
        name_of(name)
    except ValueError as error:
        raise UnusableInputError(f"--name {name}: {error}") from None
    known: dict[str, KnownDrive] = {}
    if source is None:
        draft = draft_of(replies, name)
    else:
        from hil.machine.new.mujoco_model import draft_of_model

        draft, known = draft_of_model(source, name, rate_of(replies))
    if eds:
        from hil.machine.new.data_sheet import add_nodes

        add_nodes(draft.axes, eds, folder)
    for axis in draft.axes:
        ask_drive(replies, axis, known.get(axis.name), bool(eds))
    replies.check()
    return draft


def _without_bus(draft: Draft) -> Draft:
    """Return the draft as a machine that can be simulated: a bus needs the controllers that are still to be designed."""
    return replace(draft, axes=[replace(axis, node={}) for axis in draft.axes])


def _design(draft: Draft, machine: Machine) -> None:
    from hil.machine.new.design import designed

    found = designed(machine)
    if found is None:
        draft.left.append("controllers: no gain with integrator and lead holds it with the margins of `machine check`; design them by hand")
        return
    draft.sections = {axis: rows.tolist() for axis, rows in found.items()}
    draft.designed = "an integrator and a lead per axis, at the highest crossover that keeps 40 deg and 6 dB in every pose"
