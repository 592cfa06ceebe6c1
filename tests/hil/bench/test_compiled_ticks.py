"""Compiled, the laws of a tick find, keep and write what they do in Python, bit for bit."""

from __future__ import annotations

import dataclasses
from math import nan

import numpy as np
import pytest
from scripted_bench import AXES, PERIOD_S, layout, still
from scripted_nodes import machine_settings

from controllers.settings import AxisLimits
from drivers.canopen.motion_bounds import CHECKS, MotionWatch
from drivers.interface import Sample
from drivers.settings import HomingSettings, MotionLimits
from hil.bench import bounds, row_layout
from hil.bench.bounds import Bounds
from hil.bench.compiled_judging import watched_at_once
from hil.bench.row_layout import AxisColumns, RowLayout
from hil.recording.channels import imu_channels

SETTINGS = machine_settings()
COUNT = 2.0**-16
HOMING: HomingSettings = dataclasses.replace(SETTINGS.homings[1], method=17, speed=0.1, travel_limit=0.05)


class Clock:
    """No tick is lost, unless a test says so."""

    missed = 0


def moved(sample: Sample, random: np.random.Generator, wrong: float) -> None:
    """Move both axes on by some counts, with what may go wrong with each now and then."""
    for axis in range(len(AXES)):
        step = random.integers(-40, 60) * COUNT * (1.0 if random.random() > wrong else 30.0)
        before = sample.position[axis] if np.isfinite(sample.position[axis]) else 0.1 * random.normal()
        sample.position[axis] = before + step if random.random() > wrong else random.choice((nan, np.inf, 1.5))
        sample.link_position[axis] = sample.position[axis] + random.integers(-3, 4) * COUNT if random.random() > wrong else nan
        sample.position_late[axis], sample.link_late[axis] = random.random(2) < wrong
        sample.effort[axis], sample.age_s[axis], sample.temperature_degC[axis] = random.normal(size=3)
        sample.statusword[axis] = random.integers(-1, 3)
    sample.imu[:], sample.bus_imu[:] = random.normal(size=(2, 6))
    sample.imu_counter, sample.bus_imu_counter = (int(each) for each in random.integers(-1, 9, 2))
    sample.imu_time_s = random.random()
    sample.unanswered = int(random.random() < wrong)


@pytest.mark.parametrize("seed", range(6))
def test_the_watch_over_all_axes_finds_the_same(seed: int) -> None:
    random, clock = np.random.default_rng(seed), Clock()
    scalings = [
        dataclasses.replace(scaling, position_resolution=COUNT, link_resolution=COUNT * (axis == 1 or seed % 2))
        for axis, scaling in enumerate(SETTINGS.scalings)
    ]
    limits = [MotionLimits(axis, -1.0, 1.0, 0.25, 2.0**-5, 3) for axis in AXES]
    ways = [MotionWatch(limits, scalings, clock, PERIOD_S) for _ in range(2)]
    ways[1].law = watched_at_once
    found = set()
    for _ in range(24):
        phase = random.choice(("stand", "settle", "lead", "home", "homed"))
        for watch in ways:
            watch.homed(0)
            watch.home(1, HOMING) if phase == "home" else watch.homed(1) if phase == "homed" else getattr(watch, phase)()
        sample, wrong = Sample(len(AXES)), random.choice((0.0, 0.002, 0.05))
        for _ in range(60):
            moved(sample, random, wrong)
            clock.missed += int(random.random() < wrong)
            alone, compiled = (watch.check(sample) for watch in ways)
            assert compiled == alone
            assert ways[1].states.tobytes() == ways[0].states.tobytes()
            found.add(alone.partition(": ")[2][:24])
    assert len(found) > 4, f"of {len(CHECKS)} checks too few were tried: {found}"


