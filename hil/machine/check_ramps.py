"""Can a drive that ramps its velocity by itself follow its reference: its ramp beside the limit of acceleration."""

from __future__ import annotations

import math

from drivers.canopen.eds import load_object_dictionary
from drivers.canopen.ramps import PROFILE_ACCELERATION, PROFILE_DECELERATION, speeds_and_ramps
from drivers.canopen.units import in_data_sheet, units_of
from drivers.errors import ConfigurationRefusedError, ProtocolError
from hil.machine.finding import Finding
from hil.machine.machine import Machine


def ramps(machine: Machine) -> list[Finding]:
    """Return a finding per axis in profile velocity mode: the slower of both ramps that its drive is given (6083h, 6084h)."""
    bus = machine.bus
    assert bus is not None
    found = []
    for scaling, limits in zip(bus.scalings, bus.motions, strict=True):
        node = next(node for node in bus.nodes if node.role == "drive" and node.axis == scaling.axis)
        if scaling.mode != "profile_velocity":
            continue
        try:
            dictionary = load_object_dictionary(node.eds, node.node_id)
        except (OSError, ProtocolError):
            continue  # which is told elsewhere
        try:
            acceleration = units_of(in_data_sheet(dictionary, node.writes), scaling, node.name).acceleration
        except ConfigurationRefusedError as unknown:
            found.append(Finding("ramp", False, str(unknown), {"axis": scaling.axis, "ramp": None}))
            continue
        in_si = scaling.position_resolution / acceleration  # of one of the drive's units
        own = {index: value for index, subindex, value in node.writes if subindex == 0}
        wanted, ramp = speeds_and_ramps(scaling.mode, limits), math.inf
        for index in (PROFILE_ACCELERATION, PROFILE_DECELERATION):
            if (variable := dictionary.get_variable(index)) is not None:
                most = math.inf if variable.max is None else float(variable.max)
                ramp = min(ramp, in_si * own[index] if index in own else min(wanted[index], in_si * most))
        unit = f"{scaling.position_unit}/s^2"
        text = f"{scaling.axis}: its drive ramps by {ramp:.3g} {unit}; more than {limits.acceleration:.3g}, the reference's, is right"
        found.append(Finding("ramp", ramp > limits.acceleration, text, {"axis": scaling.axis, "ramp": ramp}))
    return found
