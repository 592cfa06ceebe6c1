"""Can the budgets of a machine file be met: time and travel to standstill of every class of fault, at every pose."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.canopen.eds import load_object_dictionary
from drivers.canopen.heartbeat_consumer import HEARTBEAT_TOLERANCE
from drivers.canopen.ramps import QUICK_STOP
from drivers.canopen.units import acceleration_units, in_data_sheet
from drivers.errors import ConfigurationRefusedError, ProtocolError
from drivers.settings import LED_SPEED_MARGIN, BusSettings, Node
from hil.machine.finding import Finding, PoseResult, shown_pose
from hil.machine.machine import Machine
from hil.machine.standstill import CLASSES, AxisFacts, Stop
from virtual_bus.linear.lateness import drives_late_s, hanging_inertia

WIDEST = 1.5
"""Multiple of what is computed that a budget may be: what the closed forms leave out is less, and a wider one promises nothing."""


def budgets(machine: Machine, results: Sequence[PoseResult]) -> list[Finding]:
    """Return a finding per axis and class: what is stated, what is computed at the worst pose, and whether both fit."""
    found = []
    for number, axis in enumerate(machine.axes):
        stated = machine.budgets.get(axis, {})
        facts = axis_facts(machine, number, results)
        for name, stop_of in CLASSES.items():
            if name == "io_silent" and (machine.bus is None or machine.bus.io is None):
                continue
            stops = [(stop_of(fact), pose) for fact, pose in facts]
            worst, pose = max(stops, key=lambda entry: (entry[0].travel, entry[0].time_s))
            longest = max(stop.time_s for stop, _ in stops)
            found.append(_finding(machine, axis, name, stated.get(name), Stop(longest, worst.travel), pose))
    return found


def axis_facts(machine: Machine, number: int, results: Sequence[PoseResult]) -> list[tuple[AxisFacts, tuple[float, ...]]]:
    """Return the facts of an axis for every pose of the others, with the greatest load and the extreme inertias that it meets on its way.

    The pose of each is the one with the greatest load.
    """
    bus = machine.bus
    assert bus is not None
    limit, drive = machine.limits[number], machine.plant.drives[number]
    joint = machine.plant.tree.joints[machine.plant.tree.joint_index(drive.joint)]
    node = next(node for node in bus.nodes if node.role == "drive" and node.axis == machine.axes[number])
    scale = drive.constant * drive.ratio
    by_others: dict[tuple[float, ...], list[PoseResult]] = {}
    for result in results:
        by_others.setdefault((*result.pose[:number], *result.pose[number + 1 :]), []).append(result)
    found = []
    late_s = float(drives_late_s(machine.plant)[number])
    hanging = float(hanging_inertia(machine.plant)[number])  # a fast push leaves it behind, a ramp takes it along
    for group in by_others.values():
        heaviest = max(group, key=lambda result: abs(result.holding[number]))
        inertias = [float(result.inertia[number]) for result in group]
        facts = AxisFacts(
            speed=limit.speed,
            watched_speed=LED_SPEED_MARGIN * limit.speed,
            acceleration=limit.acceleration,
            tracking_error=limit.tracking_error,
            gravity=abs(float(heaviest.holding[number])) * scale,
            inertia=(min(inertias), max(inertias) + hanging),
            drive_effort=drive.limit * scale,
            quick_stop=quick_stop(machine, number, node),
            brake_effort=joint.brake_effort,
            brake_delay_s=machine.brake_delay_s[number],
            period_s=bus.sync_period_s,
            stale_s=machine.stale_ticks * bus.sync_period_s,
            inputs_s=bus.io.poll_period_s if bus.io is not None else 0.0,
            io_silent_s=bus.io.stale_after_s if bus.io is not None else math.inf,
            node_silent_s=_silent_s(node.heartbeat_period_s, bus),
            bench_silent_s=HEARTBEAT_TOLERANCE * bus.master_heartbeat_period_s or math.inf,
            drive_late_s=late_s,
        )
        found.append((facts, heaviest.pose))
    return found


def quick_stop(machine: Machine, number: int, node: Node) -> float:
    """Return the deceleration of a drive's quick stop [rad/s^2 or m/s^2]; 0 where nobody says it.

    It is the limit's own where the machine file has it, as far as the drive takes it, else object 6085h in the drive's unit: as a node's
    `write` says it, or the EDS.
    """
    assert machine.bus is not None
    stated, scaling = machine.quick_stop[number], machine.bus.scalings[number]
    try:
        dictionary = load_object_dictionary(node.eds, node.node_id)
        read = in_data_sheet(dictionary, node.writes)
        in_si = scaling.position_resolution / acceleration_units(read, scaling, node.name)  # of one of the drive's units
    except (OSError, ProtocolError, ConfigurationRefusedError):
        return stated or 0.0
    if stated is None:
        return (read(QUICK_STOP, 0) or 0) * in_si
    variable = dictionary.get_variable(QUICK_STOP)
    return stated if variable is None or variable.max is None else min(stated, variable.max * in_si)


def _silent_s(heartbeat_s: float, bus: BusSettings) -> float:
    """Return how long a node is silent at most before it is missed: one node's heartbeat is looked at in a tick."""
    return HEARTBEAT_TOLERANCE * heartbeat_s + len(bus.nodes) * bus.sync_period_s if heartbeat_s > 0.0 else math.inf


def _finding(machine: Machine, axis: str, name: str, stated: Stop | None, computed: Stop, pose: tuple[float, ...]) -> Finding:
    unit, factor = ("deg", math.degrees(1.0)) if machine.units[machine.axis_index(axis)].position == "rad" else ("m", 1.0)

    def shown(stop: Stop) -> str:
        return f"{stop.time_s:6.3f} s {stop.travel * factor:8.4g} {unit}"

    told = f"{axis:12s} {name:13s} stated {shown(stated) if stated else f'{chr(45):>8s} {chr(45):>12s}'}, computed {shown(computed)}"
    text = f"{told} at {shown_pose(machine, pose)}"
    values = {
        "axis": axis,
        "class": name,
        "pose": pose,
        "time_s": computed.time_s,
        "travel": computed.travel,
        "stated_time_s": None if stated is None else stated.time_s,
        "stated_travel": None if stated is None else stated.travel,
    }
    if stated is None:
        return Finding("budget", True, text, values)
    problems = []
    for what, says, takes in (("time", stated.time_s, computed.time_s), ("travel", stated.travel, computed.travel)):
        if not np.isfinite(takes):
            problems.append("it does not come to rest")
            break
        if says < takes:
            problems.append(f"its {what} cannot be met")
        elif says > WIDEST * takes:
            problems.append(f"its {what} is wider than {WIDEST:g} times what is computed")
    return Finding("budget", not problems, text + (f": {', '.join(problems)}" if problems else ""), values)
