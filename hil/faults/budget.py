"""Did a stop keep to the budget that the machine file states for its class of fault."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.canopen.quick_stop import STANDING_SHARE
from hil.faults.trials import FaultTrial
from hil.machine import Machine
from virtual_bus.faults.fault import Budget
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.faults.outcome import standstill_of
from virtual_bus.faults.registry import fault_kinds

DEPARTING: tuple[Budget, ...] = ("torque_lost", "runaway")
"""Classes whose budget counts from where tracking error or speed show the fault, and from the reference."""


@dataclass(frozen=True)
class BudgetUse:
    """What a stop took of its budget.

    Parameters
    ----------
    name : str
        Class of the budget.
    time_s, travel : float
        To standstill [s; rad or m].
    allowed_s, allowed_travel : float
        As the machine file states them.
    """

    name: str
    time_s: float
    travel: float
    allowed_s: float
    allowed_travel: float

    @property
    def kept(self) -> bool:
        """Whether both are kept."""
        return self.time_s <= self.allowed_s and self.travel <= self.allowed_travel


def standing(machine: Machine, axis: str) -> float:
    """Return how far an axis may swing that stands, as the stop itself judges it [rad or m]."""
    return STANDING_SHARE * machine.limits[machine.axis_index(axis)].tracking_error


def budget_use(machine: Machine, axis: str, trial: FaultTrial, log: MotionLog, onset_s: float) -> BudgetUse | None:
    """Return what the stop of a trial took; None where the machine file states no budget for its class, or drive and brake fail both.

    Time counts from the fault in a sweep and at a settled axis, and from the stop where the fault shows by what the axis then does, or
    only once the run needs what it took away.
    """
    kind = fault_kinds()[trial.kind]
    if trial.brake != "good" and kind.group != "bus":
        return None
    name: Budget = "bench_silent" if trial.killed else "io_silent" if trial.brake == "absent" else kind.budget
    stated = machine.budgets.get(axis, {}).get(name)
    if stated is None:
        return None
    departs = name in DEPARTING
    from_stop = departs or kind.latent or trial.during not in ("sweep", "settled", "stop")
    assert machine.bus is not None  # a machine without one has no faults
    moved = machine.bus.homings[machine.axis_index(axis)].direction_check_travel
    took = standstill_of(log, axis, onset_s, moved, from_stop=from_stop)
    before = machine.limits[machine.axis_index(axis)].tracking_error if departs else 0.0
    return BudgetUse(name, took.time_s, took.travel + before, stated.time_s, stated.travel)
