"""What the report draws and says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from carriage import MACHINE, repeats
from matplotlib.figure import Figure

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.report.page import missing_charts, write_report
from hil.diagnosis.report.waterfall import left_above_noise, waterfall_figure
from hil.diagnosis.result import EffectAt, ErrorsOf, Stages
from hil.diagnosis.verdict.values import Outcome
from hil.recording import Channel

COULOMB_N = 20.0  # of the friction in conftest.py


def bars(figure: Figure) -> list[tuple[str, float, float]]:
    """Name, foot and height [%] of every bar."""
    axes = figure.axes[0]
    names = [label.get_text() for label in axes.get_xticklabels()]
    return [(name, bar.get_y(), bar.get_height()) for name, bar in zip(names, axes.patches, strict=True)]  # type: ignore[attr-defined]


def test_the_waterfall_ends_in_what_is_unexplained(friction: Outcome) -> None:
    e = Stages(nominal=np.sqrt(101.0), retuned=np.sqrt(81.0), extended=np.sqrt(6.0), placebo=None, noise_floor=1.0)
    fit = replace(friction.diagnosis.fit, held_out=e)
    figure = waterfall_figure(fit, (EffectAt("coulomb_friction", "carriage"), EffectAt("constant_load", "carriage")))
    assert figure is not None
    drawn = bars(figure)
    assert [name.split("\n")[0] for name, *_ in drawn] == ["nominal", "re-tuning", "coulomb_friction", "unexplained"]
    assert [height for *_, height in drawn] == pytest.approx([100.0, 20.0, 75.0, 5.0])
    assert [foot for _, foot, _ in drawn] == pytest.approx([0.0, 80.0, 5.0, 0.0])


def test_a_mismatch_below_noise_has_no_waterfall() -> None:
    assert left_above_noise(Stages(0.9, 0.9, 0.9, None, 1.0)) is None


def test_the_missing_effort_of_friction_is_its_level_on_both_sides(friction: Outcome) -> None:
    (shown,) = missing_charts(friction)
    over_speed = shown.cells[0]
    assert over_speed.x.label == "speed of carriage [m/s]"
    assert over_speed.y.label == "effort on carriage [N]"
    missing, explained, mean = over_speed.series
    for side in (-1.0, 1.0):
        far = side * missing.x > 0.5 * np.max(side * missing.x)
        assert np.mean(missing.y[far]) == pytest.approx(side * COULOMB_N, rel=0.5)  # of a machine whose other numbers are off, too
        assert np.mean(mean.y[side * mean.x > 0.5 * np.max(side * mean.x)]) == pytest.approx(np.mean(missing.y[far]), abs=1.0)
        fitted = side * explained.x > 0.5 * np.max(side * explained.x)
        assert np.mean(explained.y[fitted]) == pytest.approx(np.mean(missing.y[far]), abs=3.0)


def test_places_and_speeds_and_efforts_have_their_units(friction: Outcome, tmp_path: Path) -> None:
    spans = {"carriage": ((0.125, 0.25),)}
    location = replace(friction.diagnosis.location, position=spans, speed=spans, effort=spans)
    outcome = replace(friction, diagnosis=replace(friction.diagnosis, location=location))
    page = write_report(outcome, tmp_path).read_text(encoding="utf-8")
    for quantity, unit in {"position": "m", "speed": "m/s", "effort": "V"}.items():
        assert f"<td>{quantity} of carriage</td><td>0.125 to 0.25 {unit}</td>" in page
    assert "Every row predicted from those before it" in page
    assert page.index('<p class="verdict good">') < page.index("coulomb_friction at carriage: Fc = ") < page.index("<h2>")


def test_an_answer_without_findings_says_so(friction: Outcome, tmp_path: Path) -> None:
    nothing = replace(friction.diagnosis, findings=(), hypotheses=(), lacking={}, verdict="consistent", reason="nothing")
    bare = write_report(replace(friction, diagnosis=nothing, effects=()), tmp_path).read_text(encoding="utf-8")
    assert "No effort is missing." in bare
    assert "Consistent: nothing." in bare
    assert "No effect is named." in bare


def test_errors_are_in_units_of_noise_or_shares_of_the_motion(friction: Outcome, tmp_path: Path) -> None:
    stages = Stages(nominal=12.5, retuned=8.0, extended=1.25, placebo=None, noise_floor=1.0)
    fit = replace(friction.diagnosis.fit, channels={"position_carriage": stages})
    of: tuple[tuple[ErrorsOf, str, str], ...] = (
        ("rows", "rms error in units of noise", "12.5"),
        ("efforts", "NRMSE of free runs", "1.25e+03 %"),
        ("closed_loop", "NRMSE of free runs", "1.25e+03 %"),
    )
    for errors_of, heading, shown in of:
        diagnosis = replace(friction.diagnosis, fit=replace(fit, errors_of=errors_of))
        page = write_report(replace(friction, diagnosis=diagnosis), tmp_path).read_text(encoding="utf-8")
        assert f">{heading}</th>" in page
        assert f'position_carriage</td><td class="number" data-head="nominal">{shown}</td>' in page


def test_no_column_is_empty(friction: Outcome, tmp_path: Path) -> None:
    page = write_report(friction, tmp_path).read_text(encoding="utf-8")
    assert "placebo" not in page
    assert "held-out by" not in page


def test_wrong_recordings_have_shares_that_sum_to_one_and_no_word_of_a_search(tmp_path: Path) -> None:
    first, second = repeats(2, 2.0).values()
    missing = np.where(first["time"] < 1.0, np.nan, first["position_carriage"])
    spoilt = [
        replace(run, channels={**run.channels, "position_carriage": Channel("m", position)})
        for run, position in ((first, missing), (second, 1000.0 * second["position_carriage"]))  # a gap, and millimetres
    ]
    outcome = diagnose(MACHINE, dict(zip("ab", spoilt, strict=True)))
    assert "a: position_carriage is missing" in outcome.diagnosis.reason
    assert "b: position_carriage is in mm" in outcome.diagnosis.reason
    assert outcome.diagnosis.location.channels == pytest.approx({"position_carriage": 1.0})
    page = write_report(outcome, tmp_path).read_text(encoding="utf-8")
    assert "Misconfigured" in page
    assert "No effect is named." in page
    for untold in ("no repeats were recorded", "The answer leaves", "Free runs", "No recording has the reference", "None was computed"):
        assert untold not in page
