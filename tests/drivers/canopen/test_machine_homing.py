"""Homing: where the zero comes from, what it agrees with, and how a homing that fails says so."""

from __future__ import annotations

import numpy as np
import pytest
from machine_rig import RESOLUTION, ZERO, Rig

from drivers.errors import MotionRefusedError


@pytest.fixture
def rig() -> Rig:
    rig = Rig()
    rig.machine.start()
    return rig


def test_homing_at_the_present_position_takes_the_joint_from_the_link_encoder(rig: Rig) -> None:
    rig.drives[0].link_counts = 4194304 + 500_000
    rig.machine.home(check_first_move=False)
    sample = rig.machine.exchange(ZERO)
    assert sample.position[0] == pytest.approx(500_000 * 2 * np.pi / 2**23)
    assert sample.position == pytest.approx(sample.link_position)


def test_homing_that_moves_opens_the_brake_sets_speeds_in_counts_and_trusts_the_drives_zero() -> None:
    rig = Rig(method=33)
    for drive in rig.drives:
        drive.homing_ticks = 40
        drive.counts, drive.link_counts = 0.0, 4194304.0
    rig.machine.start()
    rig.machine.home(check_first_move=False)
    assert [rig.drives[0].value(0x6099, s) for s in (1, 2)] == [round(0.035 / RESOLUTION)] * 2
    assert rig.drives[0].value(0x609A) == round(0.17 / RESOLUTION)
    assert {"propeller": True} in rig.io.history
    assert rig.machine.exchange(ZERO).position == pytest.approx([0.0, 0.0])
    assert rig.at_rest()


def test_a_zero_that_does_not_agree_with_the_link_encoder_is_refused() -> None:
    rig = Rig(method=33)
    rig.drives[0].link_counts = 4194304 + 5000  # 3.7 mrad, 1.7 mrad are allowed
    rig.machine.start()
    with pytest.raises(MotionRefusedError, match=r"propeller: motor side \+0\.00000 rad, link encoder \+0\.00375 rad: they differ by 3\.7"):
        rig.machine.home(check_first_move=False)
    assert rig.at_rest()


@pytest.mark.parametrize(
    ("result", "words"), [("never", r"not completed within 3\.0 s \(under way\)"), ("error", "homing error, standing still")]
)
def test_homing_that_fails_says_how(rig: Rig, result: str, words: str) -> None:
    rig.drives[1].homing_result = result
    with pytest.raises(MotionRefusedError, match=f"roll: homing by method 37: {words}"):
        rig.machine.home(check_first_move=False)
    assert rig.at_rest()


def test_a_motor_side_that_stands_while_its_drive_homes_is_not_waited_for() -> None:
    rig = Rig(method=33)
    rig.drives[0].homing_ticks = 400
    rig.machine.start()
    with pytest.raises(MotionRefusedError, match=r"propeller: its motor side shows no motion for 0\.5 s while it homed by method 33"):
        rig.machine.home(check_first_move=False)
    assert rig.at_rest()


@pytest.mark.parametrize("method", ["home", "enable"])
def test_an_axis_that_stands_outside_its_range_is_not_powered_for_long(rig: Rig, method: str) -> None:
    rig.drives[1].link_counts = 4194304 + round(2.3 / (2 * np.pi / 2**23))
    with pytest.raises(MotionRefusedError, match=r"roll: link position 2\.3000 rad is outside -2\.2000 to 2\.2000 rad"):
        getattr(rig.machine, method)()
    assert rig.at_rest()
    assert not any(any(order.values()) for order in rig.io.history)


def test_an_older_homing_is_not_taken_for_this_one(rig: Rig) -> None:
    rig.machine.home(check_first_move=False)
    rig.drives[0].homing_result = "never"  # bit 12 is still set from before
    with pytest.raises(MotionRefusedError, match="propeller: homing by method 37: not completed"):
        rig.machine.home(check_first_move=False)


def test_after_homing_the_drive_is_back_in_torque_mode(rig: Rig) -> None:
    rig.machine.home()
    assert [drive.value(0x6061) for drive in rig.drives] == [10, 10]
