"""isocenter conform: one CANopen node against CiA 301 and its data sheet."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import BusOption
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import progress

if TYPE_CHECKING:
    import can

BITRATE = 1_000_000
LOCKSTEP = "lockstep:"


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="One CANopen node against CiA 301.",
        help="Check one CANopen node against CiA 301 and its data sheet: every object, SDO, NMT, error control, PDOs, SYNC, EMCY, LSS."
        "\n\nNo motion: no controlword is written, nothing that a profile lets an RPDO carry is sent, and a drive under voltage is refused."
        " The node is reset; its settings are put back. On `lockstep:` the bare device of the data sheet is checked."
        "\n\nExample:  isocenter conform --node 5 --eds device.eds --bus socketcan:can0"
        "\n\nExample:  isocenter conform --node 5 --eds device.eds --bus lockstep: --writes --json conform.json",
    )(conform)


def conform(
    eds: Annotated[Path, typer.Option("--eds", metavar="FILE", help="Its data sheet, EDS or DCF.")],
    bus: BusOption,
    node: Annotated[int | None, typer.Option("--node", metavar="N", help="Node id, unless given a DCF's own.")] = None,
    writes: Annotated[
        bool, typer.Option("--writes", help="Also what alters stored and manufacturer's parameters; they are put back as far as possible.")
    ] = False,
    bitrate: Annotated[int, typer.Option(help="Bit rate [bit/s].")] = BITRATE,
    json_to: JsonOption = None,
) -> None:
    """Print the report."""
    from drivers.canopen.eds import load_object_dictionary, own_node_id
    from drivers.errors import ProtocolError
    from hil.conform.all_checks import conform as check
    from hil.conform.check import FAILED
    from hil.conform.report import document, lines, summary
    from hil.errors import BadAnswerError, UnusableInputError

    if node is not None and not 1 <= node <= 127:
        raise UnusableInputError(f"--node {node}: must be 1 to 127")
    try:
        node = own_node_id(eds) if node is None else node
        if node is None:
            raise UnusableInputError(f"--node N: is needed: {eds} names no node id, as a DCF would")
        dictionary = load_object_dictionary(eds, node)
    except ProtocolError as error:
        raise UnusableInputError(str(error)) from None
    answer = Answer(json_to)
    with _opened(bus, bitrate, eds, node) as (wire, now), progress() as bars:
        task = bars.add_task("checks", total=None)
        found = check(wire, now, node, dictionary, writes=writes, follow=lambda done, of: bars.update(task, completed=done, total=of))
    for line in lines(found):
        answer.say(line)
    answer.write({"eds": str(eds), "bus": bus, "writes": writes} | document(found))
    if found.count(FAILED):
        raise BadAnswerError(summary(found))


@contextlib.contextmanager
def _opened(bus: str, bitrate: int, eds: Path, node: int) -> Iterator[tuple[can.BusABC, Callable[[], float]]]:
    """Open the bus, with its time: the wall's, or that of a bare device in this process."""
    if bus == LOCKSTEP:
        from virtual_bus.canopen.bare import BareMachine
        from virtual_bus.canopen.device_bus import DeviceBus

        device = DeviceBus(BareMachine(eds, node))
        try:
            yield device, device.now
        finally:
            device.shutdown()
    else:
        from drivers.bus_url import open_bus

        with open_bus(bus, bitrate, stamped=True) as wire:
            yield wire, time.time
