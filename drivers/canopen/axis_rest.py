"""How the stop of an axis ended, as far as it was seen."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

from drivers.canopen.cia402 import State

NOT_PROVEN = "not proven at rest"
"""How an axis that nobody knows to stand, or that moves, is told."""
POWERED = frozenset(
    {State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}
)


@dataclass(frozen=True)
class AxisRest:
    """How the stop of an axis ended, as far as it was seen."""

    axis: str
    safe: bool  # stands, without voltage, and held by what was checked
    held: bool  # the drive holds it, because the brake is not proven
    words: str
    steps: tuple[tuple[str, float], ...] = ()  # of its stop, in order: what was waited for, and how long [s]
    stood_s: float = (
        nan  # from the beginning of the stop until it moved no more, 0: none was seen to leave `within`; NaN: nor that it stood
    )
    may_move: bool = False  # it moves, or nobody knows that it does not
    within: str = ""  # how far its encoders may go without having shown that it moves, in words
