"""Speeds and ramps that a drive moves and stops by, as they go over the wire at the start of a session."""

from __future__ import annotations

from pathlib import Path

import can
import numpy as np
import pytest
from bench_machines import CARM, RPM_PER_S, carm_text_in, edited, homing_at_switch_text, with_data_sheet

from drivers.errors import ConfigurationRefusedError
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.machine import check_machine, machine_from_text
from hil.machine.check_ramps import ramps

PER_RAD = 4096 * 500 / (2.0 * np.pi)
SPEED, ACCELERATION, TRACKING = np.radians(60.0) * PER_RAD, np.radians(60.0) * PER_RAD, np.radians(3.0) * PER_RAD
SDO_OF_ROLL = 0x602


def written(text: str, folder: Path) -> dict[int, int]:
    """Value by object of what roll's drive is sent over SDO in a session without motion."""
    log = folder / "frames.log"
    with open_bench(machine_from_text(text), BenchOptions("lockstep:", frame_log=log)):
        pass
    found = {}
    for message in can.LogReader(str(log)):
        if message.arbitration_id == SDO_OF_ROLL and message.data[0] & 0xE0 == 0x20:
            found[int.from_bytes(message.data[1:3], "little")] = int.from_bytes(message.data[4:], "little")
    return found


def test_a_drive_that_goes_by_itself_keeps_to_the_limits(tmp_path: Path) -> None:
    found = written(carm_text_in("profile_position"), tmp_path)
    for index, value in {0x607F: SPEED, 0x6081: SPEED, 0x6083: ACCELERATION, 0x6084: ACCELERATION, 0x6065: TRACKING}.items():
        assert found[index] == pytest.approx(value, abs=1.0)
    assert found[0x6066] == 0


def test_a_drive_whose_velocities_are_led_ramps_faster_than_its_reference_and_not_beyond_the_watch_over_its_speed(tmp_path: Path) -> None:
    found = written(carm_text_in("profile_velocity"), tmp_path)
    assert found[0x607F] == pytest.approx(1.5 * SPEED, abs=1.0)
    for index in (0x6083, 0x6084):
        assert found[index] == pytest.approx(10.0 * ACCELERATION, abs=1.0)


def test_a_cyclic_drive_has_no_profile(tmp_path: Path) -> None:
    assert not {0x607F, 0x6081, 0x6083, 0x6084} & set(written(CARM.text, tmp_path))


def test_the_quick_stop_is_the_one_that_the_budgets_are_computed_from(tmp_path: Path) -> None:
    bare = edited(r"^\[\[bus\.nodes\.\w+_drive\.write\]\]\nindex = 0x6085.*\nvalue = .*\n", "")
    assert written(CARM.text, tmp_path)[0x6085] == 3_500_000
    assert written(bare, tmp_path)[0x6085] == 200_000  # the data sheet's
    stated = edited(r"^(\[limits\.\w+\])$", r"\g<1>\nquick_stop_deg_s2 = 600.0", bare)
    assert written(stated, tmp_path)[0x6085] == pytest.approx(np.radians(600.0) * PER_RAD, abs=1.0)


def test_what_the_machine_file_writes_is_its_own(tmp_path: Path) -> None:
    own = "[[bus.nodes.roll_drive.write]]\nindex = 0x6083\nvalue = 1234\n"
    found = written(edited(r"^\[\[bus\.nodes\.roll_drive\.tpdo\]\]$", f"{own}\\g<0>", carm_text_in("profile_velocity")), tmp_path)
    assert found[0x6083] == 1234
    assert found[0x6084] == pytest.approx(10.0 * ACCELERATION, abs=1.0)


@pytest.mark.parametrize(("written", "ok"), [("", True), ("341334", True), ("341333", False)])
def test_a_ramp_that_is_slower_than_the_reference_fails_the_check(written: str, ok: bool) -> None:
    own = f"[[bus.nodes.roll_drive.write]]\nindex = 0x6084\nvalue = {written}\n" if written else ""
    text = edited(r"^\[\[bus\.nodes\.roll_drive\.tpdo\]\]$", f"{own}\\g<0>", carm_text_in("profile_velocity"))
    found = {finding.values["axis"]: finding.ok for finding in check_machine(machine_from_text(text), poses=9) if finding.name == "ramp"}
    assert found == {"propeller": True, "roll": ok}


