"""isocenter bench: the page on which a machine is watched, commissioned, run and stopped."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import BusOption, ImuOption, IoOption, MachineOption, RealTimeOption, load, shipped_names
from hil.terminal.output import Answer, JsonOption

EMULATED = "lockstep:"
ALONE = "carm"
"""The machine that is emulated where none is named."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="A page to watch, commission, run and stop a machine.",
        help="Serve a page on this computer and open it: live scope, guided commissioning, experiments, state of every device, and a stop"
        " button that asks the supervisor, as isocenter stop does. Alone it starts the emulated C-arm; -m and -b name a real machine."
        " No substitute for an emergency stop."
        "\n\nExample:  isocenter bench",
    )(bench)


def bench(
    machine_named: Annotated[
        str, typer.Argument(metavar="[M]", help="The machine, as --machine names it.", autocompletion=shipped_names, show_default=False)
    ] = "",
    machine_option: MachineOption = "",
    bus: BusOption = EMULATED,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for recordings and answers.")] = Path("isocenter-bench"),
    host: Annotated[str, typer.Option("--host", help="Address to listen at; nothing that goes to others is encrypted.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=0, max=65_535, help="Port to listen at; 0: any that is free.")] = 8710,
    token: Annotated[
        str,
        typer.Option(
            "--token",
            metavar="TEXT",
            envvar="ISOCENTER_BENCH_TOKEN",
            help="What a browser brings once, for a session, in the address that is printed; drawn by chance unless given.",
        ),
    ] = "",
    imu: ImuOption = "",
    io: IoOption = "",
    real_time: RealTimeOption = True,
    live: Annotated[
        bool,
        typer.Option(
            "--live/--no-live",
            help="Stay connected between runs, with the state of every axis and jog buttons; takes half a processor.",
        ),
    ] = True,
    opens: Annotated[
        bool,
        typer.Option(
            "--open/--no-open",
            help="Open the page of an emulated machine in this desktop's browser. A real one's address is printed alone: while a browser"
            " starts, other users of this computer may read it.",
        ),
    ] = True,
    json_to: JsonOption = None,
) -> None:
    """Say which address to open, open it, and serve it."""
    from drivers.bus_url import parse_bus_url
    from hil.cli.options import folder_can_be_written
    from hil.errors import UnusableInputError

    if not hasattr(os, "pread"):
        raise UnusableInputError("isocenter bench: its stop reaches a run by ways that this system lacks; use Linux or macOS")
    from hil.console.admission import drawn_token
    from hil.console.facts import facts_of
    from hil.console.serve import Place, serve

    emulated = bus.startswith(EMULATED)
    machine_name = _machine_named(machine_named, machine_option, emulated)
    machine = load(machine_name)
    if machine.bus is None:
        raise UnusableInputError(f"{machine.name}: its file has no [bus], so it can be simulated, compared and diagnosed, not run")
    if not machine.controllers:
        raise UnusableInputError(f"{machine.name}: its file has no [controller], so its loop cannot be closed")
    if not emulated:
        parse_bus_url(bus)
    place = Place(host, port, token or drawn_token())
    place.check()
    folder_can_be_written(out)
    out.mkdir(parents=True, exist_ok=True)
    answer = Answer(json_to)
    name = str(Path(machine_name).absolute()) if Path(machine_name).is_file() else machine_name

    def ready(address: str) -> None:
        what = "EMULATED, in the runs' own process" if emulated else f"on {bus}"
        answer.say(f"{machine.name}, {what}: open {address}")
        answer.say(f"recordings go to {out}; Ctrl-C stops what runs, and ends")
        answer.write_at_once({"address": address, "machine": machine.name, "bus": bus, "folder": out})
        if emulated and opens:
            _open(address)

    serve(facts_of(name, machine, bus, imu, io, real_time, live), out.absolute(), place, ready)


def _machine_named(argument: str, option: str, emulated: bool) -> str:
    """Return which machine is meant.

    Raises
    ------
    UnusableInputError
        Two are named, or none is of a real bus.
    """
    from hil.errors import UnusableInputError

    if argument and option and argument != option:
        raise UnusableInputError(f"bench: both {argument} and --machine {option} are named; name one")
    if not (argument or option or emulated):
        raise UnusableInputError("bench: which machine is on this bus? Name it, as in `isocenter bench -m mine.toml -b socketcan:can0`")
    return argument or option or ALONE


def _open(address: str) -> None:
    """Open a page in the browser of this desktop, where there is one; a browser in the terminal would take it from the bench."""
    import webbrowser

    desktop = sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
    if desktop:
        webbrowser.open(address)
