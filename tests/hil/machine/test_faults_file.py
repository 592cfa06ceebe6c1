"""Faults files: what is read, what is refused and how it is said."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import pytest
from bench_machines import CARM, edited
from examples import examples
from hypothesis import given
from hypothesis import settings as limits
from hypothesis import strategies as st
from refusals import answer_or_refusal

from hil.errors import MachineFileError
from hil.machine import machine_from_text
from hil.machine.faults_file import faults_from_text, faults_text, places_of, read_faults_file
from virtual_bus.faults.condition import STATES, Comparison, InState, parse_condition
from virtual_bus.faults.fault import FaultSetting
from virtual_bus.faults.registry import fault_kinds

PLACES = places_of(CARM)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=32)
CONDITIONS = st.one_of(
    st.none(),
    st.builds(InState, st.sampled_from(sorted(STATES)), st.sampled_from(["", *CARM.axes])),
    st.builds(
        Comparison, st.sampled_from(sorted(PLACES.quantities)), st.booleans(), st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), NUMBERS
    ),
)


@st.composite
def faults(draw: st.DrawFn) -> FaultSetting:
    """Any fault that this machine can have."""
    kind = draw(st.sampled_from([kind for kind in fault_kinds().values() if kind.begin is not None and PLACES.of(kind.at)]))
    values = {
        parameter.name: float(draw(st.integers(math.ceil(parameter.low), math.floor(parameter.high))))
        if parameter.whole
        else draw(st.floats(parameter.low, parameter.high))
        for parameter in kind.parameters
    }
    at = draw(st.sampled_from(PLACES.of(kind.at)))
    lasting = draw(st.one_of(st.just(math.inf), st.floats(1e-3, 1e6)))
    return FaultSetting(kind.name, at, values, draw(CONDITIONS), draw(st.floats(0.0, 1e6)), lasting)


@given(st.lists(faults(), max_size=3))
@limits(deadline=None, max_examples=examples(60), derandomize=True)
def test_what_is_written_is_read_back(written: list[FaultSetting]) -> None:
    assert faults_from_text(faults_text(written), CARM, "faults.toml") == tuple(written)


TEXTS = st.text("abs(speed_roll) >0.3\"\\'", max_size=12)
VALUES = st.one_of(TEXTS, st.integers(), st.floats(), st.booleans(), st.lists(st.integers(), max_size=2))
KEYS = st.sampled_from(["name", "at", "when", "from_s", "for_s", "share", "code", "delay_s", "nonsense"])


@given(st.dictionaries(KEYS, st.one_of(VALUES, st.sampled_from([*fault_kinds(), *PLACES.drives, *CARM.axes, "moving"]))))
@limits(deadline=None, max_examples=examples(100), derandomize=True)
def test_whatever_stands_in_a_table_is_read_or_refused_in_one_line(table: dict[str, object]) -> None:
    text = "[[fault]]\n" + "".join(f"{key} = {_toml(value)}\n" for key, value in table.items())
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    _, refusal = answer_or_refusal(MachineFileError, faults_from_text, text, CARM, "faults.toml")
    assert refusal is None or (refusal.startswith("faults.toml: fault") and "\n" not in refusal)


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(f"\\U{ord(sign):08x}" if not sign.isalnum() else sign for sign in value) + '"'
    return repr(value)


@pytest.mark.parametrize(
    ("table", "wanted"),
    [
        ('name = "brake_vanishes"', ("fault 1", "brake_vanishes", "isocenter faults list")),
        ('name = "brake_stays_open"\nat = "yaw"', ("at = 'yaw'", "propeller, roll")),
        ('name = "brake_stays_open"', ("at = None", "an axis with a brake")),
        ('name = "torque_share"\nat = "roll_drive"\nshare = 7.0', ("share = 7.0", "-1 to 5")),
        ('name = "torque_share"\nat = "roll_drive"\nshares = 0.5', ("shares", "unknown key", "share")),
        ('name = "torque_late"\nat = "roll_drive"\nsamples = 2.5', ("samples = 2.5", "whole number")),
        ('name = "imu_nan"\nfrom_s = -1.0', ("from_s = -1.0", "seconds")),
        ('name = "imu_nan"\nfor_s = 0', ("for_s = 0", "more than 0")),
        ('name = "imu_nan"\nwhen = "speed_yaw > 1"', ("speed_yaw", "speed_roll")),
        ('name = "imu_nan"\nwhen = "moving yaw"', ("'yaw'", "propeller, roll")),
        ('name = "imu_nan"\nwhen = "abs(speed_roll > 1"', ("must be a comparison",)),
        ('name = "loop_killed"', ("processes",)),
    ],
)
def test_a_wrong_fault_is_named_with_what_would_be_right(table: str, wanted: tuple[str, ...]) -> None:
    with pytest.raises(MachineFileError) as refusal:
        faults_from_text(f"[[fault]]\n{table}\n", CARM, "wrong.toml")
    assert str(refusal.value).startswith("wrong.toml: fault 1")
    for part in wanted:
        assert part in str(refusal.value)


def test_what_there_is_once_needs_no_place() -> None:
    (fault,) = faults_from_text('[[fault]]\nname = "io_hangs"\n', CARM, "faults.toml")
    assert fault.at == "io"


def test_a_fault_of_a_device_that_is_not_there_is_refused() -> None:
    machine = machine_from_text(edited(r"^\[(bus|judging)\.imu\]\n(?:.+\n)+", "", edited(r"^triggered_by_sync.*\n", "")))
    with pytest.raises(MachineFileError, match="this machine has none"):
        faults_from_text('[[fault]]\nname = "imu_nan"\n', machine, "faults.toml")


def test_a_file_is_read_from_its_path_and_other_keys_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "faults.toml"
    path.write_text('format = 1\n[[fault]]\nname = "door_opened"\nwhen = "recording"\nfrom_s = 0.5\n')
    (fault,) = read_faults_file(path, CARM)
    assert (fault.label, str(fault.when), fault.from_s) == ("door_opened at io", "recording", 0.5)
    path.write_text("[[effect]]\n")
    with pytest.raises(MachineFileError, match="unknown key"):
        read_faults_file(path, CARM)


@pytest.mark.parametrize("text", ["abs( speed_roll )>0.3", "abs(speed_roll) > 3e-1", "  abs(speed_roll)   >   .3 "])
def test_a_comparison_may_be_spaced_as_one_likes(text: str) -> None:
    assert parse_condition(text, PLACES.quantities, CARM.axes) == Comparison("speed_roll", True, ">", 0.3)
