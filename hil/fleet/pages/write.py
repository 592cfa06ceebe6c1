"""All pages of a fleet into a folder."""

from __future__ import annotations

from pathlib import Path

from hil.fleet.change import FleetChange
from hil.fleet.pages.fleet import fleet_page, page_of_machine, page_of_parameter
from hil.fleet.pages.tracks import machine_page, parameter_page
from hil.pages import write_page

FLEET = "fleet.html"


def write_fleet_pages(found: FleetChange, store: str, folder: Path) -> Path:
    """Write the fleet's page and one of every machine and parameter; return the fleet's."""
    for machine in found.tracks.machines:
        write_page(machine_page(found, machine, store), folder / page_of_machine(machine))
    for parameter in found.tracks.parameters:
        write_page(parameter_page(found, parameter, store), folder / page_of_parameter(parameter))
    return write_page(fleet_page(found, store), folder / FLEET)
