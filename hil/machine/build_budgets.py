"""Budgets of the file: time and travel to standstill, and what decides them beside the plant."""

from __future__ import annotations

from hil.machine.build import joint_of, require_kind, require_known
from hil.machine.messages import ComplaintError
from hil.machine.schema import JointTable, MachineTable
from hil.machine.schema_budgets import BudgetsTable
from hil.machine.standstill import Stop
from virtual_bus.settings import Tree

QUICK_STOP_DECELERATION = 0x6085


def build_budgets(table: MachineTable, tree: Tree) -> dict[str, dict[str, Stop]]:
    """Build the stated stops, by axis and class of fault."""
    found: dict[str, dict[str, Stop]] = {}
    for axis, budgets in table.budgets.items():
        require_known(axis, table.drives, ("budgets", axis), "axis")
        if table.bus is None:
            raise ComplaintError(("budgets", axis), "a machine without [bus] is not run, so nothing stops it; leave it out")
        found[axis] = {}
        for name in BudgetsTable.model_fields:
            budget = getattr(budgets, name)
            if budget is None:
                continue
            require_kind(budget, "travel", joint_of(axis, table, tree).kind, ("budgets", axis, name))
            if name == "io_silent" and table.bus.io is None:
                raise ComplaintError(("budgets", axis, name), "there is no I/O on the bus; add [bus.io] or leave it out")
            found[axis][name] = Stop(budget.time, budget.travel)
    return found


def brake_delays(table: MachineTable) -> tuple[float, ...]:
    """Return every axis's time from its brake's command to the full effort [s]."""
    return tuple(_joint(axis, table).brake_delay for axis in table.drives)


def quick_stops(table: MachineTable) -> tuple[float | None, ...]:
    """Return every axis's deceleration by its drive's quick stop [rad/s^2 or m/s^2]; None where [limits] does not say it.

    Raises
    ------
    ComplaintError
        A `write` of the drive's node says it, too: the drive would get that one.
    """
    for name, node in table.bus.nodes.items() if table.bus is not None else ():
        limits = table.limits.get(node.axis)
        own = node.role == "drive" and any(write.index == QUICK_STOP_DECELERATION for write in node.write)
        if own and limits is not None and limits.quick_stop is not None:
            right = f"a write of 6085h in bus.nodes.{name} says it, too, and the drive would get that one; leave either out"
            raise ComplaintError(("limits", node.axis, limits.key("quick_stop")), right)
    return tuple(limits.quick_stop if (limits := table.limits.get(axis)) is not None else None for axis in table.drives)


def _joint(axis: str, table: MachineTable) -> JointTable:
    return next(body.joint for body in table.body if body.joint is not None and body.joint.name == table.drives[axis].joint)
