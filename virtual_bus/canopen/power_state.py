"""The finite state automaton of a CiA 402 drive (IEC 61800-7-201, figure 3 and tables 4 and 7) as a pure function."""

from __future__ import annotations

from enum import IntEnum


class PowerState(IntEnum):
    """States of the drive. Each value is the state's own pattern in the statusword (bits 0 to 3, 5 and 6)."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class Command(IntEnum):
    """Commands of a controlword."""

    NONE = 0
    SHUTDOWN = 1
    SWITCH_ON = 2  # the same pattern is "disable operation" in OPERATION_ENABLED
    ENABLE_OPERATION = 3
    DISABLE_VOLTAGE = 4
    QUICK_STOP = 5


FAULT_RESET = 1 << 7
HALT = 1 << 8

S = PowerState
_NEXT: dict[tuple[PowerState, Command], PowerState] = {
    (S.SWITCH_ON_DISABLED, Command.SHUTDOWN): S.READY_TO_SWITCH_ON,  # transition 2
    (S.READY_TO_SWITCH_ON, Command.SWITCH_ON): S.SWITCHED_ON,  # 3
    (S.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION): S.SWITCHED_ON,  # 3, and 4 follows by itself
    (S.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,  # 7
    (S.READY_TO_SWITCH_ON, Command.QUICK_STOP): S.SWITCH_ON_DISABLED,  # 7
    (S.SWITCHED_ON, Command.ENABLE_OPERATION): S.OPERATION_ENABLED,  # 4
    (S.SWITCHED_ON, Command.SHUTDOWN): S.READY_TO_SWITCH_ON,  # 6
    (S.SWITCHED_ON, Command.DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,  # 10
    (S.SWITCHED_ON, Command.QUICK_STOP): S.SWITCH_ON_DISABLED,  # 10
    (S.OPERATION_ENABLED, Command.SWITCH_ON): S.SWITCHED_ON,  # 5
    (S.OPERATION_ENABLED, Command.SHUTDOWN): S.READY_TO_SWITCH_ON,  # 8
    (S.OPERATION_ENABLED, Command.DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,  # 9
    (S.OPERATION_ENABLED, Command.QUICK_STOP): S.QUICK_STOP_ACTIVE,  # 11
    (S.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,  # 12
}


def command_of(controlword: int) -> Command:
    """Return the command in bits 0 to 3; none while the fault reset bit is set."""
    if controlword & FAULT_RESET:
        return Command.NONE
    if not controlword & 0x02:
        return Command.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return Command.QUICK_STOP
    if not controlword & 0x01:
        return Command.SHUTDOWN
    return Command.ENABLE_OPERATION if controlword & 0x08 else Command.SWITCH_ON


def next_state(state: PowerState, controlword: int, previous_controlword: int, *, resume_from_quick_stop: bool) -> PowerState:
    """Return the state one transition on, or the same state.

    Parameters
    ----------
    state : PowerState
        The present state.
    controlword, previous_controlword : int
        A fault is reset by the rising edge of bit 7, so both are needed.
    resume_from_quick_stop : bool
        Whether transition 16 exists: quick stop option codes 5 to 8.
    """
    if state is S.FAULT:
        rising = controlword & ~previous_controlword & FAULT_RESET
        return S.SWITCH_ON_DISABLED if rising else state  # 15
    command = command_of(controlword)
    if state is S.QUICK_STOP_ACTIVE and command is Command.ENABLE_OPERATION and resume_from_quick_stop:
        return S.OPERATION_ENABLED  # 16
    return _NEXT.get((state, command), state)
