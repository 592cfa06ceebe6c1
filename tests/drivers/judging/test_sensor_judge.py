"""Thermometers and warnings, and what all judges together say: marks, findings, a reason to stop, and when something begins and ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drivers.interface import Sample
from drivers.judging.judge import SensorJudge
from drivers.judging.settings import DriveJudging, Follows, JudgingSettings, TemperatureJudging

PERIOD_S = 1 / 256


def judged(
    spoil: Callable[[Sample, int], None], rows: int = 2000, follows: Follows = "mark"
) -> tuple[SensorJudge, list[int], list[str], list[tuple[float, str, str, str]]]:
    """Marks and reasons by row of an axis with thermometer and drive, and what was noticed."""
    temperature = TemperatureJudging("temperature_roll", 0, follows, PERIOD_S, 120.0, 0.085, 0.1, 0.5)
    noticed: list[tuple[float, str, str, str]] = []
    drive = DriveJudging("drive_roll", 0, "A", "mark", tolerance=0.5, settling_ticks=2, bridged_ticks=3)
    settings = JudgingSettings(temperatures=(temperature,), drives=(drive,))
    judge = SensorJudge(settings, PERIOD_S, lambda *what: noticed.append(what))
    sample, marks, reasons = Sample(1), [], []
    for k in range(rows):
        sample.temperature_degC[0] = np.round(24.0 + 0.08 * k * PERIOD_S, 1)
        sample.statusword[0], sample.io_age_s = 0x1637, 0.05
        spoil(sample, k)
        reasons.append(judge.step(sample, 1, k * PERIOD_S))
        marks.append(judge.marks)
    return judge, marks, reasons, noticed


def test_a_winding_that_heats_as_fast_as_it_can_is_no_finding() -> None:
    judge, marks, reasons, noticed = judged(lambda sample, k: None, 30_000)
    assert judge.sensors == ("temperature_roll", "drive_roll")
    assert set(marks) == {0}
    assert not any(reasons)
    assert not judge.findings
    assert not noticed


def test_limit_broken_wire_and_a_change_too_fast_are_told_apart() -> None:
    for value, check in ((150.0, "limit"), (np.nan, "broken"), (60.0, "rate")):

        def spoil(sample: Sample, k: int, value: float = value) -> None:
            if k >= 100:
                sample.temperature_degC[0] = value

        judge, marks, _, _ = judged(spoil, 200)
        assert marks == [0] * 100 + [1] * 100
        (finding,) = judge.findings
        assert (finding.check, finding.rows, finding.first_s) == (check, 100, 100 * PERIOD_S)


def test_an_io_that_is_silent_says_nothing_of_its_thermometers() -> None:
    def spoil(sample: Sample, k: int) -> None:
        if k >= 100:
            sample.io_age_s, sample.temperature_degC[0] = 1.0, np.nan

    assert not judged(spoil)[0].findings


def test_what_follows_is_a_stop_where_the_settings_say_so() -> None:
    def spoil(sample: Sample, k: int) -> None:
        if k == 100:
            sample.temperature_degC[0] = 150.0

    _, _, reasons, _ = judged(spoil, follows="stop")
    assert [k for k, reason in enumerate(reasons) if reason] == [100]
    assert reasons[100] == "temperature_roll: 150.0 degC, 120.0 are allowed"
    assert not any(judged(spoil)[2])


def test_a_warning_marks_its_rows_and_is_noticed_when_it_begins_and_ends() -> None:
    def spoil(sample: Sample, k: int) -> None:
        if 100 <= k < 150:
            sample.statusword[0] |= 0x80

    judge, marks, _, noticed = judged(spoil)
    assert np.flatnonzero(np.array(marks) == 2).tolist() == list(range(100, 150))
    assert [(time_s, sensor, bool(says)) for time_s, sensor, _, says in noticed] == [
        (100 * PERIOD_S, "drive_roll", True),
        (150 * PERIOD_S, "drive_roll", False),
    ]
    judge.restart()
    assert not judge.findings


def test_findings_are_kept_once_however_often_a_check_fails() -> None:
    judge, _, _, _ = judged(lambda sample, k: sample.statusword.fill(0x1637 | (0x80 if k % 2 else 0)))
    (finding,) = judge.findings
    assert finding.rows == 1000
    assert replace(finding, rows=0).last_s == 1999 * PERIOD_S
