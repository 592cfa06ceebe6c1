"""Machine files: what a machine is, read once and checked at the door."""

from hil.machine.load import list_shipped, load_machine, machine_from_text
from hil.machine.model import AxisUnits, Geometry, Machine

__all__ = ["AxisUnits", "Geometry", "Machine", "list_shipped", "load_machine", "machine_from_text"]
