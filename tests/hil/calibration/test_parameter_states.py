"""Parameters as states: the filter's steps, what it states against drawn truth, late and wrong images, withdrawal, drift, and its files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.calibration.parameter_states.chain_modes import read_swinging
from hil.calibration.parameter_states.drawn_runs import Conditions, drawn_run
from hil.calibration.parameter_states.filter import ParameterStatesFilter
from hil.calibration.parameter_states.model import SwingingMachine
from hil.calibration.parameter_states.run import estimate
from hil.calibration.parameter_states.study import (
    Draw,
    by_model,
    draw,
    drawn_machine,
    falling,
    held_out,
    randomness,
    under,
)
from hil.errors import UnusableInputError

CHAINS = Path(__file__).parents[3] / "benchmarks" / "chains"
START = read_swinging(CHAINS / "table_2_1.toml")
RANDOM = randomness(START)
SHORT = Conditions(seconds=6.0, images_Hz=4.0)


@pytest.fixture(scope="module")
def draws() -> list[Draw]:
    return [draw(START, drawn_machine(START, RANDOM, seed), seed, SHORT) for seed in range(4)]


def test_gravity_pulls_at_elastic_joints_as_the_potential_of_what_they_carry_falls() -> None:
    chain, positions = START.chain, np.random.default_rng(2).uniform(-1.0, 1.0, (6, 4))
    stiff = replace(chain, compliance=np.full(2, 1e-30))
    _, effort = stiff.deflections(positions)
    loads = [(40.0, np.array([0.05, 0.02, -0.05]), {0, 1}), (200.0, np.array([0.1, 0.3, 0.4]), {1})]  # mass, centre, joints that carry it
    for joint in range(2):
        slope = np.zeros(6)
        for sign in (1.0, -1.0):
            swing = np.zeros((6, 2))
            swing[:, joint] = sign * 1e-5
            _, phantom, rotation = stiff.poses(positions, swing)
            for mass, center, carried in loads:
                if joint in carried:
                    place = np.einsum("nij,ni->nj", rotation, center - phantom)
                    slope += sign * mass * (place @ START.gravity_m_s2) / 2e-5
        np.testing.assert_allclose(effort[:, joint], slope, atol=1e-4 * np.abs(slope).max())
        assert np.ptp(slope) > 5.0


def test_a_step_s_derivatives_are_its_differences() -> None:
    rng = np.random.default_rng(3)
    still = replace(RANDOM, jerk=np.zeros(4), push=np.zeros(2), bias_walk=np.zeros(6))
    effort = rng.normal(0.0, 5.0, 4)

    def stepped(x: np.ndarray, line: np.ndarray) -> ParameterStatesFilter:
        work = ParameterStatesFilter(START, still, np.zeros(4))
        work.x, work.covariance = x.copy(), np.outer(line, line)
        work.predict(0.013, effort)
        return work

    first = ParameterStatesFilter(START, RANDOM, np.zeros(4))
    x = first.x + 0.3 * np.sqrt(np.diag(first.covariance)) * rng.normal(size=len(first.x))
    for k in range(first.fixed.start):
        line = np.zeros(len(x))
        line[k] = 1e-6 * max(abs(x[k]), 1e-3)
        difference = (stepped(x + line, line).x - stepped(x - line, line).x) / 2.0
        found = stepped(x, line).covariance
        np.testing.assert_allclose(found, np.outer(difference, difference), atol=1e-5 * np.abs(found).max(), err_msg=str(k))


def test_what_is_stated_is_true_of_drawn_machines(draws: list[Draw]) -> None:
    nees = np.array([each.nees() for each in draws])
    assert 0.5 < nees[:, 0].mean() < 1.5  # 29 parameters, four draws: 0.74 to 1.29 at 95 %, less what jerk is stated too large
    assert 0.3 < nees[:, 1].mean() < 2.0
    assert 0.5 < np.mean([each.gaps()[1].mean() for each in draws]) < 1.5
    assert not any(each.found.refused for each in draws)


def test_images_correct_chain_and_modes_together(draws: list[Draw]) -> None:
    for each in draws:
        p = len(START.chain.names)
        before, after = (each.true.chain.with_values(values[:p]) for values in (each.found.values[0], each.found.values[-1]))
        assert held_out(each.true.chain, before)[0] > 2e-3
        assert held_out(each.true.chain, after)[0] < 0.1e-3
        assert held_out(each.true.chain, after)[1] < 0.5e-3
        off, was = np.abs(each.found.values[-1][p : p + 2] - each.target[p : p + 2]), np.abs(each.target[p : p + 2])
        assert off.max() < 0.02
        assert off.max() < max(was.max(), 0.01)
        fitted = by_model(START, each.run)
        assert fitted is not None
        assert held_out(each.true.chain, fitted)[0] < 0.2e-3


def test_gear_ratios_and_compliances_are_found_apart(draws: list[Draw]) -> None:
    names = draws[0].found.names
    for name in ("beta_j2", "beta_j4", "compliance_detector_mount"):
        k = names.index(name)
        for each in draws:
            assert each.found.deviations[-1][k] < 0.05 * each.found.deviations[0][k]
            assert abs(each.found.values[-1][k] - each.target[k]) < 4.0 * each.found.deviations[-1][k]


def test_a_late_image_counts_for_what_it_would_have_in_time() -> None:
    random = replace(RANDOM, parameters=0.02 * RANDOM.parameters, dynamic=0.1 * RANDOM.dynamic)  # one linearisation reaches
    run, _ = drawn_run(drawn_machine(START, random, 7), random, replace(SHORT, seconds=4.0), 7)
    images = run.images[:10]
    prompt, late = (
        estimate(START, random, replace(run, images=tuple(replace(each, arrives_s=each.time_s + delay) for each in images)))
        for delay in (1e-6, 0.9)
    )
    spots = np.r_[late.final.fixed, late.final.dynamic]  # at the end of the run: at their arrivals the sensor has told more
    gap = np.abs(prompt.final.x - late.final.x)[spots] / np.sqrt(np.diag(late.final.covariance)[spots])
    assert gap.max() < 0.1
    moved = np.abs(prompt.values[-1] - prompt.values[0]) / prompt.deviations[-1]
    assert moved.max() > 3.0


def test_wrong_images_are_refused_and_a_machine_far_off_its_drawing_is_believed() -> None:
    wrong = under(START, None, 1, SHORT, {"wrong_images": 0.15})
    assert 1 <= len(wrong.found.refused) <= 10
    assert wrong.nees()[0] < 2.0
    far = under(START, None, 0, SHORT, {"scale": 3.0})
    assert far.found.widened > 0
    p = len(START.chain.names)
    assert held_out(far.true.chain, far.true.chain.with_values(far.found.values[-1][:p]))[0] < 0.3e-3


def test_with_images_withdrawn_poses_stay_true_and_drifting_frequencies_are_followed() -> None:
    seconds = 14.0
    true = drawn_machine(START, RANDOM, 2)
    found = draw(START, true, 2, replace(SHORT, seconds=seconds), withdrawn=20, drift=falling(0.1, seconds))
    assert len(found.found.used) == 20
    gap, squares = found.gaps()
    after = np.array(found.found.at_s) > 8.0
    assert np.sqrt(np.mean(np.sum(gap[after, 3:6] ** 2, axis=1))) < 0.15e-3
    assert 0.3 < squares[after].mean() < 2.0
    p = len(START.chain.names)
    off = found.found.final.x[found.found.final.dynamic][:2] - found.target[p : p + 2]
    assert np.abs(off).max() < 0.03
    kept = draw(START, true, 2, replace(SHORT, seconds=seconds), withdrawn=20)
    assert np.abs(kept.target[p : p + 2] - found.target[p : p + 2]).min() > 0.1  # what had to be followed


def test_the_chain_s_file_names_what_is_wrong(tmp_path: Path) -> None:
    text = (CHAINS / "table_2_1.toml").read_text()
    for old, new, message in (
        ("row = 3", "row = 9", "mode 2: row = 9: must be a whole number from 0, the panel, to 5"),
        ("frequency_Hz = 14.0", "frequency_Hz = -1.0", "mode 1: frequency_Hz = -1.0: must be a positive number"),
        ("damping = 0.01\n", "damping = 1.5\n", "mode 1: damping = 1.5: must be a ratio below 1"),
        ("axis = [0.4, 0.9165, 0.0]", "axis = [0.4, 0.9165]", r"mode 1: axis = \[0.4, 0.9165\]: must be 3 numbers"),
        ('name = "arm"', 'name = "detector_mount"', "mode 2: name = 'detector_mount': must be a text of its own"),
        ("gain_rad_s2 = [0.01, 0.02, 0.02, 0.01]", "gain_rad_s2 = 3", "mode 1: gain_rad_s2 = 3: must be 4 numbers"),
    ):
        assert old in text
        path = tmp_path / "chain.toml"
        path.write_text(text.replace(old, new, 1))
        with pytest.raises(UnusableInputError, match=message):
            read_swinging(path)
    path.write_text(text[: text.index("[[mode]]")])
    with pytest.raises(UnusableInputError, match=r"must have a table \[\[mode\]\]"):
        read_swinging(path)


def test_the_start_is_what_the_file_says() -> None:
    machine: SwingingMachine = START
    assert machine.chain.names[-2:] == ("compliance_detector_mount", "compliance_arm")
    assert machine.dynamic_names[0] == "log_frequency_detector_mount"
    assert machine.gain.shape == (2, 4)
