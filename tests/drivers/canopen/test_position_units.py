"""How many counts a turn of the motor is by a drive's own objects, beside the machine file's number."""

from __future__ import annotations

import dataclasses

import pytest
from scripted_nodes import machine_settings

from drivers.canopen.units import ENCODER_RESOLUTION, FEED_CONSTANT, GEAR_RATIO, check_positions
from drivers.errors import ConfigurationRefusedError

FILED = 4096.0
SCALING = dataclasses.replace(machine_settings().scalings[1], counts_per_motor_turn=FILED)


def checked(encoder: tuple[int, int] | None = None, feed: tuple[int, int] | None = None, gear: tuple[int, int] | None = None) -> None:
    objects = {ENCODER_RESOLUTION: encoder, FEED_CONSTANT: feed, GEAR_RATIO: gear}

    def read(index: int, subindex: int) -> int | None:
        ratio = objects[index]
        return None if ratio is None else ratio[subindex - 1]

    check_positions(read, SCALING, "roll_drive")


def test_what_agrees_and_what_nobody_has_set_is_taken() -> None:
    checked()
    checked(encoder=(4096, 1))
    checked(encoder=(1, 1))
    checked(encoder=(4096, 1), feed=(1, 1))
    checked(feed=(40960, 1), gear=(10, 1))


@pytest.mark.parametrize(
    ("objects", "counts"),
    [({"encoder": (16384, 1)}, "16384"), ({"feed": (4000, 1)}, "4000"), ({"feed": (10, 1), "gear": (10, 1)}, "1")],
)
def test_another_number_is_refused_with_both(objects: dict[str, tuple[int, int]], counts: str) -> None:
    with pytest.raises(ConfigurationRefusedError, match=rf"roll_drive: a turn of its motor is {counts} counts .*4096 by the machine file"):
        checked(**objects)
