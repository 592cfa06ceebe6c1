"""The drive's state machine of CiA 402 (IEC 61800-7-201), as tables and pure functions: no bus, no time.

Statuswords are decoded by mask, never by name; the next controlword is read from one table.
"""

from __future__ import annotations

from enum import Enum, IntEnum


class State(Enum):
    """States of the power drive system finite state automaton."""

    NOT_READY_TO_SWITCH_ON = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY_TO_SWITCH_ON = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION_ACTIVE = "fault reaction active"
    FAULT = "fault"
    UNDEFINED = "undefined"  # a bit pattern that the standard gives to no state


MODES_OF_OPERATION, MODES_DISPLAY = 0x6060, 0x6061


class Mode(IntEnum):
    """Modes of operation, objects 6060h and 6061h."""

    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    HOMING = 6
    CYCLIC_SYNCHRONOUS_POSITION = 8
    CYCLIC_SYNCHRONOUS_VELOCITY = 9
    CYCLIC_SYNCHRONOUS_TORQUE = 10


# (mask, value, state), IEC 61800-7-201 table "state coding"
STATE_CODING = (
    (0x4F, 0x00, State.NOT_READY_TO_SWITCH_ON),
    (0x4F, 0x40, State.SWITCH_ON_DISABLED),
    (0x6F, 0x21, State.READY_TO_SWITCH_ON),
    (0x6F, 0x23, State.SWITCHED_ON),
    (0x6F, 0x27, State.OPERATION_ENABLED),
    (0x6F, 0x07, State.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, State.FAULT_REACTION_ACTIVE),
    (0x4F, 0x08, State.FAULT),
)

# statusword bits
VOLTAGE_ENABLED = 1 << 4
WARNING = 1 << 7
REMOTE = 1 << 9
TARGET_REACHED = 1 << 10
INTERNAL_LIMIT_ACTIVE = 1 << 11
HOMING_ATTAINED = 1 << 12
HOMING_ERROR = 1 << 13

# controlword commands
DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
DISABLE_OPERATION = 0x0007
ENABLE_OPERATION = 0x000F
FAULT_RESET = 0x0080
STATUSWORD = 0x6041
HOMING_START = 1 << 4
NO_HOMING = 0  # the counter is right as it is
HOMING_AT_PRESENT_POSITION = frozenset({35, 37})  # methods that take the present position as zero

# goal -> state -> controlword that leads one transition on (or holds). States that are absent are left only by time or a fault reset.
_PATHS: dict[State, dict[State, int]] = {
    State.SWITCH_ON_DISABLED: {
        State.NOT_READY_TO_SWITCH_ON: DISABLE_VOLTAGE,
        State.SWITCH_ON_DISABLED: DISABLE_VOLTAGE,
        State.READY_TO_SWITCH_ON: DISABLE_VOLTAGE,  # transition 7
        State.SWITCHED_ON: DISABLE_VOLTAGE,  # 10
        State.OPERATION_ENABLED: DISABLE_VOLTAGE,  # 9
        State.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,  # 12
    },
    State.READY_TO_SWITCH_ON: {
        State.NOT_READY_TO_SWITCH_ON: DISABLE_VOLTAGE,
        State.SWITCH_ON_DISABLED: SHUTDOWN,  # 2
        State.READY_TO_SWITCH_ON: SHUTDOWN,
        State.SWITCHED_ON: SHUTDOWN,  # 6
        State.OPERATION_ENABLED: SHUTDOWN,  # 8
        State.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,  # 12
    },
    State.SWITCHED_ON: {
        State.NOT_READY_TO_SWITCH_ON: DISABLE_VOLTAGE,
        State.SWITCH_ON_DISABLED: SHUTDOWN,
        State.READY_TO_SWITCH_ON: SWITCH_ON,  # 3
        State.SWITCHED_ON: SWITCH_ON,
        State.OPERATION_ENABLED: DISABLE_OPERATION,  # 5
        State.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,
    },
    State.OPERATION_ENABLED: {
        State.NOT_READY_TO_SWITCH_ON: DISABLE_VOLTAGE,
        State.SWITCH_ON_DISABLED: SHUTDOWN,
        State.READY_TO_SWITCH_ON: SWITCH_ON,
        State.SWITCHED_ON: ENABLE_OPERATION,  # 4
        State.OPERATION_ENABLED: ENABLE_OPERATION,
        State.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,  # 16 is optional in the standard: go round by 12
    },
    State.QUICK_STOP_ACTIVE: {
        State.OPERATION_ENABLED: QUICK_STOP,  # 11
        State.QUICK_STOP_ACTIVE: QUICK_STOP,
    },
}


class Homing(Enum):
    """Progress of homing, statusword bits 13, 12 and 10 in homing mode."""

    UNDER_WAY = "under way"
    NOT_STARTED = "interrupted or not started"
    SETTLING = "attained (bit 12), target not reached (bit 10)"
    DONE = "completed"
    FAILED_MOVING = "homing error, still moving"
    FAILED = "homing error, standing still"


_HOMING = {
    (0, 0, 0): Homing.UNDER_WAY,
    (0, 0, 1): Homing.NOT_STARTED,
    (0, 1, 0): Homing.SETTLING,
    (0, 1, 1): Homing.DONE,
    (1, 0, 0): Homing.FAILED_MOVING,
    (1, 0, 1): Homing.FAILED,
}


def decode_state(statusword: int) -> State:
    """Return the state of a statusword (object 6041h) by the standard's mask table."""
    for mask, value, state in STATE_CODING:
        if statusword & mask == value:
            return state
    return State.UNDEFINED


def next_controlword(state: State, goal: State) -> int | None:
    """Return the controlword that leads from `state` one transition towards `goal`, or holds it there; None when none does.

    This table never leaves a fault: a fault is reset deliberately (`FAULT_RESET`, rising edge) and checked.
    """
    return _PATHS[goal].get(state)


def decode_homing(statusword: int) -> Homing:
    """Return the progress of a homing procedure; error and attained set at once count as an error."""
    error, attained, reached = statusword >> 13 & 1, statusword >> 12 & 1, statusword >> 10 & 1
    return _HOMING[(error, 0 if error else attained, reached)]


def describe_statusword(statusword: int) -> str:
    """Return a statusword in words, e.g. `operation enabled, internal limit active (1A37h)`."""
    words = [decode_state(statusword).value]
    words += ["warning"] if statusword & WARNING else []
    words += ["internal limit active"] if statusword & INTERNAL_LIMIT_ACTIVE else []
    return f"{', '.join(words)} ({statusword:04X}h)"
