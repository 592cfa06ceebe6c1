"""Pages of a fleet: who needs a visit, one machine, one parameter."""

from hil.fleet.pages.write import write_fleet_pages

__all__ = ["write_fleet_pages"]
