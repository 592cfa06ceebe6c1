"""Machine files: what a machine is, read once and checked at the door."""

from hil.machine.check import check_machine
from hil.machine.finding import Finding
from hil.machine.load import list_shipped, load_machine, machine_from_text
from hil.machine.model import AxisUnits, Geometry, Machine

__all__ = ["AxisUnits", "Finding", "Geometry", "Machine", "check_machine", "list_shipped", "load_machine", "machine_from_text"]
