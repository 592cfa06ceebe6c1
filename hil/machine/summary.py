"""What a machine file says, for a person and for a program."""

from __future__ import annotations

import math
from typing import Any

from hil.machine.machine import Machine
from virtual_bus.effects.binding import as_entries


def machine_document(machine: Machine) -> dict[str, Any]:
    """Return the machine in SI and the drives' units, as plain values."""
    plant = machine.plant
    return {
        "name": machine.name,
        "description": machine.description,
        "hash": machine.hash,
        "axes": [
            {
                "name": units.axis,
                "position_unit": units.position,
                "effort_unit": units.effort,
                "joint": drive.joint,
                "effort_per_unit": drive.constant * drive.ratio,
                "effort_limit": drive.limit,
                "target_resolution": drive.resolution,
                "range": [limit.lower, limit.upper],
                "speed": limit.speed,
                "acceleration": limit.acceleration,
                "jerk": limit.jerk,
                "tracking_error": limit.tracking_error,
            }
            for units, drive, limit in zip(machine.units, plant.drives, machine.limits, strict=True)
        ],
        "sample_rate_Hz": machine.sample_rate_Hz,
        "substeps": plant.substeps,
        "bodies": [
            {
                "name": body.name,
                "parent": body.parent,
                "mass_kg": body.mass_kg,
                "joint": None
                if (joint := body.joint) is None
                else {
                    "name": joint.name,
                    "type": joint.kind,
                    "stiffness": joint.stiffness,
                    "damping": joint.damping,
                    "armature": joint.armature,
                    "brake_effort": joint.brake_effort,
                },
            }
            for body in plant.tree.bodies
        ],
        "sensors": [
            *(encoder.channel for encoder in plant.encoders),
            *(sensor.channel for sensor in plant.speeds),
            *(sensor.channel for sensor in plant.currents),
            *(imu.name for imu in plant.imus),
            *(thermometer.channel for thermometer in plant.thermometers),
        ],
        "effects": as_entries(machine.own_effects, plant),
        "controllers": [
            {
                "axis": controller.axis,
                "position_sections": controller.position_sections.tolist(),
                "reference_sections": None if (sections := controller.reference_sections) is None else sections.tolist(),
                "gravity_feedforward": controller.gravity_feedforward,
            }
            for controller in machine.controllers
        ],
        "commands": machine.commanded if machine.controllers else {},
        "nodes": []
        if machine.bus is None
        else [{"name": node.name, "role": node.role, "axis": node.axis, "node_id": node.node_id} for node in machine.bus.nodes],
    }


def machine_lines(machine: Machine) -> list[str]:
    """Write a page for a person: angles in degrees, everything else in SI."""
    plant = machine.plant
    joints = plant.tree.joints
    driven = {drive.joint for drive in plant.drives}
    freedom = f"{len(joints)} degree{'' if len(joints) == 1 else 's'} of freedom"
    lines = [
        f"{machine.name}: {machine.description}",
        f"{freedom}, {machine.sample_rate_Hz:g} Hz, {plant.substeps} plant steps a sample, hash {machine.hash[:12]}",
        "",
        "axes",
    ]
    for units, drive, limit in zip(machine.units, plant.drives, machine.limits, strict=True):
        scale, unit = (180.0 / math.pi, "deg") if units.position == "rad" else (1.0, "m")
        effort = "Nm" if units.position == "rad" else "N"
        line = f"  {units.axis:14s} {drive.constant * drive.ratio:g} {effort}/{drive.unit}, limit {drive.limit:g} {drive.unit}"
        if math.isfinite(limit.lower):
            line += f", {scale * limit.lower:g} to {scale * limit.upper:g} {unit}, {scale * limit.speed:g} {unit}/s"
        if (mode := machine.commanded[units.axis]["mode"]) != "torque":
            line += f", commanded in {mode}"
        lines.append(line)
    lines += ["", "bodies"]
    for body in plant.tree.bodies:
        joint = body.joint
        if joint is None:
            held = "fixed"
        else:
            held = f"{joint.kind} {joint.name}" + (" (driven)" if joint.name in driven else "")
            if joint.stiffness:
                held += f", {joint.stiffness:g} {'Nm/rad' if joint.kind == 'revolute' else 'N/m'}"
        lines.append(f"  {body.name:16s} {body.mass_kg:7.1f} kg on {body.parent}: {held}")
    lines += ["", "sensors", "  " + ", ".join(machine_document(machine)["sensors"])]
    if machine.own_effects:
        lines += ["", "effects", *(f"  {_in_words(entry)}" for entry in as_entries(machine.own_effects, plant))]
    if machine.bus is not None:
        sender = machine.bus.sync_producer or "the bench"
        lines += ["", f"bus, {machine.bus.bitrate_bit_s // 1000} kbit/s, SYNC from {sender} at {machine.sample_rate_Hz:g} Hz"]
        lines += [f"  {node.node_id:3d} {node.name} ({node.role} of {node.axis}, {node.eds.name})" for node in machine.bus.nodes]
    return lines


def _in_words(entry: dict[str, object]) -> str:
    numbers = (f"{key} {value:g}" for key, value in entry.items() if isinstance(value, float))
    return f"{entry['name']} at {entry['at']}: {', '.join(numbers)}"
