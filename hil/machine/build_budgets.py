"""Budgets of the file: time and travel to standstill, and what decides them beside the plant."""

from __future__ import annotations

from hil.machine.build import joint_of, require_kind, require_known
from hil.machine.messages import ComplaintError
from hil.machine.schema import JointTable, MachineTable
from hil.machine.schema_budgets import BudgetsTable
from hil.machine.standstill import Stop
from virtual_bus.settings import Tree


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
    """Return every axis's deceleration by its drive's quick stop [rad/s^2 or m/s^2]; None where [limits] does not say it."""
    return tuple(limits.quick_stop if (limits := table.limits.get(axis)) is not None else None for axis in table.drives)


def _joint(axis: str, table: MachineTable) -> JointTable:
    return next(body.joint for body in table.body if body.joint is not None and body.joint.name == table.drives[axis].joint)
