"""The trials of the table: every fault at every place of an axis that moves, at the time at which its declaration says."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from hil.errors import UnusableInputError
from hil.faults.motion import MotionName, motion_of
from hil.machine import Machine
from hil.machine.faults_file import places_of
from virtual_bus.faults.condition import Comparison, Condition, InState
from virtual_bus.faults.fault import Brake, FaultKind, FaultSetting, Group, Phase, Trial
from virtual_bus.faults.registry import fault_kinds

FAST_SHARE = 0.9
"""Share of the motion's greatest speed from which on a fault of the sweep begins."""
SLOW_SHARE = 0.5
"""The same for what a stop finds already broken, in a motion without a standstill before it."""

KILLED_AFTER_S = 0.02
"""From a fault to the death of all processes, in rows that have both: what a tick shows has been acted on by then, and no stop is over."""
KILLED = (("bus_silent", "bus"), ("io_hangs", "io"))
"""What the machine sees of dead processes: nothing comes, and the I/O's outputs stay as they are until its watchdog drops them."""

_STATE_OF: dict[Phase, str] = {
    "operational": "operational",
    "first move": "enabled",
    "homing": "homing",
    "settled": "settled",
    "stop": "settled",
}
_BRAKE_FAULTS: dict[Brake, tuple[str, dict[str, float]]] = {
    "weak": ("brake_weak", {"share": 0.2}),
    "slipping": ("brake_weak", {"share": 0.1}),
    "absent": ("brake_stays_open", {}),
}
_FROZEN = {"drive": "motor_encoder_frozen", "encoder": "link_encoder_frozen"}
"""What makes an axis blind, by the role of the node."""
_NEEDS_METHOD = {"limit_switch_stuck": (17, 18), "index_pulse_missing": (33, 34), "homing_wrong_direction": (17, 18, 33, 34)}
"""Faults that only show where the axis is homed by one of these methods."""


@dataclass(frozen=True)
class FaultTrial:
    """One row of the table.

    Parameters
    ----------
    name : str
        Unique in the table: the fault, its place, its phase, and the parameters that are not the defaults.
    kind, at, group : of the fault
    during : Phase
        Of the run.
    settings : tuple of FaultSetting
        The fault, and behind it what ends the run where its phase asks for a stop.
    brake : Brake
        The axis's brake fails as well: where the drive does not hold, an axis whose brake is absent cannot be held.
    killed : bool
        All processes of the bench are killed afterwards.
    """

    name: str
    kind: str
    at: str
    group: Group
    during: Phase
    settings: tuple[FaultSetting, ...]
    brake: Brake = "good"
    killed: bool = False


def trials(machine: Machine, axis: str, only: Collection[str] = (), motion: MotionName = "scan") -> tuple[FaultTrial, ...]:
    """Return the rows of the table for a machine whose `axis` moves.

    Parameters
    ----------
    machine : Machine
    axis : str
    only : collection of str
        Names of faults or of rows; all unless given.
    motion : str
        What moves the axis. A move and a homing run have no standstill under control before them: faults that come in one are left out.

    Raises
    ------
    UnusableInputError
        One of `only` is neither, or no row is left.
    """
    speed = motion_of(machine, axis, motion).speed
    rows = [
        row
        for kind in fault_kinds().values()
        if _shows(kind, machine, axis)
        for row in _rows(kind, machine, _at(kind, machine, axis), axis, speed, motion)
    ]
    unknown = [name for name in only if not any(name in (row.name, row.kind) for row in rows)]
    if unknown:
        known = "this machine cannot have it" if unknown[0] in fault_kinds() else "`isocenter faults list` names all"
        raise UnusableInputError(f"--only {unknown[0]}: no such fault in the table of {machine.name}: {known}")
    return tuple(row for row in rows if not only or row.kind in only or row.name in only)


