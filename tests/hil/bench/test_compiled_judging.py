"""Compiled, all judges find what each finds by itself in Python, bit for bit."""

from __future__ import annotations

import dataclasses
from math import inf, nan

import numpy as np
import pytest

from drivers.interface import Sample
from drivers.judging.judge import SensorJudge, judged
from drivers.judging.motion_means import Expected
from drivers.judging.motion_window import average
from drivers.judging.settings import DriveJudging, EncoderJudging, ImuJudging, JudgingSettings, TemperatureJudging
from hil.bench.compiled_judging import averaged_at_once, judged_at_once

PERIOD_S = 1.0 / 64.0
AXES = 2
SETTINGS = JudgingSettings(
    ImuJudging("imu", "mark", PERIOD_S, 64.0, 0.1, 0.1, (30.0,) * 3 + (5.0,) * 3, (4,) * 6, 2, force_tolerance=4.0, turn_tolerance=1.0),
    (
        EncoderJudging(
            *("encoders_0", 0, "rad", "mark", PERIOD_S, 1e-3, 50.0, 1e-3, 50.0, 3, 0.2, 0.1, 1e-3),
            *(1e-3, 2.0, 0.5, 3.0),
        ),
        EncoderJudging("encoders_1", 1, "rad", "stop", PERIOD_S, 1e-3, 80.0),
    ),
    tuple(TemperatureJudging(f"temperature_{axis}", axis, "stop", PERIOD_S, 80.0, 0.5, 0.1, 0.5) for axis in range(AXES)),
    (DriveJudging("drive_0", 0, "A", "mark", 0.3, 3, 2, 0.5, 2.0), DriveJudging("drive_1", 1, "A", "mark", 0.3, 1, 3, inf, inf)),
    lambda means: Expected(0.9 * means.effort, 0.01 * np.ones(AXES), np.zeros(6)),
)


def samples(seed: int, rows: int) -> list[tuple[Sample, int, bool]]:
    """Samples of a machine that moves, with what may go wrong with each now and then; ticks since the one before; whether it is led."""
    random = np.random.default_rng(seed)
    wrong, position, silent = random.choice((0.003, 0.03)), np.zeros(AXES), 0
    found = []
    for k in range(rows):
        sample = Sample(AXES)
        position += 0.01 * np.sin(0.05 * k + np.arange(AXES)) + (random.random(AXES) < wrong) * random.normal(size=AXES)
        sample.position[:] = position
        sample.link_position[:] = position + 1e-3 * random.normal(size=AXES) + 1e-4 * k * (seed % 3 == 0)
        sample.effort[:] = np.sin(0.1 * k) + (random.random(AXES) < wrong) * 3.0
        sample.commanded[:] = np.sin(0.1 * k)
        sample.statusword[:] = np.where(random.random(AXES) < wrong, 0x00B7, 0x0037)
        sample.temperature_degC[:] = 20.0 + np.where(random.random(AXES) < wrong, random.choice((nan, 70.0, 3.0)), 0.0)
        silent = 12 if random.random() < wrong else max(0, silent - 1)
        sample.imu[:] = random.normal(size=6) * (1.0 + 40.0 * (random.random() < wrong)) if random.random() > wrong else sample.imu
        sample.imu_counter, sample.imu_time_s = (-1, nan) if silent else (k, k * PERIOD_S - 0.05 * (seed % 4 == 0) * (k > rows // 2))
        sample.imu_damaged = k // 40 * 3 * (seed % 5 == 0)
        sample.imu_fault = "imu on /dev/ttyS0: reports a fault" if random.random() < wrong / 10.0 else ""
        sample.lateness_s = 1e-4 * abs(random.normal())
        sample.io_age_s = 1.0 if random.random() < wrong else 0.01
        for values in (sample.position, sample.link_position, sample.effort):
            values[random.random(AXES) < wrong] = nan
        found.append((sample, int(random.choice((1, 1, 2, 5))) if random.random() < wrong else 1, bool(random.random() > 0.02)))
    return found


@pytest.mark.parametrize("seed", range(12))
def test_compiled_or_not_the_judges_find_the_same(seed: int) -> None:
    laws = (judged, average), (judged_at_once, averaged_at_once)
    ways = [SensorJudge(SETTINGS, PERIOD_S, law=law, average=mean) for law, mean in laws]
    marked = set()
    for k, (sample, ticks, led) in enumerate(samples(seed, 400)):
        ways[1].rehearse()  # without consequence
        alone, compiled = (judge.step(sample, ticks, k * PERIOD_S, led=led) for judge in ways)
        assert (compiled, ways[1].marks) == (alone, ways[0].marks), f"seed {seed}, row {k}"
        marked.add(ways[0].marks)
    for judge in ways:
        judge.finish(400 * PERIOD_S)
    assert [dataclasses.astuple(each) for each in ways[1].findings] == [dataclasses.astuple(each) for each in ways[0].findings]
    assert len(marked) > 1, "something was wrong, and something was not"
