"""Units of a drive's velocities, against the standard's formula worked out in turns of the motor and against makers' own words for them."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction

import pytest
from scripted_nodes import machine_settings

from drivers.canopen.process_data import AxisInput, AxisOutput
from drivers.canopen.units import check_units, units_of, whole_speed
from drivers.errors import ConfigurationRefusedError

SCALING = dataclasses.replace(machine_settings().scalings[0], counts_per_motor_turn=4096.0)
RPM, MILLI_RPM, RPM_PER_S = 0x00B44700, 0xFDB44700, 0x00C00300  # as EPOS4 and Synapticon have them


def reading(objects: dict[tuple[int, int], int]):  # noqa: ANN201
    return lambda index, subindex: objects.get((index, subindex))


@pytest.mark.parametrize(
    ("resolution", "velocity_resolution", "gear", "feed", "factor"),
    [
        ((4096, 1), (4096, 1), (1, 1), (4096, 1), (1, 1)),
        ((4096, 1), (4096, 1), (1, 1), (4096, 1), (60, 4096)),  # revolutions per minute
        ((2000, 3), (500, 1), (7, 2), (360_000, 1), (60, 1)),  # thousandths of a degree behind a gear, per minute
        ((10_000, 1), (1, 4), (1, 5), (1, 1), (1000, 7)),
    ],
)
def test_the_standards_factors_at_a_turning_motor(resolution, velocity_resolution, gear, feed, factor) -> None:  # noqa: ANN001
    turns_s = Fraction(17, 3)
    R, V, G, F, K = (Fraction(*ratio) for ratio in (resolution, velocity_resolution, gear, feed, factor))
    position_units_s = turns_s * R * F / (R * G)
    velocity = turns_s * V * F / (V * G) * K
    ratios = {0x608F: resolution, 0x6090: velocity_resolution, 0x6091: gear, 0x6092: feed, 0x6096: factor}
    units = units_of(reading({(i, s + 1): n for i, ratio in ratios.items() for s, n in enumerate(ratio)}), SCALING, "drive")
    assert units.velocity * float(position_units_s) == pytest.approx(float(velocity), rel=1e-12)
    assert units.acceleration == units.velocity


@pytest.mark.parametrize(
    ("objects", "counts_s", "shown"),
    [
        ({(0x60A9, 0): RPM}, 4096.0, 60.0),
        ({(0x60A9, 0): MILLI_RPM}, 4096.0, 60_000.0),
        ({(0x60A9, 0): RPM, (0x6091, 1): 10, (0x6091, 2): 1}, 40_960.0, 60.0),  # turns of the shaft behind a gear of 10
        ({(0x60A9, 0): 0x00100300}, 4096.0, 2.0 * math.pi),  # rad/s
        ({(0x60A8, 0): 0xFD410000, (0x60A9, 0): 0x00410300}, 1500.0, 1.5),  # thousandths of a degree, degrees per second
        ({(0x60A8, 0): 0xFD010000, (0x60A9, 0): 0xFD014700}, 2.0, 120.0),  # mm, mm/min
        ({(0x60A8, 0): 0x00B50000, (0x60A9, 0): 0x00B50300}, 7.0, 7.0),
        ({(0x608B, 0): 0, (0x608C, 0): 0xA4}, 4096.0, 60.0),  # EPOS2
        ({}, 3.0, 3.0),
    ],
)
def test_a_unit_of_its_own_shows_what_it_says(objects: dict[tuple[int, int], int], counts_s: float, shown: float) -> None:
    assert units_of(reading(objects), SCALING, "drive").velocity * counts_s == pytest.approx(shown, rel=1e-12)


def test_a_machine_file_says_the_units_of_a_drive_that_says_none() -> None:
    scaling = dataclasses.replace(SCALING, velocity_unit="rpm", acceleration_unit="rev/s^2")
    units = units_of(reading({}), scaling, "drive")
    assert (units.velocity * 4096.0, units.acceleration * 4096.0) == pytest.approx((60.0, 1.0), rel=1e-12)
    scaling = dataclasses.replace(SCALING, velocity_unit="rev/s")
    assert units_of(reading({(0x60AA, 0): RPM_PER_S}), scaling, "drive").acceleration == pytest.approx(60.0 / 4096.0)


def test_a_velocity_in_rpm_is_sent_in_rpm() -> None:
    nodes = machine_settings().nodes
    scaling = dataclasses.replace(SCALING, mode="velocity", position_resolution=2.0 * math.pi / (4096 * 500))
    entries = ((0x6040, 0, 16), (0x60FF, 0, 32), (0x60B2, 0, 16))
    node = dataclasses.replace(nodes[0], rpdos=(dataclasses.replace(nodes[0].rpdos[0], entries=entries),))
    output = AxisOutput(node, scaling, AxisInput(scaling), units_of(reading({(0x60A9, 0): RPM}), scaling, "drive"))
    output.lead_to(0.1)  # rad/s at the joint behind a gear of 500
    assert output.target == scaling.sign * round(0.1 * 500 * 60 / (2.0 * math.pi))


@pytest.mark.parametrize(
    ("objects", "declared", "words"),
    [
        ({(0x60A9, 0): 0x00010300}, "", r"60A9h\) is 00010300h.*velocity_unit"),  # m/s of counts that are not metres
        ({(0x60A9, 0): RPM, (0x6092, 1): 3000, (0x6092, 2): 1}, "", "3000 counts by its feed constant.*4096 by the machine file"),
        ({(0x6094, 1): 3, (0x6094, 2): 2}, "", "6094h is 1.5"),
        ({(0x608C, 0): 0x55}, "", "608Ch"),
    ],
)
def test_a_unit_that_says_nothing_of_the_counts_is_refused(objects: dict[tuple[int, int], int], declared: str, words: str) -> None:
    with pytest.raises(ConfigurationRefusedError, match=words):
        units_of(reading(objects), dataclasses.replace(SCALING, velocity_unit=declared), "drive")


@pytest.mark.parametrize(("declared", "by"), [("", "data sheet"), ("counts/s", "machine file")])
def test_a_drive_that_says_another_unit_than_was_thought_is_refused(declared: str, by: str) -> None:
    scaling = dataclasses.replace(SCALING, velocity_unit=declared)
    used = units_of(reading({}), scaling, "drive")
    with pytest.raises(ConfigurationRefusedError, match=f"unit of velocity.*{by}"):
        check_units(reading({(0x60A9, 0): MILLI_RPM}), used, scaling, "drive")
    check_units(reading({}), used, scaling, "drive")


@pytest.mark.parametrize(
    ("objects", "acceleration"),
    [
        ({(0x608C, 0): 0x55}, 60.0),
        ({(0x6094, 1): 3, (0x6094, 2): 2}, 60.0),
        ({(0x60A9, 0): 0x00010300}, 60.0),
        ({(0x6097, 1): 10, (0x6097, 2): 1}, 600.0),  # by the drive's own acceleration factor
    ],
)
def test_a_declared_velocity_is_one_whatever_the_drive_says_of_it(objects: dict[tuple[int, int], int], acceleration: float) -> None:
    scaling = dataclasses.replace(SCALING, velocity_unit="rpm")
    units = units_of(reading(objects), scaling, "drive")
    assert (units.velocity * 4096.0, units.acceleration * 4096.0) == pytest.approx((60.0, acceleration), rel=1e-12)


def test_an_acceleration_factor_is_of_counts_where_nothing_is_said_of_velocities() -> None:
    assert units_of(reading({(0x6097, 1): 10, (0x6097, 2): 1}), SCALING, "drive").acceleration == 10.0


@pytest.mark.parametrize(
    ("objects", "words"),
    [
        ({(0x60AA, 0): 0x00010300}, r"60AAh\) is 00010300h.*say drives\.\w+\.acceleration_unit"),
        ({(0x60A8, 0): 0xFD410000, (0x60A9, 0): 0x00410500}, r"60A9h\) is 00410500h"),  # degrees per what is no time
        ({(0x6094, 1): 172, (0x6094, 2): 1}, "6094h is 172"),  # the code of increments, which is none of a factor
    ],
)
def test_a_unit_that_is_not_known_says_which_object_has_it(objects: dict[tuple[int, int], int], words: str) -> None:
    with pytest.raises(ConfigurationRefusedError, match=words):
        units_of(reading(objects), SCALING, "drive")


@pytest.mark.parametrize(("units", "whole", "told"), [(1.0, 1, 0), (1.99, 1, 1), (8.5, 8, 0), (8.95, 8, 1), (5000.0 - 1e-9, 5000, 0)])
def test_a_speed_is_rounded_down_and_told_where_a_tenth_is_lost(units: float, whole: int, told: int) -> None:
    value, notes = whole_speed(units, "drive: 6081h")
    assert (value, len(notes)) == (whole, told)


def test_a_speed_below_one_unit_is_refused() -> None:
    with pytest.raises(ConfigurationRefusedError, match=r"6081h takes no speed as low as 0\.278 of its units"):
        whole_speed(1.0 / 3.6, "drive: 6081h")
