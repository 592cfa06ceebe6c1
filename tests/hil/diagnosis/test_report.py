"""What the report draws and says of where a mismatch is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.report import write_report
from hil.diagnosis.report.heat_maps import over_pose_and_frequency, over_pose_and_speed, residuals
from hil.diagnosis.report.overlay import overlay_charts
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import DisturbanceShares

DURATION_s = 5.0


@pytest.fixture(scope="module")
def found():
    return mismatch(MACHINE, repeats(3, DURATION_s, coulomb_N=20.0))


def test_a_pose_that_recordings_visit_has_a_spectrum(found):
    by_speed, by_frequency = (make(found, residuals(found), 0, 0) for make in (over_pose_and_speed, over_pose_and_frequency))
    assert by_frequency.x_edges == pytest.approx(by_speed.x_edges)
    visited = np.isfinite(by_speed.power).any(axis=1)
    assert visited.sum() > 12
    assert np.isfinite(by_frequency.power[visited]).all()


def test_a_tone_is_drawn_at_its_frequency_in_the_poses_where_it_sounds(found):
    (group,) = found.groups
    place = group.position[:, 0]
    high = place > 0.5 * (place.min() + place.max())
    with_tone = group.mean - (high * np.sin(2.0 * np.pi * 60.0 * group.time_s))[:, None]
    toned = found.with_simulated([with_tone])
    drawn = over_pose_and_frequency(toned, residuals(toned), 0, 1)
    band = np.searchsorted(drawn.y_edges, 60.0) - 1
    seen = np.isfinite(drawn.power[:, band])
    assert (np.argmax(drawn.power[seen], axis=1) == band).all()
    among = drawn.power[seen, band]
    assert among[-1] > 5.0 * among[0]  # windows of 1 s of a motion of 0.7 Hz: between them poses share power


def test_recorded_and_simulated_lie_over_each_other_row_by_row_with_what_is_left_beneath(found):
    (group,) = found.groups
    differs = np.where(group.time_s > 4.0, 1.0, 0.0)
    stages = {"nominal": [group.mean - differs[:, None]], "extended": [group.mean]}
    shown = overlay_charts(found, stages, "Training")
    for above, below in shown.cells:
        assert "mean of 3 repeats" in above.pose and above.group == below.group != ""
        nominal, extended = below.series
        assert np.allclose(nominal.y, differs) and np.allclose(extended.y, 0.0)
        assert [one.label for one in above.series] == ["recorded", "nominal", "with the effects"]
        (noise,) = below.bands
        assert noise.high == pytest.approx(2.0 * found.noise.std[found.channels.index(above.title.split(": ")[1])])


@pytest.mark.slow
def test_places_and_speeds_and_efforts_have_their_units(friction, tmp_path):
    spans = {"carriage": ((0.125, 0.25),)}
    location = replace(friction.diagnosis.location, position=spans, speed=spans, effort=spans)
    outcome = replace(friction, diagnosis=replace(friction.diagnosis, location=location))
    page = write_report(outcome, tmp_path).read_text(encoding="utf-8")
    for quantity, unit in {"position": "m", "speed": "m/s", "effort": "V"}.items():
        assert f"<td>{quantity} of carriage</td><td>0.125 to 0.25 {unit}</td>" in page
    nothing = replace(
        friction.diagnosis, findings=(), hypotheses=(), disturbance=DisturbanceShares(), verdict="consistent", reason="nothing"
    )
    bare = write_report(replace(friction, diagnosis=nothing), tmp_path).read_text(encoding="utf-8")
    assert "Nothing is above noise for certain." in bare and "Consistent: nothing." in bare
    assert page.index('<p class="verdict unsure">') < page.index("coulomb_friction at carriage: Fc = ") < page.index("<h2>")
