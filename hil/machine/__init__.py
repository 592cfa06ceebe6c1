"""Machine files: what a machine is, read once and checked at the door."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.machine.finding import Finding
from hil.machine.load import list_shipped, load_machine, machine_from_text
from hil.machine.machine import AxisUnits, Geometry, Machine

if TYPE_CHECKING:
    from hil.machine.check import check_machine

__all__ = ["AxisUnits", "Finding", "Geometry", "Machine", "check_machine", "list_shipped", "load_machine", "machine_from_text"]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - a module's attribute
    """Import the check when it is asked for: SciPy's signals and the CAN libraries take longer than reading a machine file."""
    if name == "check_machine":
        from hil.machine.check import check_machine

        return check_machine
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
