"""Limits that a drive has stored for its own position loop: software position limits (607Dh) and the following error window (6065h).

Inside what the machine file allows they would cut or end motions that the loop asks for. They are widened to the machine file's, with a
note: the loop keeps to that range itself. Where they cannot be written the drive is refused, and where the machine file's own position
limits are narrower than its range; its own following error window stays as it is.
"""

from __future__ import annotations

from math import ceil, floor

from drivers.canopen.power_and_brakes import Machine
from drivers.canopen.sdo import SdoNode
from drivers.errors import ConfigurationRefusedError
from drivers.settings import MotionLimits, Node

SOFTWARE_LIMITS, LOWEST, HIGHEST = 0x607D, 1, 2
FOLLOWING_ERROR_WINDOW = 0x6065
SET_SO = ": it was set so"  # ends a note that stays true when the nodes are started again, and are found set
_INT32 = 0x7FFF_FFFF


def allow_following_error(sdo: SdoNode, node: Node, limits: MotionLimits, per_count: float) -> tuple[str, ...]:
    """Let a drive in position mode lag behind its targets as far as the loop lets it; return a note where its window was narrower.

    Parameters
    ----------
    sdo : SdoNode
    node : Node
    limits : MotionLimits
        `following_error` is how far target and position may be apart.
    per_count : float
        [rad or m]

    Raises
    ------
    ConfigurationRefusedError
        The window is narrower and cannot be written.
    """
    have, needed = sdo.integer_if_present(FOLLOWING_ERROR_WINDOW), ceil(limits.following_error / per_count)
    if have is None or have >= needed or any(index == FOLLOWING_ERROR_WINDOW for index, _, _ in node.writes):
        return ()
    found = f"{sdo.who}: its following error window (6065h) is {have} counts, {limits.axis} needs {needed}"
    if not sdo.may_write(FOLLOWING_ERROR_WINDOW):
        raise ConfigurationRefusedError(f"{found}, and it cannot be written; widen it with the drive's own tool")
    most = sdo.greatest(FOLLOWING_ERROR_WINDOW)
    if most is not None and most < needed:
        raise ConfigurationRefusedError(f"{found}, and it takes at most {most}; lower tracking_error or speed in limits.{limits.axis}")
    sdo.write_checked(FOLLOWING_ERROR_WINDOW, 0, needed)
    return (found + SET_SO,)


def allow_range(machine: Machine, axis: int, limits: MotionLimits) -> None:
    """Let a homed drive take targets in all of its axis' range; note where its software limits were inside of it.

    Raises
    ------
    ConfigurationRefusedError
        They are, and cannot be written, or are the machine file's own.
    """
    sdo, node, source = machine.sdo(axis), machine.drives[axis], machine.inputs[axis]
    lowest, highest = (sdo.integer_if_present(SOFTWARE_LIMITS, end) for end in (LOWEST, HIGHEST))
    machine.resume_ticks()
    if lowest is None or highest is None:
        return
    ends = sorted(source.counts(position) - source.turns * 2**32 for position in (limits.lower, limits.upper))
    needed = max(floor(ends[0]), -_INT32), min(ceil(ends[1]), _INT32)
    if lowest >= highest or (lowest <= needed[0] and highest >= needed[1]):  # the former limits nothing
        return
    have = f"its software position limits (607Dh) are {lowest} to {highest}"
    found = f"{sdo.who}: {have}, the range of {limits.axis} is {needed[0]} to {needed[1]}"
    if any(index == SOFTWARE_LIMITS for index, _, _ in node.writes):
        raise ConfigurationRefusedError(f"{found}; the machine file has both: correct its write, or limits.{limits.axis}.range")
    if not (sdo.may_write(SOFTWARE_LIMITS, LOWEST) and sdo.may_write(SOFTWARE_LIMITS, HIGHEST)):
        raise ConfigurationRefusedError(f"{found}, and they cannot be written; widen them with the drive's own tool, or narrow the range")
    sdo.write_checked(SOFTWARE_LIMITS, LOWEST, min(lowest, needed[0]))
    sdo.write_checked(SOFTWARE_LIMITS, HIGHEST, max(highest, needed[1]))
    machine.notes += (found + SET_SO,)
    machine.resume_ticks()
