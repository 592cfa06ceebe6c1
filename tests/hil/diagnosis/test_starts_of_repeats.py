"""Repeats stand a count or two from their start pose, each its own: they are one group, simulated from the mean of where they stood."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pushed_mass import GAIN_N_V, RAIL, recorded

from hil.diagnosis.locating.location import locate_outcome
from hil.diagnosis.recorded.dropout import Dropout
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import simulate
from virtual_bus.settings import EffectSetting

TIME_s = np.arange(400) / RAIL.sample_rate_Hz
WAY = 0.05 * (1.0 - np.cos(2.0 * np.pi * 0.5 * TIME_s))


def stood(deviation: float, held: float, seed: int) -> Recording:
    """A run that stood off its pose while its integrator held something."""
    states = {"carriage": {"position": [[held, 0.0], [0.0, 0.0]]}}
    initial = {"standing": {"deviation": [deviation], "speed": [0.0]}, "controller_states": states}
    return recorded(WAY, lambda time, position, speed: 0.0, seed).with_metadata(initial=initial)


def test_they_are_one_group_that_starts_at_the_mean():
    (group,) = mismatch(RAIL, {"a": stood(2e-6, 0.1, 1), "b": stood(-1e-6, 0.1, 2), "c": stood(5e-6, 0.4, 3)}).groups
    assert group.repeats == 3
    np.testing.assert_allclose(group.inputs.standing_pose, [2e-6])
    np.testing.assert_allclose(group.inputs.controller_states["carriage"]["position"], [[0.2, 0.0], [0.0, 0.0]])


def test_the_simulation_beside_them_starts_there_too():
    found = mismatch(RAIL, {"a": stood(1e-5, 0.0, 1), "b": stood(3e-5, 0.0, 2)})
    assert found.groups[0].simulated[0, found.channels.index("position_carriage")] == 2e-5


OPEN = load_machine("laas_anti_cogging")
COUNT = OPEN.plant.encoders[0].resolution


def driven(start: float, seed: int, noise: float = 0.0, **experiment: object) -> Recording:
    """A run without a loop, its start known from its encoder alone."""
    time_s = np.arange(400) / OPEN.sample_rate_Hz
    channels = {"time": Channel("s", time_s), "command_rotor": Channel("A", 0.3 * np.sin(2.0 * np.pi * 3.0 * time_s))}
    at_start = {"position_rotor": Channel("rad", np.full(400, start))}
    position = simulate(OPEN, Recording(channels | at_start, recording_metadata(OPEN)))["position_rotor"]
    read = position + noise * np.random.default_rng(seed).standard_normal(400)
    return Recording(channels | {"position_rotor": Channel("rad", read)}, recording_metadata(OPEN, experiment=experiment))


def test_first_readings_without_a_loop_differ_by_counts_and_are_averaged():
    (group,) = mismatch(OPEN, {"a": driven(0.0, 1), "b": driven(6.0 * COUNT, 2), "c": driven(-3.0 * COUNT, 3)}).groups
    assert group.repeats == 3
    np.testing.assert_allclose(group.inputs.standing_pose, [COUNT], rtol=1e-9)


def test_first_readings_without_a_loop_differ_by_noise():
    noise = 100.0 * COUNT
    runs = {f"run {seed}": driven(0.5, seed, noise) for seed in range(4)}
    (group,) = mismatch(OPEN, runs).groups
    assert group.repeats == 4
    np.testing.assert_allclose(group.inputs.standing_pose, [np.mean([run["position_rotor"][0] for run in runs.values()])], rtol=1e-12)


def test_another_pose_without_a_loop_is_another_experiment():
    noise = 100.0 * COUNT
    groups = mismatch(OPEN, {"a": driven(0.5, 1, noise), "b": driven(0.5 + 20.0 * noise, 2, noise)}).groups
    assert [group.labels for group in groups] == [("a",), ("b",)]
    asked = mismatch(OPEN, {"a": driven(0.0, 1, start_pose=[0.0]), "b": driven(COUNT, 2, start_pose=[COUNT])}).groups
    assert len(asked) == 2


def test_a_load_that_the_loop_holds_is_in_the_command_alone():
    found = mismatch(RAIL, {"a": stood(0.0, 0.2, 1), "b": stood(0.0, 0.2, 2), "c": stood(0.0, 0.2, 3)})
    load = EffectSetting("constant_load", "carriage", {"tau0": 5.0})
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        full, bare = (runs.rows(Trial(runs.nominal, effects), settled=True) for effects in ((load,), ()))
        change = dict(zip(found.channels, (full[0] - bare[0]).T, strict=True))
    assert np.abs(change["position_carriage"]).max() < 1e-9
    np.testing.assert_allclose(np.abs(change["command_carriage"]), 5.0 / GAIN_N_V, rtol=1e-6)
    assert locate_outcome(found, [bare[0]], [full[0] - bare[0]], named=True).channels["command_carriage"] > 0.999


def test_what_was_read_off_a_channel_is_in_that_channel():
    found = mismatch(RAIL, {"a": stood(0.0, 0.0, 1), "b": stood(0.0, 0.0, 2), "c": stood(0.0, 0.0, 3)})
    lost = Dropout(0.02, (0.01, 0.03), 1.0, "", 5.0)
    said = locate_outcome(replace(found, lost={"position_carriage": lost}), [], [np.zeros_like(found.groups[0].mean)], named=True)
    assert said.channels == {"command_carriage": 0.0, "position_carriage": 1.0}
