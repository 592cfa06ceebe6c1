"""Entry point: every error becomes one line and an exit status, never a traceback."""

from __future__ import annotations

import copy
import functools
import gc
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import zip_longest
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from hil.errors import INTERRUPTED, TRACEBACK_VARIABLE, UnusableInputError, in_one_line
from hil.version import software_version

if TYPE_CHECKING:
    from typer._click.exceptions import ClickException
    from typer.models import CommandInfo

# Matrices here are small: BLAS threads that spin for each other take the processor from the loop and cost more than they bring.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Compiling makes millions of objects that stay. Looking for unreachable ones after every 700, as Python does, takes an eighth of the
# compilation; after ten thousand it takes nothing that could be measured.
gc.set_threshold(10_000)

# Typer brings its own copy of Click: its exception classes are reached through Typer's names.
_UsageError: type[Any] = typer.BadParameter.__bases__[0]
_ClickException: type[Any] = _UsageError.__bases__[0]

_BUSES = "`--bus lockstep:` for the emulated machine in this process, `--bus socketcan:can0` for a real one"
_COMPLETING = "_ISOCENTER_COMPLETE"  # environment variable with which a shell asks for completions
_BY_CTRL_C = 130  # what Typer makes of Ctrl-C

app = typer.Typer(
    name="isocenter",
    help="Hardware-in-the-loop controller stack for an X-ray C-arm.\n\nStart with:  isocenter bench",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


def _say_version(wanted: bool) -> None:
    if wanted:
        print(software_version())
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and leave.", callback=_say_version, is_eager=True)] = False,
) -> None:
    """Take the options that stand before a command."""


def _nothing() -> None:
    """Stand in for a command that is only listed."""


@functools.cache
def _command(called: str | None) -> Callable[..., Any]:
    """Return the commands as Typer runs them, of which only the one that is called has its parameters; None: all have.

    To make those of all commands takes longer than many a command.
    """
    from hil.cli import register

    register.commands(app)
    if called is None:
        return typer.main.get_command(app)
    listed = copy.copy(app)
    listed.registered_commands = [_listed(info, called) for info in app.registered_commands]
    listed.registered_groups = []
    for group in app.registered_groups:
        one = copy.copy(group)
        if one.name != called and one.typer_instance is not None:
            one.typer_instance = copy.copy(one.typer_instance)
            one.typer_instance.registered_commands, one.typer_instance.registered_groups = [], []
        listed.registered_groups.append(one)
    return typer.main.get_command(listed)


def _listed(info: CommandInfo, called: str) -> CommandInfo:
    """Return a command, without its parameters where it is not called."""
    assert info.callback is not None
    name = info.name or typer.main.get_command_name(info.callback.__name__)
    if name == called:
        return info
    only_named = copy.copy(info)
    only_named.name, only_named.callback, only_named.help = name, _nothing, info.help or info.callback.__doc__
    return only_named


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit status: 0 done, 1 a bad answer, 2 unusable input."""
    try:
        with _warnings_in_one_line():
            words = _held_out_each(_json_to_standard_output(sys.argv[1:] if arguments is None else arguments))
            status = (
                _command(None if _COMPLETING in os.environ else next((word for word in words if not word.startswith("-")), ""))(
                    args=words,
                    prog_name=app.info.name,
                    standalone_mode=False,
                )
                or 0
            )
    except typer.Exit as leave:
        status = leave.exit_code
    except (typer.Abort, KeyboardInterrupt):
        status = _BY_CTRL_C
    except _ClickException as error:
        status = _say_usage(error)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    except Exception as error:
        status = _say_error(error)
    if status == _BY_CTRL_C:
        status = _say(INTERRUPTED, 1)
    sys.exit(status if isinstance(status, int) else 0)


def _json_to_standard_output(arguments: list[str]) -> list[str]:
    """Read a bare `--json` as `--json -`."""
    complete = []
    for place, argument in enumerate(arguments):
        complete.append(argument)
        if argument == "--json" and (place + 1 == len(arguments) or arguments[place + 1].startswith("--")):
            complete.append("-")
    return complete


def _held_out_each(arguments: list[str]) -> list[str]:
    """Read `--held-out A B` and `--held-out=A B` as `--held-out A --held-out B`.

    With nothing after it, the option would take the next option for a recording, so this is refused.
    """
    complete: list[str] = []
    held_out = False
    apart = [part for one in arguments for part in (one.split("=", 1) if one.startswith("--held-out=") else [one])]
    for argument, following in zip_longest(apart, apart[1:], fillvalue="-"):
        if argument == "--held-out" and following.startswith("-"):
            raise UnusableInputError("--held-out: give a recording or more after it")
        if argument == "--held-out" or argument.startswith("-"):
            held_out = argument == "--held-out"
        elif held_out and complete[-1] != "--held-out":
            complete.append("--held-out")
        complete.append(argument)
    return complete


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Show the warnings of a reader of recordings or data sheets in one line; a file and line of this program would not help the user."""
    with warnings.catch_warnings():
        shown_by_python = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if category.__name__ in ("RecordingWarning", "DataSheetWarning"):  # by name: importing them takes longer than --help may
                _say(str(message), 0)
            else:
                shown_by_python(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        yield


def _say_usage(error: ClickException) -> int:
    context = getattr(error, "ctx", None)
    where = context.command_path if context is not None else "isocenter"
    lacking = getattr(error, "param", None) if type(error).__name__ == "MissingParameter" else None
    if lacking is not None and lacking.name == "bus" and where.split()[1] in ("run", "home", "move"):
        return _say(f"{where.removeprefix('isocenter').strip()}: --bus is missing: {_BUSES} (see {where} --help)", 2)
    if type(error).__name__ == "NoArgsIsHelpError":  # a group without a command: its message is its whole help
        print(error.format_message(), file=sys.stderr)
        return 2
    command = where.removeprefix("isocenter").strip()
    return _say(f"{command + ': ' if command else ''}{error.format_message()} (see {where} --help)", 2)


def _say_error(error: Exception) -> int:
    if os.environ.get(TRACEBACK_VARIABLE):
        traceback.print_exception(error)
    return _say(*in_one_line(error))


def _say(line: str, status: int) -> int:
    print("isocenter: " + " ".join(line.split("\n")), file=sys.stderr)
    return status