@pytest.mark.parametrize(("where", "change"), [("write", ""), ("sheet", "HighLimit={}\n")])
@pytest.mark.parametrize(("rpm_per_s", "ok"), [(4999, False), (5001, True)])  # 60 deg/s^2 behind a gear of 500
def test_a_ramp_is_judged_in_the_drives_own_unit(where: str, change: str, rpm_per_s: int, ok: bool, tmp_path: Path) -> None:
    most = change.format(rpm_per_s)
    text = with_data_sheet(carm_text_in("profile_velocity"), tmp_path, r"^\[6084\]\n", f"{RPM_PER_S}\\g<0>{most}")
    if where == "write":
        own = f"[[bus.nodes.roll_drive.write]]\nindex = 0x6084\nvalue = {rpm_per_s}\n"
        text = edited(r"^\[\[bus\.nodes\.roll_drive\.tpdo\]\]$", f"{own}\\g<0>", text)
    (found,) = (each for each in ramps(machine_from_text(text)) if each.values["axis"] == "roll")
    assert found.ok == ok
    assert found.values["ramp"] == pytest.approx(np.radians(60.0) * rpm_per_s / 5000)


def test_a_ramp_in_a_unit_that_nobody_knows_fails_the_check(tmp_path: Path) -> None:
    metres = RPM_PER_S.replace("0x00C00300", "0x00010300")
    found = ramps(machine_from_text(with_data_sheet(carm_text_in("profile_velocity"), tmp_path, r"^\[6084\]$", f"{metres}\\g<0>")))
    assert [each.ok for each in found] == [False, False]
    assert "60AAh" in found[1].text


def test_the_least_quick_stop_is_one_unit_and_none_is_told(tmp_path: Path) -> None:
    bare = edited(r"^\[\[bus\.nodes\.\w+_drive\.write\]\]\nindex = 0x6085.*\nvalue = .*\n", "")
    slow = edited(r"^(\[limits\.roll\])$", r"\g<1>\nquick_stop_deg_s2 = 1e-6", bare)
    assert written(slow, tmp_path)[0x6085] == 1
    fixed = with_data_sheet(slow, tmp_path, r"^(\[6085\]\n(?:.*\n){3}AccessType=)rw", r"\g<1>ro")
    with open_bench(machine_from_text(fixed), BenchOptions("lockstep:")) as bench:
        assert any("no quick stop ramp (6085h)" in note for note in bench.wiring.link.notes)


HUNDRED_TURNS_PER_S = RPM_PER_S.replace("60AA", "60A9").replace("0x00C00300", "0x02B40300")


def test_speeds_in_coarse_units_keep_to_their_limits(tmp_path: Path) -> None:
    """60 deg/s are 0.83 units behind a gear of 500, what a led drive may reach 1.25."""
    led, by_itself, homed = (
        with_data_sheet(text, tmp_path, r"^\[6084\]$", f"{HUNDRED_TURNS_PER_S}\\g<0>")
        for text in (carm_text_in("profile_velocity"), carm_text_in("profile_position"), homing_at_switch_text())
    )
    with open_bench(machine_from_text(led), BenchOptions("lockstep:")) as bench:
        assert sum("607Fh takes whole units: 1, where 1.25 are asked for" in note for note in bench.wiring.link.notes) == 2
    with (
        pytest.raises(ConfigurationRefusedError, match=r"607Fh takes no speed as low as 0\.833"),
        open_bench(machine_from_text(by_itself), BenchOptions("lockstep:")),
    ):
        pass
    with (
        open_bench(machine_from_text(homed), BenchOptions("lockstep:")) as bench,
        pytest.raises(ConfigurationRefusedError, match=r"6099h takes no speed as low as 0\.0694"),
    ):
        bench.commission()
