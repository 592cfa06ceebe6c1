"""The effort a simulation lacks, against efforts that were put on a mass in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pushed_mass import RAIL, recorded

from hil.diagnosis.locating.disturbance import disturbance, disturbance_shares
from hil.diagnosis.residuals.mismatch import mismatch

TIME = np.arange(2000) / RAIL.sample_rate_Hz
REFERENCE = 0.1 - 0.1 * np.cos(2.0 * np.pi * 0.4 * TIME)


@pytest.fixture(scope="module")
def seen():
    """A push of 6 N up and down a slow sine, in three noisy repeats."""

    def push(time: float, position: float, speed: float) -> float:
        return 6.0 * np.sin(5.0 * time)

    recordings = {f"repeat {k}": recorded(REFERENCE, push, k, noise=0.1) for k in range(3)}
    return mismatch(RAIL, recordings)


def test_the_missing_effort_is_the_push(seen):
    found = disturbance(seen, seen.groups[0])
    inner = slice(200, -200)
    shapes = np.column_stack([np.sin(5.0 * TIME), np.cos(5.0 * TIME), np.ones_like(TIME)])[inner]
    (along, across, constant), rest, *_ = np.linalg.lstsq(shapes, found.effort[inner, 0])
    assert found.joints == ("carriage",)
    assert (along, across, constant) == (pytest.approx(6.0, rel=0.03), pytest.approx(0.0, abs=0.3), pytest.approx(0.0, abs=0.3))
    assert np.sqrt(rest[0] / len(shapes)) < 0.6
    assert disturbance_shares(seen).joints["carriage"] > 0.95


def test_nothing_is_left_for_the_sensors(seen):
    assert max(disturbance_shares(seen).sensors.values()) < 0.05


def test_what_one_channel_reads_too_much_is_left_to_its_sensor(seen):
    """An effort that did that to the command would be seen in the position, which is read a thousand times as well."""
    (group,) = seen.groups
    error = 10.0 * seen.noise.std * np.sin(2.0 * np.pi * 20.0 * TIME)[:, None] * [name == "command_carriage" for name in seen.channels]
    wrong = replace(seen, groups=(replace(group, measured=group.simulated + error + (group.measured - group.mean)),))
    shares = disturbance_shares(wrong)
    assert list(shares.sensors) == ["command_carriage"]
    assert shares.sensors["command_carriage"] > 0.9 and shares.joints["carriage"] < 0.1
