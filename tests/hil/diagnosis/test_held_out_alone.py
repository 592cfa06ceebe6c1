"""Physics that held-out recordings alone show: training never comes where it acts."""

from __future__ import annotations

import pytest
from carriage import MACHINE, recording, reference, repeats, run

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.report.page import report_blocks

pytestmark = pytest.mark.nightly

STOP_m, STIFFNESS_N_per_m = 0.065, 2e5
DURATION_s = 2.0


def stop(x: float) -> float:
    return -STIFFNESS_N_per_m * max(x - STOP_m, 0.0)


@pytest.mark.slow
def test_a_stop_that_training_does_not_reach_is_located_and_drawn_in_the_held_out_recording():
    wanted = reference(DURATION_s)
    assert wanted.max() < STOP_m < 1.5 * wanted.max()
    further = recording(1.5 * wanted, *run(1.5 * wanted, at=stop))
    outcome = diagnose(MACHINE, repeats(3, DURATION_s, at=stop), {"further": further}, look_further=False)
    assert outcome.diagnosis.verdict == "unknown_physics" and outcome.diagnosis.findings == ()
    assert outcome.diagnosis.location.channels
    assert outcome.is_only_held_out and outcome.short.groups[0].labels == ("further",)
    assert outcome.diagnosis.disturbance.joints["carriage"] > 0.5
    assert [picture.alt for picture in report_blocks(outcome)["heat"]] == [
        "Residual over the pose of carriage, held-out, re-tuned to it alone"
    ]


@pytest.mark.slow
def test_the_same_motion_without_a_stop_is_no_more_than_its_numbers_say():
    wanted = reference(DURATION_s)
    outcome = diagnose(MACHINE, repeats(3, DURATION_s), {"further": recording(1.5 * wanted, *run(1.5 * wanted))}, look_further=False)
    assert outcome.diagnosis.verdict in ("consistent", "retuned") and not outcome.is_only_held_out
    assert outcome.diagnosis.disturbance.joints == {} and outcome.diagnosis.unexplained_share == 0.0
