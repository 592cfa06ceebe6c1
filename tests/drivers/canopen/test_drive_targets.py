"""Positions and velocities that drives with loops of their own are sent: whole counts, over the end of the counter, either way round."""

from __future__ import annotations

import dataclasses
import math

import pytest
from scripted_nodes import machine_settings

from drivers.canopen.process_data import AxisInput, AxisOutput
from drivers.errors import MotionRefusedError
from drivers.settings import LoopMode

SETTINGS = machine_settings()
COUNT = 2.0**-16
TARGETS = {"position": 0x607A, "velocity": 0x60FF}


def drive(mode: LoopMode, sign: int = 1) -> tuple[AxisInput, AxisOutput]:
    scaling = dataclasses.replace(SETTINGS.scalings[0], mode=mode, sign=sign, position_resolution=COUNT)
    entries = ((0x6040, 0, 16), (TARGETS[mode.removeprefix("profile_")], 0, 32), (0x60B2, 0, 16))
    node = dataclasses.replace(SETTINGS.nodes[0], rpdos=(dataclasses.replace(SETTINGS.nodes[0].rpdos[0], entries=entries),))
    source = AxisInput(scaling)
    return source, AxisOutput(node, scaling, source)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("raw", [0, 5, -70000, 2**31 - 1, -(2**31)])
def test_a_position_that_was_read_is_sent_as_the_count_that_was_read(raw: int, sign: int) -> None:
    source, output = drive("position", sign)
    source.position(-raw // 2)
    source.offset = 0.25
    output.lead_to(source.position(raw))
    assert output.target == raw


@pytest.mark.parametrize("sign", [1, -1])
def test_a_target_goes_on_over_the_end_of_the_counter(sign: int) -> None:
    source, output = drive("position", sign)
    end = source.position(2**31 - 1)
    output.lead_to(end + sign * 3 * COUNT)
    assert output.target == -(2**31) + 2


@pytest.mark.parametrize("mode", ["position", "velocity"])
def test_targets_between_counts_lose_nothing_by_rounding(mode: LoopMode) -> None:
    _, output = drive(mode)
    sent = []
    for _ in range(1000):
        output.lead_to(0.3 * COUNT)
        sent.append(output.target)
    assert set(sent) == {0, 1}
    assert abs(sum(sent) - 300) <= 1


def test_a_set_point_of_a_profile_is_its_own_nearest_count() -> None:
    _, output = drive("profile_position")
    output.lead_to(0.4 * COUNT)
    output.lead_to(0.4 * COUNT)
    assert output.target == 0


@pytest.mark.parametrize("way", [1, -1])
def test_a_velocity_beyond_the_wire_keeps_its_direction(way: int) -> None:
    _, output = drive("velocity")
    output.lead_to(way * 2.0**31 * COUNT)
    assert output.target == way * (2**31 - 1)


@pytest.mark.parametrize("mode", ["position", "velocity"])
@pytest.mark.parametrize("target", [math.nan, math.inf])
def test_no_number_is_no_target(mode: LoopMode, target: float) -> None:
    _, output = drive(mode)
    with pytest.raises(MotionRefusedError, match=f"{SETTINGS.scalings[0].axis}: the target is {target}; no number, no motion"):
        output.lead_to(target)


def test_a_drive_that_is_to_stand_keeps_its_target_only_while_it_is_enabled() -> None:
    source, output = drive("position")
    output.lead_to(100 * COUNT)
    source.statusword = 0x0027
    source.position(90)
    output.stand()
    assert output.target == 100
    source.statusword = 0x0007  # quick stop active
    output.stand()
    assert output.target == 90
    _, output = drive("velocity")
    output.lead_to(100 * COUNT)
    output.stand()
    assert output.target == 0


@pytest.mark.parametrize("sign", [1, -1])
def test_a_drive_that_goes_by_itself_is_not_sent_over_the_end_of_its_counter(sign: int) -> None:
    source, output = drive("profile_position", sign)
    end = source.position(2**31 - 10)
    output.lead_to(end + sign * 9 * COUNT)
    assert output.target == 2**31 - 1
    with pytest.raises(MotionRefusedError, match="would go the other way round"):
        output.lead_to(end + sign * 10 * COUNT)
    source.position(-(2**31))  # pushed over the end
    output.lead_to(end + sign * 15 * COUNT)
    assert output.target == -(2**31) + 5
