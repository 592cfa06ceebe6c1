"""Entry point: every expected error becomes one line and an exit status, never a traceback."""

from __future__ import annotations

import os
import sys

import click
import typer

app = typer.Typer(
    name="isocenter",
    help="Hardware-in-the-loop controller stack for an X-ray C-arm.\n\nStart with:  isocenter demo",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


def _known_errors() -> tuple[type[Exception], ...]:
    from controllers.errors import ControlError
    from drivers.errors import DriverError
    from hil.errors import BenchError
    from virtual_bus.errors import EmulatorError

    return (BenchError, DriverError, EmulatorError, ControlError)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit status: 0 done, 1 a bad answer, 2 unusable input."""
    from hil.cli import register

    register.commands(app)
    try:
        status = app(args=arguments, standalone_mode=False) or 0
    except click.exceptions.Exit as leave:
        status = leave.exit_code
    except click.Abort:
        status = _say("interrupted", 1)
    except click.ClickException as error:
        where = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "isocenter"
        status = _say(f"{where}: {error.format_message()} (see {where} --help)", 2)
    except KeyboardInterrupt:
        status = _say("interrupted", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    except _known_errors() as error:
        status = _say(str(error), getattr(error, "exit_status", 1))
    except OSError as error:
        status = _say(_os_error_line(error), 2)
    sys.exit(status)


def _os_error_line(error: OSError) -> str:
    place = f"{error.filename}: " if error.filename else ""
    return f"{place}{error.strerror or error}"


def _say(line: str, status: int) -> int:
    print("isocenter: " + " ".join(line.split("\n")), file=sys.stderr)
    return status
