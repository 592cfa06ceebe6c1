"""From the file's tables to what the bench commands of each drive, and to the laws that bench and drives are together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from controllers.cascade import NO_SECTIONS, AxisCommand, CommandMode, DriveLoops, in_effort
from controllers.errors import DesignError
from controllers.settings import AxisController, AxisLimits
from hil.machine.build import require_known
from hil.machine.messages import ComplaintError
from hil.machine.schema import LoopsTable, MachineTable


def build_drive_loops(table: MachineTable) -> tuple[DriveLoops | None, ...]:
    """Build the drives' own loops, in axis order; None where the file says nothing of them."""
    return tuple(None if drive.loops is None else _loops(axis, drive.loops) for axis, drive in table.drives.items())


def build_commands(table: MachineTable, limits: Sequence[AxisLimits]) -> tuple[AxisCommand | None, ...]:
    """Build what the bench commands of each axis; None in torque mode, where that is the effort of `build_controllers`."""
    commands: list[AxisCommand | None] = []
    for (axis, drive), loops, limit in zip(table.drives.items(), build_drive_loops(table), limits, strict=True):
        if drive.mode == "torque":
            commands.append(None)
            continue
        if loops is None:
            raise ComplaintError(("drives", axis, "loops"), f"is missing; in {drive.mode} mode they are part of the feedback")
        mode: CommandMode = "velocity" if drive.mode.endswith("velocity") else "position"
        most = limit.speed if mode == "velocity" else furthest_target(limit.speed, limit.tracking_error, loops.position_gain)
        commands.append(AxisCommand(mode, _own_controller(axis, table, most, needed=mode == "velocity"), loops))
    return tuple(commands)


def furthest_target(speed: float, tracking_error: float, position_gain: float) -> float:
    """Return how far a target may be from the reference, or the position from the target.

    It is how far the drive's position loop needs its target ahead at the axis' highest speed, and the tracking error at which the axis is
    stopped anyway.
    """
    return tracking_error + (speed / position_gain if position_gain else 0.0)


def build_controllers(table: MachineTable, commands: Sequence[AxisCommand | None]) -> tuple[AxisController, ...]:
    """Build the law in effort per axis, in axis order; () when the file has no [controller] and no drive closes a loop."""
    for axis, controller in table.controller.items():
        require_known(axis, table.drives, ("controller", axis), "axis")
        for field in ("position_sections", "reference_sections"):
            for number, section in enumerate(getattr(controller, field) or ()):
                _check_section(("controller", axis, field, number), section)
    if not table.controller and not any(commands):
        return ()
    found = []
    for axis, command in zip(table.drives, commands, strict=True):
        limit = table.drives[axis].limit
        if command is None:
            found.append(_own_controller(axis, table, limit, needed=True))
            continue
        try:
            found.append(in_effort(command, limit, table.timing.sample_rate))
        except DesignError as error:
            raise ComplaintError(("controller", axis), str(error).removeprefix(f"{axis}: ")) from None
    return tuple(found)


UNITY = 1e-3
"""How near to 1 the static gain of a torque filter is: machine files have as many digits."""


def _loops(axis: str, loops: LoopsTable) -> DriveLoops:
    where = ("drives", axis, "loops", "torque_sections")
    sections = None if loops.torque_sections is None else np.array(loops.torque_sections)
    if sections is not None:
        for number, section in enumerate(sections):
            _check_section((*where, number), tuple(section))
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = float(np.prod(sections[:, :3].sum(axis=1) / sections[:, 3:].sum(axis=1)))
        if not abs(gain - 1.0) <= UNITY:
            raise ComplaintError(where, f"has a static gain of {gain:.4g}; 1 would be right: the gain is the velocity loop's")
    return DriveLoops(loops.position_gain, loops.velocity_gain, loops.velocity_integral_gain, loops.speed_filter, sections)


def _check_section(where: tuple[str | int, ...], section: Sequence[float]) -> None:
    if section[3] != 1.0:
        raise ComplaintError(where, "a section is b0, b1, b2, 1, a1, a2: the fourth number must be 1")


def _own_controller(axis: str, table: MachineTable, limit: float, *, needed: bool) -> AxisController:
    """Return the filters that the file has for an axis."""
    controller = table.controller.get(axis)
    if controller is None and needed:
        raise ComplaintError(("controller", axis), "is missing; every axis has a controller, or none has")
    if controller is None:
        return AxisController(axis, NO_SECTIONS, None, limit, gravity_feedforward=False)
    if controller.position_sections is None and needed:
        raise ComplaintError(("controller", axis, "position_sections"), "is missing")
    return AxisController(
        axis=axis,
        position_sections=NO_SECTIONS if controller.position_sections is None else np.array(controller.position_sections),
        reference_sections=None if controller.reference_sections is None else np.array(controller.reference_sections),
        limit=limit,
        gravity_feedforward=controller.gravity_feedforward,
    )
