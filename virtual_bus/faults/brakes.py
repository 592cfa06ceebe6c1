"""Faults of the brakes: the armature that does not follow its coil, the torque it has left, and what its feedback shows."""

from __future__ import annotations

from virtual_bus.faults.fault import FaultKind, Parameter, Trial, Values
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.seam import Undo

STOPPED = (Trial("stop"),)
DELAY = Parameter("delay", "s", 1.0, 0.0, 60.0, "time from the coil to the armature, on top of the usual")


def stays_open(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Keep the armature open once it is open: a spring is broken, or the coil's contactor welded."""
    is_open = machine.brakes.is_open[machine.physics.axes.index(at)]

    def armature(wanted_open: bool) -> bool:
        nonlocal is_open
        is_open = is_open or wanted_open
        return is_open

    return machine.brakes.armatures.add(at, armature)


def stays_closed(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Keep the armature closed: the coil is broken."""
    return machine.brakes.armatures.add(at, lambda wanted_open: False)


def closes_late(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let the armature fall late: residual magnetism, or a suppression diode too many."""
    asked_s: float | None = None

    def armature(wanted_open: bool) -> bool:
        nonlocal asked_s
        if wanted_open:
            asked_s = None
            return True
        if asked_s is None:
            asked_s = machine.time_s if machine.brakes.is_open[machine.physics.axes.index(at)] else machine.time_s - values["delay"]
        return machine.time_s < asked_s + values["delay"]

    return machine.brakes.armatures.add(at, armature)


def weak(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Leave a share of the torque: worn or oily linings."""
    return machine.brakes.torques.add(at, lambda share: share * values["share"])


def drags(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let the open brake rub: the air gap is too small."""
    return machine.brakes.torques.add(at, lambda share: max(share, values["share"]))


def slips_in(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Close the brake though its coil is on: the coil's supply is lost."""
    return stays_closed(machine, at, values)


def feedback_stuck_open(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Show an open brake whatever it does."""
    return _feedback(machine, at, True)


def feedback_stuck_closed(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Show a closed brake whatever it does."""
    return _feedback(machine, at, False)


def _feedback(machine: FaultyMachine, at: str, shown: bool) -> Undo:
    assert machine.faulty_io is not None  # the place was checked: only an I/O has feedback inputs
    return machine.faulty_io.feedbacks.add(at, lambda is_open: shown)


KINDS = (
    FaultKind("brake_stays_open", "The brake does not close any more once it is open; its feedback shows it open.", "brake", "brake",
              stays_open, trials=(*STOPPED, Trial("start")), budget="io_silent"),
    FaultKind("brake_closes_late", "The brake closes later than it should.", "brake", "brake", closes_late, (DELAY,),
              (*STOPPED, Trial("stop", {"delay": 0.3})),
              budget="io_silent"),
    FaultKind("brake_weak", "The closed brake holds a share of its torque only.", "brake", "brake", weak,
              (Parameter("share", "", 0.2, 0.0, 1.0, "of its torque that is left"),), (*STOPPED, Trial("stop", {"share": 0.05})),
              budget="io_silent"),
    FaultKind("brake_drags", "The open brake rubs with a share of its torque.", "brake", "brake", drags,
              (Parameter("share", "", 0.1, 0.0, 1.0, "of its torque with which it rubs"),)),
    FaultKind("brake_closes_in_motion", "The brake closes by itself, its feedback with it.", "brake", "brake", slips_in),
    FaultKind("brake_stays_closed", "The brake never opens; its feedback shows it closed.", "first move", "brake", stays_closed,
              trials=(Trial("start"),)),
    FaultKind("brake_feedback_stuck_open", "The brake's feedback shows it open whatever it does.", "brake", "feedback", feedback_stuck_open,
              trials=(*STOPPED, Trial("start")),
              budget="io_silent"),
    FaultKind("brake_feedback_stuck_closed", "The brake's feedback shows it closed whatever it does.", "brake", "feedback",
              feedback_stuck_closed, trials=(Trial(), Trial("start"))),
)  # fmt: skip
