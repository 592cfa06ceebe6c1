"""What a run says of a machine's state is held against the truth: false claims, and ones that nobody checks, are found."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import KEEP_AWAY
from hil.faults.claims import Witness, contradictions
from virtual_bus.canopen.power_state import PowerState
from virtual_bus.faults.motion_log import MotionLog

PERIOD_S = 1 / 256
OFF, ENABLED, QUICK_STOP = (
    int(state) for state in (PowerState.SWITCH_ON_DISABLED, PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
)
STOPPED = (
    "row 188: hold-to-run was released; the motors were stopped: propeller, roll at rest: brake proven, voltage off; 189 rows are kept"
)


def witness(
    speed: float = 0.0, brake: float = 1.0, drive: int = OFF, effort: float = 0.0, faults: tuple[str, ...] = ("hold_to_run_released",)
) -> Witness:
    """Four seconds of two axes; roll as the arguments say, propeller at rest and braked. All was said after two."""
    log = MotionLog(("propeller", "roll"))
    for time_s in np.arange(0.0, 4.0, PERIOD_S).tolist():
        log.add(time_s, [0.3, speed * time_s], [0.0, speed], [0.0, effort], [1.0, brake], [OFF, drive])
    return Witness(log, 512, (5e-3, 5e-3), (3e-6, 3e-6), faults, 189)


def test_a_true_line_has_no_contradiction() -> None:
    assert contradictions(STOPPED, witness()) == []
    held = (
        "row 188: hold-to-run was released; propeller at rest: brake proven, voltage off; "
        "roll held by its drive: its brake reports open 1 s after it was told to close, it stands; 189 rows are kept"
    )
    assert contradictions(held, witness(brake=0.0, drive=QUICK_STOP, effort=2.0)) == []


@pytest.mark.parametrize(
    ("truth", "false"),
    [
        (witness(speed=0.05), ["roll at rest: brake proven, voltage off"]),
        (witness(brake=0.0), ["roll at rest: brake proven, voltage off"]),
        (witness(drive=ENABLED), ["roll at rest: brake proven, voltage off"]),
        (witness(effort=0.1), ["roll at rest: brake proven, voltage off"]),
        (witness(faults=("io_vanishes",)), ["row 188: hold-to-run was released"]),
    ],
)
def test_every_claim_that_the_truth_contradicts_is_found(truth: Witness, false: list[str]) -> None:
    assert contradictions(STOPPED, truth) == false


def test_rows_motion_and_a_hold_that_are_not_there_are_found() -> None:
    assert contradictions(STOPPED.replace("189 rows", "190 rows"), witness()) == ["190 rows are kept"]
    moves = "roll not proven at rest: its drive is told to hold it and IT MOVES: its brake reports open 1 s after it was told to close"
    assert contradictions(f"{KEEP_AWAY}: {moves}", witness()) == [moves]
    truth = witness(speed=0.05, drive=QUICK_STOP)
    assert contradictions(f"{KEEP_AWAY}: {moves}", truth) == []
    assert contradictions(moves, truth) == ["nobody is told to keep away"]
    sent = f"{KEEP_AWAY}: {moves}; support the axis"
    assert "somebody is sent to an axis that may move" in contradictions(sent, truth)
    held = "roll held by its drive: its brake reports open 1 s after it was told to close, it stands"
    assert contradictions(held, witness()) == [held]
    assert contradictions("nothing was recorded", witness()) == ["nothing was recorded"]


def test_a_sentence_about_the_state_that_nobody_checks_is_told() -> None:
    assert contradictions("roll: all its brakes are closed for good", witness()) == [
        "nobody checks: roll: all its brakes are closed for good"
    ]
    assert contradictions("row 188: roll: tracking error 0.0527 rad exceeds 0.0524 rad", witness()) == []
