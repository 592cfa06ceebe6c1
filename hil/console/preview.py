"""An experiment file planned and not run: how long it takes, its predicted peak command, or why it is refused."""

from __future__ import annotations

from typing import Any

from hil.errors import UnusableInputError, in_one_line
from hil.experiments import Plan, experiment_from_text
from hil.machine import Machine, load_machine
from virtual_bus.physics import Physics

PEAK = "predicted peak command"


def preview(name: str, text: str) -> dict[str, Any]:
    """Plan an experiment on a machine.

    Returns
    -------
    dict
        `recordings`, each with rows, seconds and notes; or `refused`, one line that says why.
    """
    try:
        machine = load_machine(name)
        plans = experiment_from_text(text, machine).plans(machine)
    except (UnusableInputError, ValueError) as error:
        return {"refused": in_one_line(error)[0]}
    rate_Hz = machine.sample_rate_Hz
    return {"recordings": [{"rows": plan.rows, "seconds": plan.rows / rate_Hz, "notes": _notes(machine, plan)} for plan in plans]}


def _notes(machine: Machine, plan: Plan) -> list[str]:
    """Return the plan's notes, with the predicted peak command also where only a pose is held."""
    if any(note.startswith(PEAK) for note in plan.notes):
        return list(plan.notes)
    holding = Physics(machine.plant, noise=False).holding_effort(plan.start_pose)
    peaks = (
        f"{controller.axis} {abs(effort):.2f} of {controller.limit:g} {units.effort}"
        for effort, controller, units in zip(holding, machine.controllers, machine.units, strict=True)
    )
    return [*plan.notes, f"{PEAK}: {', '.join(peaks)}"]
