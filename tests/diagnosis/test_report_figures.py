"""What the page's figures show, and what the answer says of which equation is short and which numbers stay as they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import MASS_kg

from hil.diagnosis.diagnose import first_effects
from hil.diagnosis.report.effect_map import effect_map
from hil.diagnosis.report.page import report_figures
from hil.diagnosis.report.waterfall import left_above_noise, waterfall_figure
from hil.diagnosis.result import EffectAt, Stages
from hil.diagnosis.retune import tunable


def bars(figure) -> list[tuple[str, float, float]]:
    """Name, foot and height [%] of every bar."""
    axes = figure.axes[0]
    names = [label.get_text() for label in axes.get_xticklabels()]
    return [(name, bar.get_y(), bar.get_height()) for name, bar in zip(names, axes.patches, strict=True)]


def test_the_waterfall_has_a_step_for_each_effect_and_ends_in_what_is_unexplained(friction):
    e = Stages(nominal=np.sqrt(101.0), retuned=np.sqrt(81.0), extended=np.sqrt(6.0), placebo=None, noise_floor=1.0)
    fit = replace(friction.diagnosis.fit, held_out=e)
    both = (EffectAt("coulomb_friction", "carriage"), EffectAt("constant_load", "carriage"))
    drawn = bars(waterfall_figure(fit, both, [np.sqrt(31.0)]))
    assert [name.split("\n")[0] for name, *_ in drawn] == ["nominal", "re-tuning", "coulomb_friction", "constant_load", "unexplained"]
    assert [height for *_, height in drawn] == pytest.approx([100.0, 20.0, 50.0, 25.0, 5.0])
    assert [foot for _, foot, _ in drawn] == pytest.approx([0.0, 80.0, 30.0, 5.0, 0.0])


def test_a_mismatch_below_noise_has_no_waterfall():
    assert left_above_noise(Stages(0.9, 0.9, 0.9, None, 1.0)) is None


def test_a_frictions_map_is_flat_at_its_level_on_both_sides(friction):
    (caption, figure), *_ = report_figures(friction)["effect"]
    assert caption == "coulomb_friction at carriage" and figure.axes[0].get_xlabel() == "speed of carriage [m/s]"
    drawn = effect_map(
        friction.train, friction.stages["train"]["without_effects"], friction.stages["train"]["extended"],
        friction.diagnosis.findings[0].effect, friction.values,
    )  # fmt: skip
    for side in (-1.0, 1.0):
        far = side * drawn.x > 0.5 * np.nanmax(side * drawn.x)
        assert np.nanmean(drawn.fitted[far]) == pytest.approx(-side * 20.0, rel=0.25)
        assert np.nanmean(drawn.recorded[far]) == pytest.approx(-side * 20.0, rel=0.25)


def test_of_a_friction_the_joint_is_short_and_no_sensor(friction):
    shares = friction.diagnosis.disturbance
    assert shares.joints == {"carriage": pytest.approx(1.0, abs=0.2)}
    assert max(shares.sensors.values()) < 0.25 < shares.joints["carriage"]
    (_, figure), *_ = report_figures(friction)["disturbance"]
    assert figure.axes[0].get_ylabel() == "on carriage [N]" and figure.axes[-1].get_xlabel() == "time [s]"


def test_shares_of_a_span_are_of_the_power_that_it_holds(friction):
    location = friction.diagnosis.location
    for dimension, shares in location.shares.items():
        assert getattr(location, dimension), dimension
        assert all(0.0 < share <= 1.0 for share in shares.values()), (dimension, shares)


def test_every_number_that_may_be_re_tuned_is_shown_or_named_with_the_reason_why_not(friction):
    diagnosis = friction.diagnosis
    names = {f"{p.owner}.{p.quantity}" for p in (friction.tuning.parameters[k] for k in tunable(friction.tuning.parameters))}
    assert names == {*diagnosis.retuned, *diagnosis.frozen}
    assert diagnosis.retuned["carriage.mass"].value == pytest.approx(1.05 * MASS_kg, rel=0.02)


def test_a_hypothesis_says_what_it_gains_and_what_it_takes(friction):
    first, *others = friction.diagnosis.hypotheses
    assert first.is_confirmed and first.parameters >= 1 and first.gained > 1000.0 and first.gained_held_out > 1000.0
    nothing = [h for h in others if not h.effects]
    assert [(h.gained, h.gained_held_out, h.parameters) for h in nothing] == [(0.0, 0.0, 0)] * len(nothing)


def test_several_effects_are_simulated_one_after_another():
    assert first_effects(2) != first_effects(1)


def test_the_answer_says_by_how_much_the_next_experiment_would_separate_its_rivals(friction):
    diagnosis, proposal = friction.diagnosis, friction.proposal
    assert [each.if_likeliest for each in diagnosis.separations] == pytest.approx(proposal.separations[:, 0].tolist())
    listed = {one for finding in diagnosis.findings for one in finding.ambiguous_sets}
    assert all(each.rival in listed for each in diagnosis.separations) and diagnosis.separations
