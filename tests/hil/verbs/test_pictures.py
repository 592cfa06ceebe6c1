"""Pictures of results: each is a figure that shows what it is of, and a notebook shows it."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import hil


@pytest.fixture(scope="module")
def recording() -> hil.Recording:
    machine = hil.open_machine("turntable")
    return machine.run(hil.JogOnly(jog=hil.Jog(line=1), period_s=2.0, periods=1, settle_periods=1), bus="lockstep:")


def curves(figure: Figure) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata()) for axes in figure.get_axes() for line in axes.get_lines()]


def is_among(values: np.ndarray, drawn: list[np.ndarray]) -> bool:
    return any(len(one) == len(values) and np.allclose(one, values, equal_nan=True) for one in drawn)


def test_a_recording_its_simulation_and_what_is_left(recording: hil.Recording, tmp_path: Path) -> None:
    simulated = hil.simulate(hil.open_machine("turntable"), recording)
    drawn = curves(hil.plot(recording, simulated, channels=["position_*"], page=tmp_path / "page.html"))
    for values in (recording["position_turn"], simulated["position_turn"], recording["position_turn"] - simulated["position_turn"]):
        assert is_among(values, drawn)
    assert not is_among(recording["current_turn"], drawn)
    assert "position_turn" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_without_channels_named_position_and_command_are_drawn(recording: hil.Recording) -> None:
    drawn = curves(hil.plot(recording))
    assert is_among(recording["position_turn"], drawn)
    assert is_among(recording["command_turn"], drawn)
    assert not is_among(recording["current_turn"], drawn)


def test_a_channel_that_is_not_there_is_refused_with_those_that_are(recording: hil.Recording) -> None:
    with pytest.raises(hil.UnusableInputError, match=r"position_roll.*there are .*position_turn"):
        hil.plot(recording, channels=["position_roll"])


def test_a_simulation_of_another_recording_is_refused(recording: hil.Recording) -> None:
    with pytest.raises(hil.RecordingError, match="800 rows recorded, 100 simulated"):
        hil.plot(recording, recording.part(slice(0, 100)))


def test_what_cannot_be_drawn_is_told(recording: hil.Recording) -> None:
    with pytest.raises(hil.UnusableInputError, match="list: is not drawn; a recording"):
        hil.plot([1.0, 2.0])  # type: ignore[arg-type]


def test_a_notebook_is_taught_to_show_figures(recording: hil.Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    taught: dict[type, object] = {}
    formatter = SimpleNamespace(for_type=taught.__setitem__)
    shell = SimpleNamespace(display_formatter=SimpleNamespace(formatters={"image/png": formatter}))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell, version_info=(9, 0)))
    figure = hil.plot(recording)
    png = taught[Figure](figure)  # type: ignore[operator]
    assert png.startswith(b"\x89PNG")
