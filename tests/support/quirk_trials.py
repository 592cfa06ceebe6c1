"""A drive with a quirk is brought up, homed, run and stopped in lockstep, and what became of it."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from bench_machines import CARM, carm_text_in, homing_at_switch_text

from drivers.errors import KEEP_AWAY, DriverError
from drivers.events import Events
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import BenchError, in_one_line
from hil.faults.budget import standing
from hil.faults.motion import Motion, motion_of
from hil.machine import Machine, machine_from_text
from virtual_bus.faults.condition import InState
from virtual_bus.faults.fault import FaultSetting
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.faults.outcome import outcome_of
from virtual_bus.faults.registry import fault_kinds
from virtual_bus.quirks.quirk import Quirk, QuirkSetting

DRIVE, AXIS = "roll_drive", "roll"
Way = Literal["torque", "velocity", "search"]
WAYS: tuple[Way, ...] = ("torque", "velocity", "search")
"""A run in torque mode, one in velocity mode, and homing by a limit switch, of a drive in velocity mode."""
PHASES = ("session started", "commissioned", "drives enabled", "run begins", "run ends")


@dataclass(frozen=True)
class QuirkOutcome:
    """What became of a trial.

    Parameters
    ----------
    reached : int
        Number of `PHASES` that were reached.
    said : str
        The error, or notes and judgements, in one line; "": nothing.
    ended : bool
        Without an error.
    at_rest : bool
        Whether every axis truly was, and held, at the end.
    furthest : float
        Way of the axis from where the trial began, at most [rad].
    """

    reached: int
    said: str
    ended: bool
    at_rest: bool
    furthest: float


@cache
def machine_for(way: Way) -> Machine:
    """Return the C-arm of a trial."""
    if way == "torque":
        return CARM
    text = carm_text_in("velocity")
    return machine_from_text(homing_at_switch_text(text) if way == "search" else text)


@cache
def motion_for(way: Way) -> Motion:
    """Return what the machine of a trial does."""
    return motion_of(machine_for(way), AXIS, "homing" if way == "search" else "scan")


def tried(quirk: Quirk | None, way: Way, folder: Path, shown_by: str = "", machine: Machine | None = None) -> QuirkOutcome:
    """Try a drive with a quirk, or without one but with the fault that would show it; frames in `frames.log` of the folder.

    The `machine` has another file than that of the way.
    """
    machine, motion, log = machine or machine_for(way), motion_for(way), MotionLog(CARM.axes)
    quirks = () if quirk is None else (QuirkSetting(DRIVE, quirk.name),)
    faults = _faults(quirk.shown_by if quirk is not None else shown_by, way)
    options = BenchOptions("lockstep:", frame_log=folder / "frames.log", quirks=quirks, faults=faults, motion=log)
    events: list[str] = []
    said: Sequence[str] = ()
    ended = True
    try:
        with open_bench(machine, options, motion.start_pose) as bench:
            try:
                notes, judged = motion.make(bench, folder / "run.mf4")
                said = (*notes, *judged)
            finally:
                events = _seen(bench.wiring.link.events)
    except (DriverError, BenchError) as error:
        ended, said = False, (in_one_line(error)[0],)
    true = outcome_of(log, 0.0, [standing(machine, axis) for axis in CARM.axes])
    reached = sum(phase in events for phase in PHASES)
    return QuirkOutcome(reached, "; ".join(said), ended, true.at_rest, true.of(AXIS).furthest)


def _seen(events: Events) -> list[str]:
    return [event.what for event in events.all()]


def _faults(name: str, way: Way) -> tuple[FaultSetting, ...]:
    if not name:
        return ()
    kind, from_s = fault_kinds()[name], 0.0
    state = InState("operational", AXIS)
    if name == "drive_reports_fault":
        state, from_s = (InState("homing", AXIS), 1.5) if way == "search" else (InState("recording"), 0.5)
    return (FaultSetting(name, DRIVE, {each.name: each.default for each in kind.parameters}, state, from_s),)


STOPPED_AT = ("bring-up", "homing", "enabling", "the start of the run", "the run", "the end of the run")
"""Where a trial ended that has reached so many of `PHASES`."""


NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]\d+)?")


def cause(outcome: QuirkOutcome) -> str:
    """Return the first sentence of an error, without its row and its numbers, which are of an instant."""
    return NUMBER.sub("#", re.sub(r"^row \d+: ", "", outcome.said.removeprefix(f"{KEEP_AWAY}: ")).partition("; ")[0])


def verdict(outcome: QuirkOutcome, standard: QuirkOutcome, apart: float) -> str:
    """Return what a drive with a quirk came to, beside one without it in the same trial.

    It is carried where both reach the same phase, come to the same end, with the same error if with one, and their axis goes as far, up to
    `apart`, the tracking error within which either is led [rad].
    """
    if not outcome.at_rest:
        return "not at rest"
    if (outcome.reached, outcome.ended) == (standard.reached, standard.ended):
        if not outcome.ended and cause(outcome) != cause(standard):
            return "ends in another error"
        if abs(outcome.furthest - standard.furthest) > apart:
            return f"moves {outcome.furthest:.2f} rad, not {standard.furthest:.2f}"
        return "carried" if outcome.said == standard.said or not outcome.ended else "carried, with a note"
    if outcome.ended:
        return "carried farther"
    return f"refused at {STOPPED_AT[outcome.reached]}"


def verdict_of(quirk: Quirk, way: Way, outcome: QuirkOutcome) -> str:
    """Return the verdict on a quirk tried in a way."""
    limits = machine_for(way).limits[CARM.axes.index(AXIS)]
    return verdict(outcome, standard(way, quirk.shown_by), limits.tracking_error)


def ways_of(quirk: Quirk) -> tuple[Way, ...]:
    """Return the ways in which a quirk is tried: a run in velocity mode only where units or modes matter."""
    return WAYS if quirk.group in ("units", "modes") else ("torque", "search")


@cache
def standard(way: Way, shown_by: str) -> QuirkOutcome:
    """Return the outcome of a drive without quirks."""
    with tempfile.TemporaryDirectory() as folder:
        return tried(None, way, Path(folder), shown_by)
