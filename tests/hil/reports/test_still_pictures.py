"""Still pictures are the charts of a page: the same curves, labels and marks."""

from __future__ import annotations

import numpy as np
import pytest

import hil
from hil.errors import RecordingError, UnusableInputError
from hil.figures.still import still
from hil.pages import Band, Chart, Charts, Mark, Scale, Series
from hil.recording import Channel, Recording

TIME_s = np.arange(100) / 100.0
RECORDED = Recording({"time": Channel("s", TIME_s), "position_roll": Channel("rad", np.sin(TIME_s))}, {})
SIMULATED = Recording({"time": Channel("s", TIME_s), "position_roll": Channel("rad", np.sin(TIME_s) - 0.25)}, {})


def test_a_picture_has_what_the_chart_has() -> None:
    curve, points = Series("recorded", TIME_s + 1.0, TIME_s), Series("noise", TIME_s + 1.0, 0.1 + TIME_s, is_points=True)
    band = Band("band", TIME_s + 1.0, TIME_s - 0.1, TIME_s + 0.1)
    chart = Chart("Wave", Scale("f [Hz]", is_log=True), Scale("y [m]", ends=(-1.0, 2.0)), [curve, points], [band], [Mark(1.5, "a mode")])
    (axes,) = still(Charts([chart])).axes
    assert axes.get_title(loc="left") == "Wave"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("f [Hz]", "y [m]")
    assert (axes.get_xscale(), axes.get_ylim()) == ("log", (-1.0, 2.0))
    assert [text.get_text() for text in axes.texts] == ["a mode"]
    assert sorted(text.get_text() for text in axes.get_legend().get_texts()) == ["band", "noise", "recorded"]
    line, dots, _ = axes.lines
    assert np.array_equal(line.get_ydata(), TIME_s)
    assert (dots.get_linestyle(), dots.get_marker() != "None") == ("None", True)


def test_stacks_stand_in_columns_and_share_what_is_below_them() -> None:
    chart = Chart("c", Scale("t"), Scale("y"), [Series("a", TIME_s, TIME_s)])
    figure = still(Charts([(chart, chart), chart, chart], columns=2), "All")
    assert len(figure.axes) == 4
    assert figure.get_suptitle() == "All"


def test_the_front_door_draws_a_recording_with_what_its_simulation_leaves() -> None:
    above, below = hil.plot(RECORDED, SIMULATED).axes
    assert [line.get_label() for line in above.lines] == ["recorded", "simulated"]
    assert np.allclose(below.lines[0].get_ydata(), 0.25)
    with pytest.raises(UnusableInputError, match="position_yaw"):
        hil.plot(RECORDED, channels=["position_yaw"])
    with pytest.raises(RecordingError, match="50 simulated"):
        hil.plot(RECORDED, SIMULATED.part(slice(0, 50)))
