"""Two encoders on a spring: a jump, a drift, a departure and a silence are found; the spring's windup is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.interface import Sample
from drivers.judging.encoders import EncoderJudge
from drivers.judging.settings import EncoderJudging

PERIOD_S = 1 / 256
COUNT, LINK_COUNT = 3.0e-6, 7.5e-7
J, B, K, SCALE = 75.0, 30.0, 1.07e5, 47.5
SETTINGS = EncoderJudging(
    "encoders_roll", 0, "rad", "mark", PERIOD_S, COUNT, 10.0, LINK_COUNT, 10.0, 3, 1.75e-3, 1.75e-4, 8e-6, 1 / K, J, B, SCALE
)

Spoil = Callable[[Sample, int], None]


def motion(rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motor side, link and effort of a rotor on a spring that carries a pendulum, by the closed form of a slow sine.

    The load on the spring is 900 Nm sin q and 150 kg m^2 times the acceleration.
    """
    t = np.arange(rows) * PERIOD_S
    w, a = 2 * np.pi * 0.2, 0.5
    q, v, acc = a * np.sin(w * t), a * w * np.cos(w * t), -a * w * w * np.sin(w * t)
    load = 900.0 * np.sin(q) + 150.0 * acc
    return q, q - load / K, (J * acc + B * v + load) / SCALE


def checks_of(
    spoil: Spoil, seconds: float = 20.0, settings: EncoderJudging = SETTINGS, ticks: Callable[[int], int] = lambda k: 1
) -> list[str]:
    rows = round(seconds / PERIOD_S)
    motor, link, effort = motion(rows)
    noise = 0.01 * np.random.default_rng(2).normal(size=rows)
    judge, sample, found = EncoderJudge(settings), Sample(1), []
    for k in range(rows):
        sample.position[0] = np.round(motor[k] / COUNT) * COUNT
        sample.link_position[0] = np.round(link[k] / LINK_COUNT) * LINK_COUNT
        sample.effort[0] = effort[k] + noise[k]
        sample.lateness_s = 0.0
        spoil(sample, k)
        found.append(judge.step(sample, ticks(k)))
        if found[-1]:
            assert "\n" not in judge.says(found[-1])
    return found


def test_the_windup_of_a_moving_loaded_spring_is_no_finding() -> None:
    assert np.ptp(motion(5120)[1] - motion(5120)[0]) > 10 * SETTINGS.drift  # it is large against what is allowed
    assert set(checks_of(lambda sample, k: None)) == {""}
    assert set(checks_of(lambda sample, k: None, settings=replace(SETTINGS, compliance=0.0))) != {""}


@pytest.mark.parametrize("channel", ["position", "link_position"])
def test_a_jump_by_a_hundred_counts_of_the_motor_side_is_found_at_once_and_stands(channel: str) -> None:
    def jump(sample: Sample, k: int) -> None:
        if k >= 1000:
            getattr(sample, channel)[0] += 100 * COUNT

    found = checks_of(jump)
    assert found.index("jump") == 1000
    assert set(found[1000:]) == {"jump"}


@pytest.mark.parametrize("channel", ["position", "link_position"])
@pytest.mark.parametrize("rate", [3e-5, 1e-4, -1e-3])
def test_a_drift_is_found_before_it_has_gone_far(channel: str, rate: float) -> None:
    def drift(sample: Sample, k: int) -> None:
        getattr(sample, channel)[0] += rate * max(0, k - 512) * PERIOD_S

    seconds = (checks_of(drift).index("drift") - 512) * PERIOD_S
    assert seconds * abs(rate) < max(1.5 * SETTINGS.drift, 3.0 * abs(rate))  # four windows of half a second at least


def test_a_departure_that_does_not_grow_is_found_beyond_the_tolerance_only() -> None:
    def away(by: float) -> Spoil:
        def spoil(sample: Sample, k: int) -> None:
            sample.link_position[0] += by

        return spoil

    assert set(checks_of(away(1.5e-3))) == {""}
    assert "apart" in checks_of(away(2.0e-3))


def test_a_link_encoder_that_is_silent_is_found_and_believed_when_it_speaks_again() -> None:
    def silence(sample: Sample, k: int) -> None:
        if 1000 <= k < 1010:
            sample.link_position[0] = np.nan

    found = checks_of(silence)
    assert [k for k, check in enumerate(found) if check] == list(range(1003, 1010))


def test_ticks_that_were_lost_and_a_late_sync_are_no_jumps() -> None:
    def stumble(sample: Sample, k: int) -> None:
        if k == 500:  # a millisecond late, at 0.5 rad/s or so
            sample.lateness_s = 1e-3
            sample.position[0] -= 5e-4
            sample.link_position[0] -= 5e-4
        if k >= 1000:  # twenty ticks later on
            sample.position[0] += 0.04
            sample.link_position[0] += 0.04

    assert set(checks_of(stumble, 5.0, ticks=lambda k: 21 if k == 1000 else 1)) == {""}


def test_an_axis_with_one_encoder_is_judged_for_jumps_alone() -> None:
    single = replace(SETTINGS, link_resolution=0.0)

    def spoil(sample: Sample, k: int) -> None:
        sample.link_position[0] = np.nan
        if k >= 1000:
            sample.position[0] += 100 * COUNT

    assert checks_of(spoil, settings=single).index("jump") == 1000
