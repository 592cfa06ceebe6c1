"""isocenter bench: the page on which a machine is watched, commissioned, run and stopped."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import BusOption, ImuOption, IoOption, MachineArgument, RealTimeOption, load
from hil.terminal.output import Answer, JsonOption


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="A page to watch, commission, run and stop a machine.",
        help="Serve a page on this computer: live scope, guided commissioning, experiments, state of every device, and a stop button that"
        " asks the supervisor, as isocenter stop does. Needs the extra bench. No substitute for an emergency stop."
        "\n\nExample:  isocenter bench carm --bus lockstep:",
    )(bench)


def bench(
    machine_name: MachineArgument,
    bus: BusOption,
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
    json_to: JsonOption = None,
) -> None:
    """Say which address to open, and serve it."""
    from drivers.bus_url import parse_bus_url
    from hil.cli.options import folder_can_be_written
    from hil.errors import UnusableInputError
    from hil.extras import extra_package

    if not hasattr(os, "pread"):
        raise UnusableInputError("isocenter bench: its stop reaches a run by ways that this system lacks; use Linux or macOS")
    for package in ("starlette", "uvicorn", "websockets"):
        extra_package(package, "pages of the bench")
    from hil.console.admission import drawn_token
    from hil.console.facts import facts_of
    from hil.console.serve import Place, serve

    machine = load(machine_name)
    if machine.bus is None:
        raise UnusableInputError(f"{machine.name}: its file has no [bus], so it can be simulated, compared and diagnosed, not run")
    if not machine.controllers:
        raise UnusableInputError(f"{machine.name}: its file has no [controller], so its loop cannot be closed")
    if not bus.startswith("lockstep:"):
        parse_bus_url(bus)
    place = Place(host, port, token or drawn_token())
    place.check()
    folder_can_be_written(out)
    out.mkdir(parents=True, exist_ok=True)
    answer = Answer(json_to)
    name = str(Path(machine_name).absolute()) if Path(machine_name).is_file() else machine_name

    def ready(address: str) -> None:
        answer.say(f"{machine.name} on {bus}: open {address}")
        answer.say(f"recordings go to {out}; Ctrl-C stops what runs, and ends")
        answer.write_at_once({"address": address, "machine": machine.name, "bus": bus, "folder": out})

    serve(facts_of(name, machine, bus, imu, io, real_time), out.absolute(), place, ready)
