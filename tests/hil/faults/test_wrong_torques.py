"""A drive whose torque is wrong, with a brake that is weak or absent, in every mode: what a stop makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM, carm_text_in

from drivers.errors import KEEP_AWAY
from hil.faults.check import TrialOutcome, check_faults, run_trial
from hil.faults.motion import motion_of
from hil.faults.page import is_failure
from hil.faults.trials import FaultTrial, trials
from hil.machine import Machine, machine_from_text
from virtual_bus.faults.condition import InState
from virtual_bus.faults.fault import FaultSetting

MODES = ("torque", "velocity", "position")
TORQUES = (
    "torque_lost",
    "torque_share",
    "torque_inverted",
    "torque_stuck_at_maximum",
    "torque_stuck",
    "torque_offset",
    "torque_late",
    "torque_noisy",
)
WATCHED_RAD_S = np.radians(90.0)
"""The speed at which the watch over an axis of 60 degrees per second stops it."""


def machine_in(mode: str) -> Machine:
    return CARM if mode == "torque" else machine_from_text(carm_text_in(mode))


def tried(mode: str, folder: Path, names: tuple[str, ...]) -> list[TrialOutcome]:
    machine = machine_in(mode)
    rows = [row for row in trials(machine, "roll", names) if row.during == "sweep"]
    return check_faults(machine, "roll", rows, folder)


def judged(outcome: TrialOutcome) -> None:
    """At rest, or beyond holding; never driven on."""
    assert outcome.verdict in ("stopped", "noted", "within tolerance", "cannot be held"), outcome
    assert not is_failure(outcome), outcome
    assert outcome.verdict != "cannot be held" or "without_brake" in outcome.name
    roll = next(axis for axis in outcome.axes if axis.axis == "roll")
    assert roll.fastest < WATCHED_RAD_S, "an arm that falls from where the drive lost it is no faster"


def test_every_wrong_torque_is_tried_with_each_brake() -> None:
    names = {row.name for row in trials(CARM, "roll")}
    for torque in TORQUES:
        for brake in ("", "/weak_brake", "/without_brake"):
            assert f"{torque}/roll_drive/sweep{brake}" in names


@pytest.mark.parametrize(
    ("mode", "row", "verdict"),
    [
        ("torque", "torque_stuck_at_maximum/roll_drive/sweep/direction=-1/weak_brake", "stopped"),
        ("velocity", "torque_inverted/roll_drive/sweep/without_brake", "cannot be held"),
        ("position", "torque_stuck_at_maximum/roll_drive/sweep/without_brake", "cannot be held"),
    ],
)
def test_a_drive_that_pushes_loses_its_voltage_where_its_brake_does_not_hold(mode: str, row: str, verdict: str, tmp_path: Path) -> None:
    (outcome,) = tried(mode, tmp_path, (row,))
    judged(outcome)
    assert outcome.verdict == verdict
    assert "its drive did not hold it, its " in outcome.said
    assert ", voltage off" in outcome.said
    assert verdict == "cannot be held" or (outcome.ending == "held by its brake" and outcome.travel < 2.0)


def test_a_drive_that_pushes_against_a_brake_which_nobody_sees_closed_loses_its_voltage() -> None:
    settled = InState("settled", "roll")
    faults = (
        FaultSetting("brake_feedback_stuck_open", "roll", {}, settled),
        FaultSetting("torque_stuck_at_maximum", "roll_drive", {"direction": 1.0}, settled),
    )
    trial = FaultTrial("pushes unseen", "torque_stuck_at_maximum", "roll_drive", "drive", "settled", faults)
    outcome = run_trial(CARM, "roll", trial, motion_of(CARM, "roll", "scan"))
    assert (outcome.verdict, outcome.ending) == ("stopped", "held by its brake")
    assert outcome.said.startswith(KEEP_AWAY)
    gives = "it gives up to +161% of its rated effort, at most 96% hold the axis at any pose"
    told = f"roll not proven at rest: its drive did not hold it, {gives}, voltage off; its brake reports open; it stands"
    assert told in outcome.said
    assert outcome.contradicted == ()


@pytest.mark.nightly
@pytest.mark.parametrize("mode", MODES)
def test_no_wrong_torque_drives_an_arm_on(mode: str, tmp_path: Path) -> None:
    for outcome in tried(mode, tmp_path, TORQUES):
        judged(outcome)
