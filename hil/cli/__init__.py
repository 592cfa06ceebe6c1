"""The command line: `isocenter COMMAND`, one module per group of commands."""

from hil.cli.app import main

__all__ = ["main"]
