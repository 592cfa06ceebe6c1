"""What a run says of a machine's state is held against the truth: false claims, and ones that nobody checks, are found."""

from __future__ import annotations

import json

import numpy as np
import pytest
from bench_machines import CARM
from places import ROOT

from drivers.errors import KEEP_AWAY
from hil.faults.causes import is_true, told_cause
from hil.faults.claims import Witness, contradictions, unlisted
from hil.faults.trials import trials
from virtual_bus.canopen.power_state import PowerState
from virtual_bus.faults.motion_log import MotionLog

PERIOD_S = 1 / 256
TABLE = json.loads((ROOT / "benchmarks" / "results" / "faults_carm.json").read_text(encoding="utf-8"))
TRIALS = {trial.name: trial for trial in trials(CARM, "roll")}
OFF, ENABLED, QUICK_STOP = (
    int(state) for state in (PowerState.SWITCH_ON_DISABLED, PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
)
STOPPED = (
    "row 188: hold-to-run was released; the motors were stopped: propeller, roll at rest: brake proven, voltage off; 189 rows are kept"
)


def witness(
    speed: float = 0.0,
    brake: float = 1.0,
    drive: int = OFF,
    effort: float = 0.0,
    faults: tuple[str, ...] = ("hold_to_run_released",),
    push: float = 0.5,
) -> Witness:
    """Four seconds: both brakes are pushed, then roll is as the arguments say, propeller at rest and braked. All was said after two."""
    log = MotionLog(("propeller", "roll"))
    for time_s in np.arange(0.0, 4.0, PERIOD_S).tolist():
        state = (
            ([0.0, effort], [1.0, brake], [OFF, drive])
            if time_s > 1.0
            else ([0.5 * time_s, push * time_s], [1.0, brake], [ENABLED, ENABLED])
        )
        log.add(time_s, [0.3, speed * time_s], [0.0, speed], *state)
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
        (witness(push=0.0), ["roll at rest: brake proven, voltage off"]),
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


def stopped_after(seconds: float, faults: tuple[str, ...] = ()) -> Witness:
    """A stop that begins half a second before all is said, and in which roll goes on for so long."""
    log = MotionLog(("propeller", "roll"))
    for time_s in np.arange(0.0, 4.0, PERIOD_S).tolist():
        log.add(time_s, [0.3, 0.5 * min(time_s, 1.5 + seconds)], [0.0, 0.0], [0.0, 0.0], [1.0, 1.0], [OFF, OFF])
    return Witness(log, 512, (5e-3, 5e-3), (3e-6, 3e-6), faults, 189, 0.5)


def test_the_told_time_to_standstill_is_that_of_the_motion() -> None:
    told = "standstill 0.30 s after the stop began (propeller 0.00 s, roll 0.30 s)"
    assert contradictions(told, stopped_after(0.3)) == []
    assert contradictions(told, stopped_after(0.4)) == [told], "it moved on for 50 mrad"
    assert contradictions(told, stopped_after(0.1)) == [told], "it had stood for long"
    nobody_knows = stopped_after(0.4, ("motor_encoder_frozen", "link_encoder_frozen"))
    assert contradictions(told, nobody_knows) == []
    seen = "standstill 0.30 s after the stop began (propeller within 5.0e-03 rad, roll 0.30 s)"
    assert contradictions(seen, stopped_after(0.3)) == []
    none = "no encoder moved by more than 5.0e-03 rad after the stop began"
    assert contradictions(none, stopped_after(0.0)) == []
    assert contradictions(none, stopped_after(0.3)) == [none]
    assert contradictions(told.replace("standstill 0.30", "standstill 0.20"), stopped_after(0.3)) != []


def test_a_sentence_about_the_state_that_nobody_checks_is_told() -> None:
    assert contradictions("roll: all its brakes are closed for good", witness()) == [
        "nobody checks: roll: all its brakes are closed for good"
    ]


def test_a_cause_is_true_of_the_faults_that_make_it_alone() -> None:
    error = "row 188: roll: tracking error 0.0527 rad exceeds 0.0524 rad"
    assert contradictions(error, witness(faults=("motor_encoder_reversed",))) == []
    assert contradictions(error, witness()) == [error]
    silent = "roll_drive (node 2): no heartbeat for 0.151 s, 0.150 s allowed; its last state was operational"
    assert contradictions(silent, witness(faults=("drive_hangs",))) == []
    assert contradictions(silent, witness(faults=("imu_silent",))) == [silent.partition("; ")[0]]
    frozen = "row 1: roll: its motor side moved by +0.1 rad, its link encoder by +0.0 while it was led; they may differ by 0.05: "
    frozen += "one of them is frozen, counts the wrong way, or the gear between them slips"
    assert contradictions(frozen, witness(faults=("link_encoder_frozen",))) == []
    assert contradictions(frozen, witness(faults=("pdos_lost",))) == frozen.split("; ")


def test_a_sentence_that_is_not_in_the_list_is_found() -> None:
    assert unlisted(f"{STOPPED}; the moon is in the seventh house", ("propeller", "roll")) == ["the moon is in the seventh house"]
    assert unlisted("its drive warms", ("roll",)) == ["its drive warms"]


def test_every_sentence_of_the_kept_table_is_in_the_list_and_its_cause_is_the_fault() -> None:
    for row in TABLE["rows"]:
        faults = [fault.name for fault in TRIALS[row["name"]].settings]
        sentences = [said for said in row["said"].removeprefix(f"{KEEP_AWAY}: ").split("; ") if not said.endswith("…")]
        assert unlisted("; ".join(sentences), CARM.axes) == [], row["name"]
        assert [said for said in sentences if not is_true(told_cause(said) or ".*", faults)] == [], row["name"]
