"""Position limits and following error windows that drives have stored, narrower than the machine file's range and tracking error."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from bench_machines import carm_text_in
from places import ROOT

from drivers.errors import ConfigurationRefusedError
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.machine import Machine, machine_from_text

SHEET = ROOT / "drivers" / "canopen" / "eds_files" / "isocenter_drive.eds"
GOAL = np.radians([-5.0, 10.0])
COUNTS_10_DEG = round(10.0 / 360.0 * 500 * 4096)


def machine(folder: Path, **objects: tuple[int, str]) -> Machine:
    """The C-arm in position mode; its drives have left the factory with these (value, access), by section of their data sheet."""
    sheet = SHEET.read_text(encoding="latin-1")
    for section, (value, access) in objects.items():
        sheet, found = re.subn(
            rf"(\[{section}\]\n(?:.+\n)*?)AccessType=\w+\nDefaultValue=\S+", rf"\1AccessType={access}\nDefaultValue={value}", sheet
        )
        assert found == 1
    path = folder / "drive.eds"
    path.write_text(sheet, encoding="latin-1")
    return machine_from_text(carm_text_in("position").replace('eds = "isocenter_drive.eds"', f'eds = "{path}"'))


def moved(of: Machine) -> tuple[np.ndarray, str]:
    with open_bench(of, BenchOptions("lockstep:")) as bench:
        return bench.move(GOAL), " ".join(bench.wiring.link.notes)


def test_limits_inside_the_range_are_widened_and_told(tmp_path: Path) -> None:
    reached, said = moved(machine(tmp_path, **{"607Dsub1": (-COUNTS_10_DEG // 4, "rw"), "607Dsub2": (COUNTS_10_DEG // 4, "rw")}))
    assert reached == pytest.approx(GOAL, abs=2e-4)
    assert "roll_drive" in said
    assert f"limits (607Dh) are {-COUNTS_10_DEG // 4} to {COUNTS_10_DEG // 4}, the range of roll is" in said


def test_limits_inside_the_range_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    fixed = machine(tmp_path, **{"607Dsub1": (-COUNTS_10_DEG // 4, "ro"), "607Dsub2": (COUNTS_10_DEG // 4, "ro")})
    with pytest.raises(ConfigurationRefusedError, match=r"607Dh.*cannot be written"):
        moved(fixed)


def test_wide_limits_and_limits_that_are_none_are_left_alone(tmp_path: Path) -> None:
    for lowest, highest in ((-(2**31), 2**31 - 1), (0, 0)):
        _, said = moved(machine(tmp_path, **{"607Dsub1": (lowest, "ro"), "607Dsub2": (highest, "ro")}))
        assert "607Dh" not in said


def test_a_narrow_window_is_widened_as_far_as_targets_lead(tmp_path: Path) -> None:
    reached, said = moved(machine(tmp_path, **{"6065": (10, "rw")}))
    assert reached == pytest.approx(GOAL, abs=2e-4)
    assert "following error window (6065h) is 10 counts" in said


def test_a_narrow_window_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationRefusedError, match=r"6065h.*is 10 counts.*cannot be written"):
        moved(machine(tmp_path, **{"6065": (10, "ro")}))
