"""A machine in words, and as a JSON document in SI."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from hil.machine.model import Machine


def machine_lines(machine: Machine) -> list[str]:
    """What a person wants to know of a machine, a line each."""
    plant = machine.plant
    lines = [
        f"{machine.name}: {machine.description}",
        f"file {machine.path or 'shipped'}, hash {machine.hash[:12]}",
        f"{machine.sample_rate_Hz:g} Hz, {plant.substeps} plant steps a sample",
        "",
        "bodies, and how each hangs on its parent:",
    ]
    for body in plant.tree.bodies:
        joint = body.joint
        held = "welded" if joint is None else _joint_words(joint.name, joint.kind, joint.stiffness, joint.damping, joint.armature)
        lines.append(f"  {body.name:18s} on {body.parent:18s} {body.mass_kg:8.2f} kg  {held}")
    lines += ["", "axes:"]
    for units, drive, limit in zip(machine.units, plant.drives, machine.limits, strict=True):
        effort = f"{drive.constant * drive.ratio:.4g} {'Nm' if units.position == 'rad' else 'N'}/{drive.unit} at the joint"
        travel = f"{limit.lower:.4g} to {limit.upper:.4g} {units.position}, <= {limit.speed:.4g} {units.position}/s"
        lines.append(f"  {units.axis}: joint {drive.joint}, {effort}, |command| <= {drive.limit:g} {drive.unit}, {travel}")
    channels = [encoder.channel for encoder in plant.encoders] + [current.channel for current in plant.currents]
    channels += [imu.name for imu in plant.imus] + [thermometer.channel for thermometer in plant.thermometers]
    lines += ["", "sensors: " + ", ".join(channels)]
    lines.append("controller: " + (_controller_words(machine) if machine.controllers else "none (open loop)"))
    if machine.bus is None:
        lines.append("bus: none: this machine can be simulated, compared and diagnosed, not run")
    else:
        nodes = ", ".join(f"{node.name} ({node.node_id})" for node in machine.bus.nodes)
        lines.append(f"bus: {machine.bus.bitrate_bit_s / 1000:g} kbit/s, nodes {nodes}")
        lines.append(f"serial IMU: {'yes' if machine.bus.imu else 'no'}, Modbus I/O: {'yes' if machine.bus.io else 'no'}")
    for effect in plant.effects:
        parameters = ", ".join(f"{name} = {value:g}" for name, value in effect.parameters.items())
        lines.append(f"added physics: {effect.name} at {effect.at}: {parameters}")
    return lines


def machine_document(machine: Machine) -> dict[str, Any]:
    """Every setting in SI, as the floors get them."""
    document = _plain(machine)
    document.pop("text")
    return document


def _joint_words(name: str, kind: str, stiffness: float, damping: float, armature: float) -> str:
    turning = kind == "revolute"
    words = f"{kind} {name}"
    if stiffness:
        words += f", {stiffness:.4g} {'Nm/rad' if turning else 'N/m'}"
    if damping:
        words += f", {damping:.4g} {'Nm s/rad' if turning else 'N s/m'}"
    if armature:
        words += f", rotor {armature:.4g} {'kg m^2' if turning else 'kg'}"
    return words


def _controller_words(machine: Machine) -> str:
    return "; ".join(
        f"{controller.axis} {len(controller.position_sections)} sections"
        + (f" and {len(controller.reference_sections)} on the reference" if controller.reference_sections is not None else "")
        + (", gravity feedforward" if controller.gravity_feedforward else "")
        for controller in machine.controllers
    )


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value
