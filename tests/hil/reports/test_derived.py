"""Derived channels and alignment, against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import Isocenter

from hil.errors import UnusableInputError
from hil.recording import Channel, Recording, write_recording
from hil.reports.derived import derived_from, in_time, shift_to, spectrum

RATE_Hz = 200.0
LINE_Hz, AMPLITUDE = 5.0, 0.3


def recorded(delay_s: float = 0.0, rows: int = 2000) -> Recording:
    """A sine on a line of the spectrum, and a bump that comes at 4 s and so much later."""
    time = np.arange(rows) / RATE_Hz
    wave = AMPLITUDE * np.sin(2.0 * np.pi * LINE_Hz * time)
    channels = {
        "time": Channel("s", time),
        "position_turn": Channel("rad", np.exp(-((time - 4.0 - delay_s) ** 2)) + 1.0),
        "link_position_turn": Channel("rad", np.exp(-((time - 4.0 - delay_s) ** 2)) + 0.75),
        "current_turn": Channel("A", wave),
    }
    return Recording(channels, {})


def test_a_difference_and_a_derivative_are_those_of_the_closed_form() -> None:
    recording = recorded()
    ahead = in_time(derived_from("position_turn - link_position_turn"), recording)
    assert ahead.unit == "rad"
    assert ahead.values == pytest.approx(0.25, abs=1e-12)
    speed = in_time(derived_from("d(position_turn)"), recording)
    assert speed.unit == "rad/s"
    time = recording.time
    assert speed.values[1:-1] == pytest.approx((-2.0 * (time - 4.0) * np.exp(-((time - 4.0) ** 2)))[1:-1], abs=1e-4)


def test_a_spectrum_shows_a_sine_by_its_amplitude() -> None:
    frequency_Hz, amplitude = spectrum(derived_from("spectrum(current_turn)"), recorded())
    line = int(np.argmax(amplitude.values))
    assert (frequency_Hz[line], amplitude.unit) == (pytest.approx(LINE_Hz), "A")
    assert amplitude.values[line] == pytest.approx(AMPLITUDE, rel=1e-6)
    assert amplitude.values[line + 3 :].max() < 1e-6


@pytest.mark.parametrize(("delay_s", "rows"), [(1.35, 1700), (-0.8, 1700), (1.0, 2000), (3.0, 2400)])
def test_a_recording_is_shifted_to_where_its_channel_lies_over_the_first(delay_s: float, rows: int) -> None:
    assert shift_to(recorded(), recorded(delay_s, rows=rows), "position_turn") == pytest.approx(-delay_s, abs=0.5 / RATE_Hz)


def test_of_periods_that_lie_as_well_over_each_other_the_nearest_is_taken() -> None:
    later = recorded()
    late = Recording({**later.channels, "time": Channel("s", later.time + 0.03)}, {})
    assert shift_to(recorded(), late, "current_turn") == pytest.approx(-0.03, abs=0.5 / RATE_Hz)


@pytest.mark.parametrize("text", ["position_turn", "d(position_turn", "a + b", "fft(a)"])
def test_what_is_none_is_refused(text: str) -> None:
    with pytest.raises(UnusableInputError, match="is no derived channel; write A - B"):
        derived_from(text)


def test_the_page_shows_them_and_wrong_ones_are_told_in_a_line(isocenter: Isocenter, tmp_path: Path) -> None:
    for name, delay_s in (("first", 0.0), ("second", 1.0)):
        write_recording(recorded(delay_s), tmp_path / f"{name}.mf4")
    both = (tmp_path / "first.mf4", tmp_path / "second.mf4")
    told = isocenter(
        "plot",
        *both,
        "--derive",
        "d(position_turn)",
        "--derive",
        "spectrum(current_turn)",
        "--align",
        "position_turn",
        "-o",
        tmp_path / "p.html",
    )
    assert told.status == 0, told.err
    assert "second.mf4: shown 1 s earlier, where position_turn lies best over that of" in told.out
    page = (tmp_path / "p.html").read_text(encoding="utf-8")
    assert "Derived channels" in page
    assert "time of first [s]" in page
    for option, wrong, why in (
        ("--derive", "position_turn - current_turn", "position_turn is in rad, current_turn in A"),
        ("--derive", "d(positon_turn)", "did you mean position_turn?"),
        ("--align", "nosuch", "no channel nosuch"),
    ):
        refused = isocenter("plot", *both, option, wrong, "-o", tmp_path / "q.html")
        assert refused.status == 2
        assert why in refused.line
