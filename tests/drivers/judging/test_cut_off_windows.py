"""What the end of a run cuts off of a window is judged where it is half of one at least."""

from __future__ import annotations

import pytest

from drivers.interface import Sample
from drivers.judging.judge import SensorJudge
from drivers.judging.settings import ENCODERS_WINDOW_S as WINDOW_S
from drivers.judging.settings import EncoderJudging, JudgingSettings

PERIOD_S = 1 / 256
WINDOW = round(WINDOW_S / PERIOD_S)
ROLL = EncoderJudging("encoders_roll", 0, "rad", "mark", PERIOD_S, 1e-6, 1e3, 1e-6, 1e3, 3, tolerance=1e-3)


@pytest.mark.parametrize(("ticks", "found"), [(WINDOW // 2, True), (WINDOW // 2 - 1, False)])
def test_encoders_that_part_shortly_before_the_end_are_found(ticks: int, found: bool) -> None:
    judge, sample = SensorJudge(JudgingSettings(encoders=(ROLL,)), PERIOD_S), Sample(1)
    sample.position[0] = sample.link_position[0] = sample.effort[0] = 0.0
    for k in range(2 * WINDOW):
        judge.step(sample, 1, k * PERIOD_S)
    for k in range(ticks):
        sample.link_position[0] = 2e-3 * k / ticks + 1e-3
        judge.step(sample, 1, k * PERIOD_S)
    judge.finish(3.0)
    assert [finding.check for finding in judge.findings] == (["apart"] if found else [])
    judge.finish(3.0)
    assert len(judge.findings) == found, "once"