@pytest.mark.parametrize("seed", range(6))
def test_the_loops_bounds_find_the_same(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    random, sample = np.random.default_rng(seed), Sample(len(AXES))
    limits = [AxisLimits(axis, -1.0, 1.0, 1.0, 1.0, 1.0, 0.4) for axis in AXES]
    ways, found = [Bounds(limits, 2) for _ in range(2)], set()
    for k in range(600):
        moved(sample, random, 0.1)
        sample.position[random.random(len(AXES)) < 0.5 * (k % 50 > 25)] = nan
        reference = 0.2 * random.normal(size=len(AXES))
        compiled = ways[1].see(sample, reference)
        with monkeypatch.context() as plain:
            plain.setattr(bounds, "_seen_at_once", bounds.seen)
            alone = ways[0].see(sample, reference)
        assert (compiled, ways[1].position.tobytes()) == (alone, ways[0].position.tobytes())
        assert not alone or ways[1].says(compiled, reference) == ways[0].says(alone, reference)
        found.add(alone % len(bounds.CHECKS))
    assert found == set(range(len(bounds.CHECKS)))


def test_a_row_is_filled_with_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    random, sample, plan = np.random.default_rng(0), Sample(len(AXES)), still(200)
    for values in (plan.reference, plan.reference_raw, plan.excitation):
        values[:] = random.normal(size=values.shape)
    columns = layout()
    rows = np.full((2, columns.width), nan)
    for k in range(200):
        moved(sample, random, 0.1)
        plan.feedforward = random.normal(size=(200, 2)) if k % 2 else None
        rest = (k, sample, plan, random.normal(size=2), tuple(random.random(3)), k % 5)
        columns.fill(rows[0], *rest)
        with monkeypatch.context() as plain:
            plain.setattr(row_layout, "_fill", row_layout._fill.py_func)  # type: ignore[attr-defined]
            columns.fill(rows[1], *rest)
        assert rows[0].tobytes() == rows[1].tobytes()


def test_a_sample_of_other_axes_is_refused() -> None:
    with pytest.raises(ValueError, match="a sample of 2 axes and limits of 1"):
        Bounds([AxisLimits("roll", -1.0, 1.0, 1.0, 1.0, 1.0, 0.4)], 2).see(Sample(2), np.zeros(1))
    columns, plan = layout(), still(1)
    with pytest.raises(ValueError, match="a sample of 3 axes and a row of 2"):
        columns.fill(np.zeros(columns.width), 0, Sample(3), plan, np.zeros(2), (0.0, 0.0, 0.0))


def test_every_value_of_a_row_stands_in_its_channel() -> None:
    columns = RowLayout(
        [AxisColumns(axis, "rad", "A", "A") for axis in AXES], PERIOD_S, imu="imu", bus_imu="near", link=True, temperature=False
    )
    sample, plan, row = Sample(len(AXES)), still(3), np.full(columns.width, -7.0)
    given = {"position": 1.0, "link_position": 3.0, "effort": 5.0, "age_s": 7.0}
    for name, first in given.items():
        getattr(sample, name)[:] = first, first + 1.0
    sample.statusword[:] = 9, -1
    sample.imu[:], sample.bus_imu[:] = np.arange(11.0, 17.0), np.arange(21.0, 27.0)
    sample.imu_time_s, sample.imu_counter, sample.bus_imu_counter = 0.5, -1, 31
    columns.fill(row, 2, sample, plan, np.array([41.0, 42.0]), (0.1, 0.2, 0.3), 6)
    got = dict(zip([name for name, _ in columns.channels], row.tolist(), strict=True))
    assert [got[f"{name}_{axis}"] for name in ("position", "link_position", "current", "data_age", "command") for axis in AXES] == [
        *(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 41.0, 42.0)
    ]
    assert [got[f"statusword_{AXES[0]}"], got["imu_time"], got["near_counter"], got["near_time"], got["time"]] == [
        *(9.0, 0.5, 31.0, 2 * PERIOD_S, 2 * PERIOD_S)
    ]
    assert np.isnan([got[f"statusword_{AXES[1]}"], got["imu_counter"]]).all()
    assert [got[name] for name in imu_channels("imu")] == np.arange(11.0, 17.0).tolist()
    assert [got[name] for name in imu_channels("near")] == np.arange(21.0, 27.0).tolist()
    assert [got[name] for name in ("sync_lateness", "work_time", "answer_time", "sensor_marks")] == [0.1, 0.2, 0.3, 6.0]
