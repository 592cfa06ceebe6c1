"""The reference of the command line, from Typer's commands."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Protocol, cast

import typer

from docs.generate.markdown import block, code, sentence, table
from docs.generate.markdown import page as whole
from hil.cli import register
from hil.cli.app import app

INTRODUCTION = """
Every command of `isocenter` is listed here with its arguments, options and defaults. `isocenter COMMAND --help`
prints the same.
"""

STATUS_TEXT = """
| status | meaning |
| --- | --- |
| 0 | done |
| 1 | it ran, and the answer is bad: a check failed, a limit stopped the machine, a simulation diverged |
| 2 | unusable input; one line on standard error says what is wrong, where, and what would be right |
| 3 | of `stop` alone: nothing runs that could be stopped |

Every command takes `--json FILE`; without a file, or with `-`, the answer goes to standard output and nothing else
does. The keys are in [JSON answers](json.md). `ISOCENTER_TRACEBACK=1` shows where in the code an error arose.
"""


class Parameter(Protocol):
    """What this page asks of an argument or option."""

    name: str
    opts: list[str]
    secondary_opts: list[str]
    metavar: str | None
    required: bool
    multiple: bool
    nargs: int
    default: object
    param_type_name: str
    help: str | None


class Command(Protocol):
    """What this page asks of a command or group."""

    help: str | None
    params: list[Parameter]


def commands() -> dict[str, Command]:
    """List every command that does something, by its name without `isocenter`, in the order of --help."""
    register.commands(app)
    return dict(_walk(typer.main.get_command(app), ""))


def page() -> str:
    """Write the page."""
    found = commands()
    rows = ((f"[`isocenter {name}`](#{_anchor(name)})", sentence(_help(command)[0])) for name, command in found.items())
    parts = [INTRODUCTION, table(("command", "what it does"), rows), "## Exit status and JSON", STATUS_TEXT, "## Commands"]
    for name, command in found.items():
        parts += [f"({_anchor(name)})=\n### isocenter {name}", *_command(name, command)]
    return whole("Command line", *parts)


def _walk(command: object, name: str) -> Iterator[tuple[str, Command]]:
    inner: dict[str, Any] | None = getattr(command, "commands", None)
    if inner is None:
        yield name, cast(Command, command)
        return
    for part, each in inner.items():
        yield from _walk(each, f"{name} {part}".strip())


def _command(name: str, command: Command) -> Iterator[str]:
    arguments = [each for each in command.params if each.param_type_name == "argument"]
    options = [each for each in command.params if each.param_type_name == "option"]
    needed = [f"{each.opts[-1]} {_metavar(each)}".strip() for each in options if each.required]
    usage = ["isocenter", name, *(_metavar(each) for each in arguments), *needed]
    yield block(" ".join([*usage, "[OPTIONS]"]))
    for paragraph in _help(command):
        said, example, line = paragraph.rpartition(":  ")
        yield f"{said}:\n\n{block(line, 'sh')}" if example and line.startswith("isocenter ") else paragraph
    if arguments:
        yield table(("argument", "meaning"), ((code(_metavar(each)), sentence(each.help or "")) for each in arguments))
    yield table(("option", "value", "default", "meaning"), (_option(each) for each in options))


def _option(option: Parameter) -> tuple[str, ...]:
    names = ", ".join(code(each) for each in (*option.opts, *option.secondary_opts))
    value = code(_metavar(option)) + (", may be repeated" if option.multiple else "")
    return names, value, _default(option), sentence(option.help or "")


def _default(option: Parameter) -> str:
    value = option.default
    if option.required:
        return "required"
    if isinstance(value, bool):
        return code(option.opts[0]) if value else (code(option.secondary_opts[0]) if option.secondary_opts else "off")
    if value is None or value == "" or value == []:
        return "none"
    return code(str(value))


def _metavar(parameter: Parameter) -> str:
    if parameter.metavar:
        return parameter.metavar
    if parameter.param_type_name == "argument":
        return parameter.name.upper()
    if isinstance(parameter.default, bool):
        return ""
    return {int: "N", float: "NUMBER"}.get(type(parameter.default), "TEXT")


def _help(command: Command) -> list[str]:
    text = re.sub(r"[ \t]*\n(?!\n)[ \t]*", "\n", command.help or "")
    return [" ".join(part.split(" \n")) if "isocenter" in part else " ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def _anchor(name: str) -> str:
    return "isocenter-" + name.replace(" ", "-")
