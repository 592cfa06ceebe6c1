"""Noise of a record's begin: what a machine that rested lacks of the disturbances that were there before its first row."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pushed_mass import RAIL, pushed_mass, recorded

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.judging.form_error import NO_ERROR, FormError
from hil.diagnosis.judging.gate import LEVEL
from hil.diagnosis.judging.judgement import Judgement
from hil.diagnosis.judging.onset import onset
from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.searching import selection
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import retune

TIME_s = np.arange(1600) / RAIL.sample_rate_Hz
WAY = 0.05 * (1.0 - np.cos(2.0 * np.pi * 0.5 * np.maximum(TIME_s - 0.5, 0.0)))
SHAKES_Hz, APART_Hz = 7.0, 0.21
TO_ONE_SIDE = {"all alike": (0.3, [0.0, 0.0, 0.0, 0.0]), "each its own": (0.6, [0.6, -0.5, 0.9, -0.3])}


def at_rest(time, position, speed):
    return 0.0


def shaken(size_N: float, begins: float, number: int):
    """A force of slightly another frequency in every repeat, which begins at this phase."""
    w = 2.0 * np.pi * (SHAKES_Hz + APART_Hz * number)
    return lambda time, position, speed: size_N * np.sin(w * time + begins)


def repeats(size_N: float, phases: list[float]):
    return {f"{k}": recorded(WAY, shaken(size_N, begins, k), k) for k, begins in enumerate(phases)}


@pytest.mark.nightly
@pytest.mark.parametrize(("size_N", "phases"), TO_ONE_SIDE.values(), ids=TO_ONE_SIDE)
def test_repeats_that_noise_first_pushes_to_one_side_lack_no_physics(monkeypatch, size_N, phases):
    held_out = {"held out": recorded(0.5 * WAY, shaken(size_N, phases[0], 5), 9)}
    found = diagnose(RAIL, repeats(size_N, phases), held_out, look_further=False)
    assert found.diagnosis.verdict in ("consistent", "retuned")
    gate = found.selection.gates[0]
    assert gate.gain > 40.0 and gate.trained > 1.0
    monkeypatch.setattr(selection, "onset", lambda runs, name, tuning: NO_ERROR)
    gate = diagnose(RAIL, repeats(size_N, phases), held_out, look_further=False).selection.gates[0]
    assert gate.trained < LEVEL, "this is what misleads"


@pytest.fixture(scope="module")
def shaking():
    found = mismatch(RAIL, aligned(RAIL, repeats(0.6, [0.0, 1.7, 3.1, 4.6])))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


def test_it_is_a_speed_and_a_deviation_that_the_loop_takes_back(shaking):
    """Against Euler steps of the block in its loop that begin so, as far and as fast as it is shaken, in the mean of four repeats."""
    runs, tuning = shaking
    still, _ = pushed_mass(WAY, at_rest)
    shaken_off = (pushed_mass(WAY, shaken(0.6, 0.0, 0))[0] - still)[len(WAY) // 4 :]
    sizes = shaken_off.std(), np.gradient(shaken_off).std() * RAIL.sample_rate_Hz
    responses = onset(runs, TRAIN, tuning).responses
    assert len(responses) == 2
    assert [name.split("_")[0] for name in runs.sets[TRAIN].channels] == ["command", "position"]
    for begins, own in zip(((0.0, sizes[1]), (sizes[0], 0.0)), responses, strict=True):
        rows = [np.subtract(*pair) for pair in zip(pushed_mass(WAY, at_rest, begins=begins), pushed_mass(WAY, at_rest), strict=True)]
        answer = runs.joined([np.column_stack(rows[::-1])], TRAIN) / np.sqrt(4.0)
        assert float(own @ answer) > 0.99 * np.linalg.norm(own) * np.linalg.norm(answer)
        assert np.linalg.norm(own) == pytest.approx(np.linalg.norm(answer), rel=0.1)


def test_lines_that_count_less_held_out_count_less_in_it_too(shaking):
    """What is asked before and after weights of held-out lines have changed is in the units of its time."""
    runs, tuning = shaking
    asked: list[str] = []
    judge = SimpleNamespace(leave_out_own_lines=lambda fits: True, follow=lambda *_: None, misfit=lambda _: 0.0)

    def begins(name: str) -> FormError:
        asked.append(name)
        return NO_ERROR

    judgement = Judgement(runs, tuning, judge, float(len(runs.measured())), None, begins)
    judgement.without_own_lines([])
    assert asked.count(HELD_OUT) == 2


def test_of_a_machine_that_cannot_be_simulated_nothing_is_known(shaking):
    runs, tuning = shaking
    driven_on = np.array([-1e4 if parameter.quantity == "damping" else 1.0 for parameter in runs.parameters])
    diverging = replace(tuning, values=driven_on * tuning.values)
    assert runs.run_one(Trial(diverging.values)) is None
    assert onset(runs, TRAIN, diverging) is NO_ERROR


def test_of_noise_that_no_repeats_show_nothing_is_known():
    found = mismatch(RAIL, aligned(RAIL, repeats(0.6, [0.0])))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        assert onset(runs, TRAIN, retune(runs)) is NO_ERROR
