"""What a run with faults says of them: when each began, and what became of the machine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hil.terminal.output import Answer

if TYPE_CHECKING:
    from hil.machine import Machine
    from virtual_bus.faults.fault import FaultSetting
    from virtual_bus.faults.motion_log import MotionLog
    from virtual_bus.faults.outcome import FaultOutcome
    from virtual_bus.faults.schedule import FaultEvent


@dataclass
class Told:
    """The faults of a run, its true motion, and when each fault came."""

    machine: Machine
    faults: Sequence[FaultSetting]
    motion: MotionLog | None
    events: list[FaultEvent] = field(default_factory=list)

    @staticmethod
    def of(faults: Sequence[FaultSetting], machine: Machine) -> Told:
        """Return what takes the motion of a run with these faults; without any, nothing is taken."""
        from virtual_bus.faults.motion_log import MotionLog

        return Told(machine, faults, MotionLog(machine.axes) if faults else None)

    def outcome(self) -> FaultOutcome | None:
        """Return what became of the machine since its last fault began; None: none began."""
        from hil.faults.budget import standing
        from virtual_bus.faults.outcome import outcome_of

        onsets = [event.time_s for event in self.events if event.begins]
        if not onsets or self.motion is None or not len(self.motion):
            return None
        stands = [standing(self.machine, axis) for axis in self.machine.axes]
        return outcome_of(self.motion, min(max(onsets), float(self.motion.time_s[-1])), stands)

    def say(self, answer: Answer) -> None:
        """Print when each fault began and ended, and a line for every axis."""
        if not self.faults:
            return
        for event in self.events:
            answer.say(f"fault: {event.label} {'begins' if event.begins else 'ends'} at {event.time_s:.3f} s of the machine's time")
        begun = {event.label for event in self.events if event.begins}
        for fault in self.faults:
            if fault.label not in begun:
                answer.say(f"fault: {fault.label} never began: its time or condition did not come")
        outcome = self.outcome()
        for axis in outcome.axes if outcome is not None else ():
            unit = self.machine.units[self.machine.axis_index(axis.axis)].position
            when = f"at rest {axis.rest_s:.3f} s after it, {axis.ending}" if math.isfinite(axis.rest_s) else "still moving"
            answer.say(f"{axis.axis}: {when}; travel {axis.travel:.4f} {unit}, fastest {axis.fastest:.3f} {unit}/s")

    def document(self) -> dict[str, object]:
        """Return the same as data."""
        return {"events": self.events, "outcome": self.outcome()}
