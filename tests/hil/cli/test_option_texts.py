"""Whatever text an option is given: it is a value that can be written again, or the one line that says what would be right."""

from __future__ import annotations

import math

import pytest
from bench_machines import CARM
from hypothesis import example, given
from hypothesis import strategies as st
from refusals import answer_or_refusal

from drivers.errors import BusUnavailableError
from drivers.modbus.transport import parse_io_url
from hil.cli.options import edge_scale, parse_band, parse_pose, parse_whole_numbers
from hil.errors import UnusableInputError

ANY = st.text(max_size=40)
NUMBER = st.floats(-1e6, 1e6, allow_nan=False)


def one_line(refusal: str, text: str) -> bool:
    """It names what was given, and is a line if that was one."""
    return text in refusal and len(refusal.splitlines()) <= max(1, len(text.splitlines()) + 1)


def nearly(*texts: str) -> st.SearchStrategy[str]:
    """Any text, and texts of the pieces of a right one."""
    return ANY | st.lists(st.sampled_from([*texts, "nan", "-inf", "1e999", "", " ", "٣"]), max_size=6).map("".join)


@given(nearly("roll", "propeller", "=", ",", "30", "-1.5"))
@example("roll=nan")
@example("roll=30,roll=40")
@example("=")
def test_any_text_for_a_pose(text: str) -> None:
    pose, refusal = answer_or_refusal(UnusableInputError, parse_pose, text, CARM)
    if pose is None:
        assert one_line(refusal, text)
        assert any(right in refusal for right in ("AXIS=NUMBER", "it has propeller, roll", "say where it is once"))
        return
    again = ",".join(f"{axis}={value / edge_scale(CARM, axis)!r}" for axis, value in pose.items())
    assert parse_pose(again, CARM) == pytest.approx(pose, rel=1e-15)
    assert set(pose) <= set(CARM.axes)
    assert all(map(math.isfinite, pose.values()))


@given(st.dictionaries(st.sampled_from(CARM.axes), NUMBER))
def test_a_pose_that_was_written_is_read(pose: dict[str, float]) -> None:
    text = ",".join(f"{axis} = {degrees!r}" for axis, degrees in pose.items())
    assert parse_pose(text, CARM) == pytest.approx({axis: math.radians(degrees) for axis, degrees in pose.items()}, rel=1e-15)


@given(nearly("0.5", ":", "40", "-3"))
@example("40:0.5")
@example("1:2:3")
@example("nan:1")
def test_any_text_for_a_band(text: str) -> None:
    band, refusal = answer_or_refusal(UnusableInputError, parse_band, "--band", text)
    if band is None:
        assert one_line(refusal, text)
        assert "LOW:HIGH" in refusal
        return
    low, high = band
    assert low < high
    assert parse_band("--band", f"{low!r}:{high!r}") == (low, high)


@given(nearly("1", ",", "35", "-3", "0", "+7"))
@example("1,,2")
@example("0")
def test_any_text_for_whole_numbers(text: str) -> None:
    numbers, refusal = answer_or_refusal(UnusableInputError, parse_whole_numbers, "--lines", text)
    if numbers is None:
        assert one_line(refusal, text)
        assert "whole numbers from 1" in refusal
        return
    assert min(numbers) >= 1
    assert parse_whole_numbers("--lines", ",".join(map(str, numbers))) == numbers


@given(nearly("tcp:", "rtu:", "host", ":", "502", "@", "/dev/ttyUSB0", "115200", "[::1]"))
@example("tcp:[::1]:502")
@example("tcp:host:0")
@example("tcp:host:65536")
@example("rtu:/dev/ttyUSB0@0")
@example("tcp:[]:1")
@example("tcp:host:٣")
def test_any_text_for_where_the_io_is(text: str) -> None:
    parts, refusal = answer_or_refusal(BusUnavailableError, parse_io_url, text)
    if parts is None:
        assert "tcp:HOST:PORT or rtu:DEVICE@BAUD" in refusal
        assert "\n" not in refusal
        return
    kind, place, number, framing = parts
    assert place
    assert number > 0
    again = f"tcp:[{place}]:{number}" if kind == "tcp" else f"rtu:{place}@{number},{framing}"
    assert parse_io_url(again) == parts
