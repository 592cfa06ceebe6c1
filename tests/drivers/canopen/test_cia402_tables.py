"""The drive's state machine against IEC 61800-7-201, its tables written out here once more."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.cia402 import Homing, State, decode_homing, decode_state, describe_statusword, next_controlword

# the standard's table of statusword patterns, bit 15 first
STATUSWORD = {
    "xxxx xxxx x0xx 0000": State.NOT_READY_TO_SWITCH_ON,
    "xxxx xxxx x1xx 0000": State.SWITCH_ON_DISABLED,
    "xxxx xxxx x01x 0001": State.READY_TO_SWITCH_ON,
    "xxxx xxxx x01x 0011": State.SWITCHED_ON,
    "xxxx xxxx x01x 0111": State.OPERATION_ENABLED,
    "xxxx xxxx x00x 0111": State.QUICK_STOP_ACTIVE,
    "xxxx xxxx x0xx 1111": State.FAULT_REACTION_ACTIVE,
    "xxxx xxxx x0xx 1000": State.FAULT,
}
# the standard's table of commands: pattern of controlword bits 7, 3, 2, 1, 0 -> name
CONTROLWORD = {"0x110": "shutdown", "00111": "switch on", "01111": "enable operation", "0xx0x": "disable voltage", "0x01x": "quick stop"}
# the standard's transitions: (state, command) -> state
TRANSITIONS = {
    (State.SWITCH_ON_DISABLED, "shutdown"): State.READY_TO_SWITCH_ON,  # 2
    (State.READY_TO_SWITCH_ON, "switch on"): State.SWITCHED_ON,  # 3
    (State.SWITCHED_ON, "enable operation"): State.OPERATION_ENABLED,  # 4
    (State.OPERATION_ENABLED, "switch on"): State.SWITCHED_ON,  # 5, disable operation has the pattern of switch on
    (State.SWITCHED_ON, "shutdown"): State.READY_TO_SWITCH_ON,  # 6
    (State.READY_TO_SWITCH_ON, "disable voltage"): State.SWITCH_ON_DISABLED,  # 7
    (State.READY_TO_SWITCH_ON, "quick stop"): State.SWITCH_ON_DISABLED,  # 7
    (State.OPERATION_ENABLED, "shutdown"): State.READY_TO_SWITCH_ON,  # 8
    (State.OPERATION_ENABLED, "disable voltage"): State.SWITCH_ON_DISABLED,  # 9
    (State.SWITCHED_ON, "disable voltage"): State.SWITCH_ON_DISABLED,  # 10
    (State.SWITCHED_ON, "quick stop"): State.SWITCH_ON_DISABLED,  # 10
    (State.OPERATION_ENABLED, "quick stop"): State.QUICK_STOP_ACTIVE,  # 11
    (State.QUICK_STOP_ACTIVE, "disable voltage"): State.SWITCH_ON_DISABLED,  # 12
}
REACHABLE = [State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED]
COMMANDED = [*REACHABLE, State.QUICK_STOP_ACTIVE]


def matches(pattern: str, word: str) -> bool:
    return all(want in ("x", have) for want, have in zip(pattern.replace(" ", ""), word, strict=True))


def command_of(controlword: int) -> str:
    word = "".join(str(controlword >> bit & 1) for bit in (7, 3, 2, 1, 0))
    return next(name for pattern, name in CONTROLWORD.items() if matches(pattern, word))


@pytest.mark.slow
def test_every_statusword_decodes_as_the_standards_patterns_say() -> None:
    for statusword in range(1 << 16):
        expected = [state for pattern, state in STATUSWORD.items() if matches(pattern, format(statusword, "016b"))]
        assert len(expected) <= 1
        assert decode_state(statusword) is (expected[0] if expected else State.UNDEFINED)


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF))
def test_bits_that_are_no_part_of_the_state_do_not_change_it(statusword: int, other: int) -> None:
    assert decode_state(statusword) is decode_state(statusword & 0x6F | other & ~0x6F)


@pytest.mark.parametrize(("start", "goal"), list(itertools.product(COMMANDED, REACHABLE)))
def test_following_the_controlwords_reaches_every_goal_by_the_standards_transitions(start: State, goal: State) -> None:
    state = start
    for _ in range(6):
        command = command_of(next_controlword(state, goal))
        state = TRANSITIONS.get((state, command), state)
    assert state is goal


def test_quick_stop_is_entered_from_operation_enabled() -> None:
    assert command_of(next_controlword(State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)) == "quick stop"


@pytest.mark.parametrize("state", [State.FAULT, State.FAULT_REACTION_ACTIVE, State.UNDEFINED])
@pytest.mark.parametrize("goal", COMMANDED)
def test_no_controlword_leaves_a_fault_on_its_own(state: State, goal: State) -> None:
    assert next_controlword(state, goal) is None


def test_no_controlword_on_any_path_has_the_fault_reset_bit() -> None:
    words = [next_controlword(state, goal) for state in State for goal in COMMANDED]
    assert all(word & 0x80 == 0 for word in words if word is not None)


@pytest.mark.parametrize(
    ("bits_13_12_10", "progress"),
    [
        ("000", Homing.UNDER_WAY),
        ("001", Homing.NOT_STARTED),
        ("010", Homing.SETTLING),
        ("011", Homing.DONE),
        ("100", Homing.FAILED_MOVING),
        ("101", Homing.FAILED),
        ("111", Homing.FAILED),
    ],
)
def test_homing_progress_is_bits_13_12_and_10(bits_13_12_10: str, progress: Homing) -> None:
    error, attained, reached = (int(bit) for bit in bits_13_12_10)
    assert decode_homing(0x0237 & ~0x400 | error << 13 | attained << 12 | reached << 10) is progress


def test_a_statusword_reads_as_words() -> None:
    assert describe_statusword(0x0AB7) == "operation enabled, warning, internal limit active (0AB7h)"