def _shows(kind: FaultKind, machine: Machine, axis: str) -> bool:
    methods = _NEEDS_METHOD.get(kind.name)
    assert machine.bus is not None
    return kind.begin is not None and (methods is None or machine.bus.homings[machine.axis_index(axis)].method in methods)


def _at(kind: FaultKind, machine: Machine, axis: str) -> tuple[str, ...]:
    """Return the places of an axis for a fault: its drive, its encoder, itself, or what there is once."""
    places = places_of(machine)
    assert machine.bus is not None
    here = {node.name for node in machine.bus.nodes if node.axis == axis} | {axis, "imu", "io", "bus", machine.bus.sync_producer}
    return tuple(place for place in places.of(kind.at) if place in here)


def _rows(kind: FaultKind, machine: Machine, at: tuple[str, ...], axis: str, speed: float, motion: MotionName) -> Iterator[FaultTrial]:
    places = places_of(machine)
    for place in at:
        for trial in kind.trials:
            if (trial.during == "stop" and not places.io) or (trial.brake != "good" and axis not in places.of("brake")):
                continue
            if motion == "scan" or trial.during != "settled":
                yield _row(kind, machine, place, trial, axis, speed, stands=motion == "scan")


def _row(kind: FaultKind, machine: Machine, at: str, trial: Trial, axis: str, speed: float, *, stands: bool) -> FaultTrial:
    assert machine.bus is not None
    values = {parameter.name: trial.values.get(parameter.name, parameter.default) for parameter in kind.parameters}
    lasting = float("inf") if trial.for_s is None else trial.for_s
    settings = [FaultSetting(kind.name, at, values, _when(trial.during, axis, speed, stands=stands), 0.0, lasting)]
    if trial.during == "stop":
        settings.append(FaultSetting("hold_to_run_released", "io", {}, _when("sweep", axis, speed, stands=stands)))
    if trial.killed:
        there = [(dead, place) for dead, place in KILLED if place != "io" or machine.bus.io is not None]
        settings += [FaultSetting(dead, place, {}, settings[0].when, KILLED_AFTER_S) for dead, place in there]
    if trial.blind:
        nodes = [node for node in machine.bus.nodes if node.axis == axis and node.role in _FROZEN]
        settings += [FaultSetting(_FROZEN[node.role], node.name, {}, settings[0].when) for node in nodes]
    if trial.brake != "good":
        name, fails = _BRAKE_FAULTS[trial.brake]
        settings.insert(0, FaultSetting(name, axis, fails, _when("stop", axis, speed, stands=stands)))
    more = [f"{name}={int(value):04X}h" if name == "index" else f"{name}={value:g}" for name, value in trial.values.items()]
    more += [] if trial.for_s is None else [f"for_s={trial.for_s:g}"]
    more += {"good": [], "weak": ["weak_brake"], "slipping": ["slipping_brake"], "absent": ["without_brake"]}[trial.brake]
    more += ["encoders_frozen"] if trial.blind else []
    more += ["killed"] if trial.killed else []
    name = "/".join((kind.name, at, trial.during.replace(" ", "_"), *more))
    return FaultTrial(name, kind.name, at, kind.group, trial.during, tuple(settings), trial.brake, trial.killed)


def _when(during: Phase, axis: str, speed: float, *, stands: bool) -> Condition | None:
    if during == "start":
        return None
    if during == "sweep" or (during == "stop" and not stands):
        return Comparison(f"speed_{axis}", True, ">", (FAST_SHARE if during == "sweep" else SLOW_SHARE) * speed)
    return InState(_STATE_OF[during], axis)


def swept_axis(machine: Machine, wanted: str = "") -> str:
    """Return the axis that sweeps: the one that is asked for, or the machine's last, which the others carry.

    Raises
    ------
    UnusableInputError
        There is no such axis.
    """
    if wanted and wanted not in machine.axes:
        raise UnusableInputError(f"--axis {wanted}: {machine.name} has {', '.join(machine.axes)}")
    return wanted or machine.axes[-1]
