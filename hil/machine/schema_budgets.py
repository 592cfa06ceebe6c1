"""The machine file's [budgets] tables: time and travel to standstill that each class of fault may take."""

from __future__ import annotations

from typing import Annotated

from hil.machine.table import Positive, Table
from hil.machine.units import Quantity


class BudgetTable(Table):
    """Tables `[budgets.AXIS.CLASS]`: what one class of faults may take, at every pose and from the speed limit."""

    time: Annotated[Positive, Quantity("time")]
    """Time to standstill."""
    travel: Annotated[Positive, Quantity("angle", "length")]
    """Travel to standstill."""


class BudgetsTable(Table):
    """Table `[budgets.AXIS]`: time and travel from a fault to standstill, by class of fault.

    `isocenter machine check` computes from masses, gravity, brakes and the drives' quick stop what each class takes at its worst pose. It
    refuses a budget that cannot be met, and one wider than 1.5 times what is computed. Time and travel count from the fault. Where
    tracking error or speed show it, time counts from there, and travel from the reference.
    """

    asked: BudgetTable | None = None
    """Hold-to-run, door, Ctrl-C: seen within `poll_period` and a tick; quick stop and brake."""
    position_lost: BudgetTable | None = None
    """The motor side's position is missing for more than `stale_ticks`; quick stop and brake."""
    drive_fault: BudgetTable | None = None
    """The drive reports a fault, its torque gone; the brake alone."""
    node_silent: BudgetTable | None = None
    """The drive's heartbeat is missing for 2.5 periods, its torque gone; the brake alone."""
    torque_lost: BudgetTable | None = None
    """The torque is gone and nothing says so but the tracking error; the brake alone."""
    runaway: BudgetTable | None = None
    """The drive pushes with all it has, and against the brake too."""
    io_silent: BudgetTable | None = None
    """The I/O does not answer for `stale_after`; the drive's quick stop alone."""
    bench_silent: BudgetTable | None = None
    """The bench's heartbeat is missing for 2.5 periods; the drive's quick stop alone."""
