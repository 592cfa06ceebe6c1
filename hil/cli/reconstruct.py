"""isocenter reconstruct: a volume from a scan's images and the geometry of each exposure."""

from __future__ import annotations

from collections.abc import Callable

import typer

from hil.cli.asking import ask
from hil.cli.options import MachineArgument, load
from hil.cli.paged import PageOption, check_page, write_paged
from hil.cli.shared import asks
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption
from hil.verbs import reconstruct as verb


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="A volume from a scan's images.",
        help="A volume from a scan's images, with the nominal geometry or a calibrated one, and how sharp thin wires are in it."
        " With --neck and --dome the shape of an aneurysm in it, each number with its standard deviation."
        "\n\nExample:  isocenter reconstruct carm wire_scan --lookup roll.lookup.npz -o reconstruction",
    )(reconstruct)


@asks
def reconstruct(
    machine_name: MachineArgument,
    request: Callable[..., verb.ReconstructRequest],
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Read, reconstruct, judge, draw."""
    answer = Answer(json_to)
    asked = request(machine=load(machine_name))
    check_page(page)
    found = ask(verb.answer, asked, answer, told_as=UnusableInputError)
    if page is not None:
        from hil.reports.reconstructed import reconstructed_page

        facts = {"Geometry": found.geometry, "Projections": str(found.projections)}
        write_paged(answer, reconstructed_page(asked.machine, found.volume, found.wires, (asked.scan, asked.out), facts), page)
    answer.write(found)
