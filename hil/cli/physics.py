"""isocenter effects | emulate: the catalogue of effects, and the emulated machine on a bus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import (
    BusOption,
    EffectsOption,
    FaultsOption,
    PoseOption,
    QuirksOption,
    RealTimeOption,
    load,
    parse_pose,
    read_faults,
    read_quirks,
)
from hil.terminal.output import Answer, JsonOption

PORTS = {"node": "node", "IMU": "imu", "I/O": "io", "I/O over RTU": "io_rtu", "panel": "panel"}
"""Names of the ready line's entries in the text output."""


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(
        short_help="The catalogue of physics.",
        help="The catalogue of physics: names, parameters with units and what they are in plain words; with --json also equations, bounds, "
        "and where each may act."
        "\n\nExample:  isocenter effects --json effects.json",
    )(effects)
    app.command(
        short_help="The emulated machine on a bus.",
        help="The emulated machine on a bus, wall clock; or one bare CANopen device of any EDS."
        "\n\nExample:  isocenter emulate carm --bus socketcan:vcan0"
        "\n\nExample:  isocenter emulate carm --bus udp: --io-rtu pty --json -"
        "\n\nExample:  isocenter emulate carm --bus udp: --panel dodecahedron"
        "\n\nExample:  isocenter emulate --eds device.eds --node 5 --bus socketcan:vcan0"
        "\n\nExample:  isocenter emulate carm --eds maker.eds --as drive:roll --bus udp:",
    )(emulate)


def effects(
    json_to: JsonOption = None,
) -> None:
    """Print the catalogue."""
    from virtual_bus.effects import catalogue

    answer = Answer(json_to)
    entries = catalogue()
    for entry in entries:
        described = entry["parameters"]
        assert isinstance(described, list)
        parameters = ", ".join(f"{p['name']} [{p['unit']}]" for p in described)
        answer.say(f"{entry['name']:28s} {parameters}\n    {entry['plain']}")
    answer.write(entries)


def emulate(
    machine_name: Annotated[str | None, typer.Argument(metavar="[M]", help="Machine file, or the name of a shipped one.")] = None,
    bus: BusOption = "socketcan:vcan0",
    eds: Annotated[Path | None, typer.Option("--eds", metavar="FILE", help="Emulate one bare CiA 301 device of this EDS instead.")] = None,
    as_device: Annotated[
        str,
        typer.Option("--as", metavar="ROLE:AXIS", help="The machine instead (carm without M), its drive or encoder of AXIS with that EDS."),
    ] = "",
    node: Annotated[
        int | None,
        typer.Option(
            "--node", metavar="N", help="Its node id, unless given a DCF's own or 1; 255: it waits for one over LSS. Not with --as."
        ),
    ] = None,
    memory: Annotated[
        Path | None, typer.Option("--memory", metavar="FILE", help="Keep in FILE what that device is told to store (1010h, LSS).")
    ] = None,
    effects_file: EffectsOption = None,
    pose: PoseOption = "",
    truth: Annotated[Path | None, typer.Option("--truth", metavar="FILE", help="Write what only the emulator knows (.csv).")] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the sensors' noise.")] = 0,
    noise: Annotated[bool, typer.Option("--noise/--no-noise", help="The sensors' noise.")] = True,
    io_rtu: Annotated[
        str,
        typer.Option(
            "--io-rtu",
            metavar="PORT",
            help="Serve the I/O over Modbus RTU too: pty for a new pseudo terminal, or DEVICE@BAUD, or DEVICE@BAUD,8N1.",
        ),
    ] = "",
    panel: Annotated[
        str, typer.Option("--panel", metavar="SCENE", help="Serve an X-ray panel too, with this scene or marker plate in the beam.")
    ] = "",
    faults: FaultsOption = None,
    quirk: QuirksOption = None,
    real_time: RealTimeOption = True,
    by_the_wall: Annotated[
        bool, typer.Option("--by-the-wall", help="Without SYNCs its devices' timers go by the wall, for `conform` and tools of others.")
    ] = False,
    json_to: JsonOption = None,
) -> None:
    """Run until interrupted."""
    from hil.emulated.machine import emulate_eds, emulate_machine, with_data_sheet

    as_eds = None
    if as_device:
        if eds is None:
            raise typer.BadParameter(f"--as {as_device}: needs --eds FILE, the data sheet of that device")
        if node is not None:
            raise typer.BadParameter(f"--node {node}: with --as {as_device} the machine file says the node id; leave --node out")
        machine_name, as_eds, eds = machine_name or "carm", eds, None
    if (eds is None) == (machine_name is None):
        raise typer.BadParameter("give either a machine M or --eds FILE")
    if eds is not None and by_the_wall:
        raise typer.BadParameter("--by-the-wall: a device of --eds FILE goes by the wall in any case; leave it out")
    if eds is not None and (io_rtu or panel or faults or quirk):
        option = "--panel" if panel else "--io-rtu" if io_rtu else "--faults" if faults else "--quirk"
        raise typer.BadParameter(f"{option}: is a machine's; leave it out with --eds")
    if eds is None and (memory is not None or node is not None):
        raise typer.BadParameter(f"{'--node' if memory is None else '--memory'}: is for a device of --eds FILE")
    answer = Answer(json_to)

    def ready(found: dict[str, object]) -> None:
        ports = "".join(f", {name} {found[key]}" for name, key in PORTS.items() if found.get(key))
        answer.say(f"ready: {found['ready']} on {found['bus']}{ports}; Ctrl-C ends it")
        answer.write_at_once(found)

    if eds is not None:
        emulate_eds(eds, node, bus, ready, memory)
        return
    assert machine_name is not None
    machine = load(machine_name, effects_file)
    if as_eds is not None:
        machine = with_data_sheet(machine, as_device, as_eds)
    start = parse_pose(pose, machine)
    wrong = read_faults(faults, machine, lockstep=False)
    emulate_machine(
        machine,
        bus,
        start,
        seed=seed,
        noise=noise,
        truth=truth,
        punctual=real_time,
        io_rtu=io_rtu,
        panel=panel,
        faults=wrong,
        quirks=read_quirks(quirk, machine),
        by_the_wall=by_the_wall,
        on_ready=ready,
    )
