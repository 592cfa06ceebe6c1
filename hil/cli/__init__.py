"""The command line: `isocenter COMMAND`, one module per group of commands."""

from __future__ import annotations

import sys

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit status; `stop` does not wait for what other commands import."""
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == ["stop"]:
        from hil.cli.stop import plain_order, stop_at_once

        if (order := plain_order(words[1:])) is not None:
            sys.exit(stop_at_once(*order))
    from hil.cli.app import main as any_command

    any_command(words)
