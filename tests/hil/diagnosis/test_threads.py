"""How many threads simulate for a diagnosis, and that its answer does not say how many."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.cli.app import main
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN, FreeRuns, Trial
from hil.errors import BadAnswerError, RecordingError
from hil.machine import load_machine
from hil.recording import write_recording
from hil.simulation import Simulator
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.modules import load_generated


@pytest.mark.parametrize(
    ("processors", "words", "threads"), [({3}, (), 1), ({0, 5}, (), 2), (set(range(64)), (), 4), ({0, 5}, ("--jobs", "1"), 1)]
)
def test_one_thread_per_processor_that_may_be_used_unless_said_otherwise(tmp_path, monkeypatch, processors, words, threads):
    paths = [str(tmp_path / f"{name}.csv") for name in ("one", "two")]
    for path, recording in zip(paths, repeats(2, duration_s=0.1).values(), strict=True):
        write_recording(recording, path)
    asked = []

    def ask(*_, jobs, **__):
        asked.append(jobs)
        raise RecordingError("enough")

    monkeypatch.setattr("hil.diagnosis.from_recordings.is_along_the_motion", lambda *_: False)  # that way has one thread
    monkeypatch.setattr("hil.diagnosis.from_recordings.diagnose", ask)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: processors, raising=False)
    with pytest.raises(SystemExit):
        main(["diagnose", "emps", *paths, "-o", str(tmp_path / "answer"), *words])
    assert asked == [threads]


@pytest.mark.nightly
def test_the_answer_is_the_same_from_two_threads(friction, with_friction):
    two = diagnose(MACHINE, *with_friction, jobs=2)
    assert two.diagnosis.hypotheses == friction.diagnosis.hypotheses
    assert two.diagnosis.findings == friction.diagnosis.findings
    assert two.diagnosis.retuned == friction.diagnosis.retuned


def test_answers_are_those_of_each_trial_alone_whatever_is_asked_before_one_waits(with_friction):
    recordings, others = with_friction
    train = mismatch(MACHINE, aligned(MACHINE, recordings))
    held_out = mismatch(MACHINE, aligned(MACHINE, others), channels=train.channels, noise=train.noise)
    values = [parameter.value for parameter in compile_plant(MACHINE.plant).parameters]
    trials = [Trial(np.array(values) * (1.0 + 0.001 * k)) for k in range(9)]
    answers = {}
    for jobs in (1, 2, 4):
        with FreeRuns({TRAIN: train, HELD_OUT: held_out}, train.noise, jobs) as runs:
            asked = [(name, trials[:count]) for name, count in ((TRAIN, 2), (HELD_OUT, 3), (TRAIN, 0), (HELD_OUT, 1), (TRAIN, 9))]
            waiting = [runs.begin(some, name) for name, some in asked]
            answers[jobs] = [answer() for answer in reversed(waiting)][::-1]
            for (name, some), found in zip(asked, answers[jobs], strict=True):
                assert len(found) == len(some)
                for trial, one in zip(some, found, strict=True):
                    np.testing.assert_allclose(one, runs.run_one(trial, name), rtol=0.0, atol=1e-6)
    for jobs in (2, 4):
        for one, other in zip(answers[1], answers[jobs], strict=True):
            for a, b in zip(one, other, strict=True):
                np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_is_done_at_once_comes_in_order_and_may_ask_for_more_at_once(with_friction, jobs):
    train = mismatch(MACHINE, aligned(MACHINE, with_friction[0]))
    with FreeRuns({TRAIN: train}, train.noise, jobs) as runs:
        found = runs.at_once(lambda tens: runs.at_once(lambda one: 10 * tens + one, range(3)), range(40))
        assert found == [[10 * tens + one for one in range(3)] for tens in range(40)]
        with pytest.raises(ZeroDivisionError):
            runs.at_once(lambda number: 1 // number, [1, 0])


def test_threads_take_turns_as_before_once_the_runs_are_over_or_broken_off(with_friction):
    train = mismatch(MACHINE, aligned(MACHINE, with_friction[0]))
    before = sys.getswitchinterval()
    with pytest.raises(RecordingError), FreeRuns({TRAIN: train}, train.noise, 2):
        assert sys.getswitchinterval() < before
        raise RecordingError("enough")
    assert sys.getswitchinterval() == before


def test_a_plant_that_two_threads_ask_answers_each():
    plant = compile_plant(load_machine("carm").plant)
    model = plant.model(plant.nominal)
    poses = np.random.default_rng(3).uniform(-0.3, 0.3, (40, plant.joints))

    def inertias(pose):
        return [plant.inertia_and_bias(model, pose, np.zeros(plant.joints))[0] for _ in range(20)]

    alone = [inertias(pose)[0] for pose in poses]
    with ThreadPoolExecutor(4) as pool:
        for one, several in zip(alone, pool.map(inertias, poses), strict=True):
            assert all(np.array_equal(one, other) for other in several)


def test_threads_that_ask_for_a_module_at_once_get_the_whole_of_it(tmp_path, monkeypatch):
    monkeypatch.setenv("ISOCENTER_CACHE", str(tmp_path))
    text = "import time\ntime.sleep(0.05)\nready = True\n"
    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(lambda _: load_generated("slow", text).ready, range(4)))


@pytest.mark.parametrize(("duration_s", "side_by_side"), [(1.9, False), (2.1, True)])
def test_short_recordings_are_simulated_one_machine_at_a_time(monkeypatch, duration_s, side_by_side):
    """Nothing is compiled for them that they would not make up for."""
    train = mismatch(MACHINE, aligned(MACHINE, repeats(2, duration_s=duration_s)))
    asked = []
    monkeypatch.setattr(
        Simulator, "run_all", lambda self, inputs, trials: asked.append(len(trials)) or [BadAnswerError("none")] * len(trials)
    )
    with FreeRuns({TRAIN: train}, train.noise) as runs:
        answers = runs.run([Trial(runs.nominal)] * 5)
    assert (sum(asked) == 5) is side_by_side
    assert all((answer is None) is side_by_side for answer in answers)
