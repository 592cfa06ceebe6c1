"""What the page's figures show, and what the answer says of which equation is short and which numbers stay as they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import MACHINE, MASS_kg

from hil.diagnosis.answering.estimates import retuned_values
from hil.diagnosis.answering.hypotheses import against_held_out
from hil.diagnosis.diagnose import first_effects, simulated_stages
from hil.diagnosis.report.effect_map import effect_map
from hil.diagnosis.report.page import report_blocks
from hil.diagnosis.report.waterfall import left_above_noise, waterfall_figure
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt, Stages
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import retune, tunable
from virtual_bus.settings import EffectSetting


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
    (shown,) = report_blocks(friction)["effect"]
    (chart,) = shown.cells
    assert chart.title.startswith("coulomb_friction at carriage") and chart.x.label == "speed of carriage [m/s]"
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
    (shown,) = report_blocks(friction)["disturbance"]
    (chart,) = shown.cells
    assert chart.y.label == "on carriage [N]" and chart.x.label == "time [s]"


def test_every_number_that_may_be_re_tuned_is_shown_or_named_with_the_reason_why_not(friction):
    diagnosis = friction.diagnosis
    names = {f"{p.owner}.{p.quantity}" for p in (friction.tuning.parameters[k] for k in tunable(friction.tuning.parameters))}
    assert names == {*diagnosis.retuned, *diagnosis.frozen}
    assert diagnosis.retuned["carriage.mass"].value == pytest.approx(1.05 * MASS_kg, rel=0.02)


def test_a_number_that_is_not_decided_is_said_with_the_value_that_the_file_gets(friction):
    tuning = friction.tuning
    shown, frozen = retuned_values(tuning, None, np.ones(len(tuning.offset)))
    values = {f"{p.owner}.{p.quantity}": float(value) for p, value in zip(tuning.parameters, tuning.values, strict=True)}
    assert shown == {} and "carriage.mass" in frozen
    for name, said in frozen.items():
        assert "narrow it to 100%" in said and f"machine.toml has {values[name]:.5g} " in said


def test_a_number_that_these_recordings_do_not_move_is_named_too(friction):
    none = np.zeros(0)
    blind = replace(friction.tuning, indices=none.astype(int), scale=none, offset=none, covariance=np.zeros((0, 0)))
    shown, frozen = retuned_values(blind, None, none)
    assert shown == {} and frozen["carriage.mass"] == "these recordings do not show it; it stays at 95.109 kg"


def test_a_hypothesis_says_what_it_gains_and_what_it_takes(friction):
    first, *others = friction.diagnosis.hypotheses
    assert first.effects == (EffectAt("coulomb_friction", "carriage"),) and first.is_confirmed and first.parameters == 1
    (sentence, *_) = friction.diagnosis.findings[0].evidence_for
    assert f"falls by {first.gained:.4g};" in sentence
    assert 0.0 < first.gained_held_out < first.gained
    assert all(h.gained <= first.gained * 1.01 for h in others)


def test_with_the_effects_a_worse_held_out_misfit_is_evidence_against_them(friction):
    better = replace(friction.diagnosis.fit, held_out=Stages(5.0, 3.0, 1.1, 3.1, 1.0))
    worse = replace(better, held_out=Stages(5.0, 1.031, 1.084, 1.03, 1.0))
    assert against_held_out(better) == [] == against_held_out(replace(better, held_out=None))
    assert against_held_out(worse) == ["with training's numbers held-out E does not fall: 1.031 re-tuned, 1.084 with all effects"]


def test_one_effect_that_raises_the_misfit_without_the_other_is_one_bar_with_it(friction):
    fit = replace(friction.diagnosis.fit, held_out=Stages(np.sqrt(101.0), np.sqrt(81.0), np.sqrt(6.0), None, 1.0))
    both = (EffectAt("coulomb_friction", "carriage"), EffectAt("constant_load", "carriage"))
    for first in ([np.sqrt(90.0)], [None]):
        heights = [height for *_, height in bars(waterfall_figure(fit, both, first))]
        assert heights == pytest.approx([100.0, 20.0, 75.0, 5.0])


def test_the_simulation_with_the_first_of_two_effects_lacks_the_second(with_friction):
    found = mismatch(MACHINE, with_friction[0])
    with FreeRuns({TRAIN: found}, found.noise, 1) as runs:
        tuning = retune(runs)
        both = (EffectSetting("coulomb_friction", "carriage", {"Fc": 20.0}), EffectSetting("constant_load", "carriage", {"tau0": 5.0}))
        stages = simulated_stages(runs, tuning, tuning.values, both)[TRAIN]
        alone = runs.rows(Trial(tuning.values, both[:1]), TRAIN)
    (first,), (extended,) = stages[first_effects(1)], stages["extended"]
    assert np.array_equal(first, alone[0]) and not np.allclose(first, extended)


def test_the_answer_says_by_how_much_the_next_experiment_would_separate_its_rivals(friction):
    said, proposal = friction.diagnosis.separations, friction.proposal
    names = [" and ".join(map(str, each.rival)) for each in said]
    assert names == [model.name for model in proposal.models[1:]] and names
    assert [(each.if_likeliest, each.if_rival) for each in said] == [tuple(row) for row in proposal.separations.tolist()]
