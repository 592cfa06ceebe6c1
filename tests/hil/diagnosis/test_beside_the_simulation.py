"""What is put beside a recording's simulation: where the axes stood, what was lost, and under which controller it ran."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from pushed_mass import RAIL, recorded

from hil.diagnosis.residuals.mismatch import mismatch
from hil.machine import machine_from_text
from hil.recording import Channel, Recording, RecordingWarning, recording_metadata
from hil.simulation import simulate


def way(rows: int) -> np.ndarray:
    return 0.05 * (1.0 - np.cos(np.pi * np.arange(rows) / RAIL.sample_rate_Hz))


def run(rows: int, seed: int) -> Recording:
    return recorded(way(rows), lambda time, position, speed: 0.0, seed)


def test_an_axis_without_a_motor_side_encoder_is_where_its_link_was():
    text = RAIL.text.replace("[sensors.position_carriage]", "[sensors.link_position_carriage]")
    machine = machine_from_text(text[: text.index("[controller.carriage]")] + text[text.index("[limits.carriage]") :])
    time_s = np.arange(800) / machine.sample_rate_Hz
    driven = Recording(
        {"time": Channel("s", time_s), "command_carriage": Channel("V", np.sin(2.0 * np.pi * time_s))}, recording_metadata(machine)
    )
    link = simulate(machine, driven)["link_position_carriage"]
    assert np.ptp(link) > 0.01
    runs = {}
    for seed in range(3):
        noisy = Channel("m", link + 0.01 + 1e-6 * np.random.default_rng(seed).standard_normal(800))
        runs[f"run {seed}"] = Recording({**driven.channels, "link_position_carriage": noisy}, driven.metadata)
    (group,) = mismatch(machine, runs).groups
    np.testing.assert_allclose(group.position[:, 0], link + 0.01, atol=1e-5)
    np.testing.assert_allclose(group.speed[10:-10, 0], np.gradient(link, time_s)[10:-10], atol=2e-3)


def test_of_two_groups_the_clearer_one_says_what_a_channel_loses():
    def lossy(rows: int, seed: int, share: float) -> Recording:
        one = run(rows, seed)
        position = one["position_carriage"].copy()
        for row in 1 + np.flatnonzero(np.random.default_rng(seed).random(rows - 1) < share):
            position[row] = position[row - 1]
        return Recording({**one.channels, "position_carriage": Channel("m", position)}, one.metadata)

    long = {f"long {seed}": lossy(1600, seed, 0.05) for seed in range(3)}
    short = {f"short {seed}": lossy(400, 10 + seed, 0.2) for seed in range(3)}
    clear, faint = (mismatch(RAIL, runs).lost["position_carriage"] for runs in (long, short))
    assert clear.clarity > faint.clarity and clear.share != faint.share
    for runs in (long | short, short | long):
        assert mismatch(RAIL, runs).lost["position_carriage"] == clear


def of_machine(text: str) -> Recording:
    one = run(400, 0)
    return one.with_metadata(machine={"name": "other", "hash": f"hash of {len(text)}", "text": text})


OPEN_LOOP = RAIL.text[: RAIL.text.index("[controller.carriage]")] + RAIL.text[RAIL.text.index("[limits.carriage]") :]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("format = ", "its own machine file: no valid TOML"),
        (OPEN_LOOP, "its own machine file rail: it has no controller"),
        (
            RAIL.text.replace(".carriage]", ".cart]").replace("position_carriage]", "position_cart]"),
            "its own machine file rail: its axes are cart",
        ),
    ],
)
def test_a_recording_whose_own_controller_cannot_be_had_is_named(text, why):
    with pytest.warns(RecordingWarning, match=rf"^a, b: simulated under the controller of rail; {why}") as said:
        mismatch(RAIL, {"a": of_machine(text), "b": of_machine(text), "c": run(400, 1)})
    assert len(said) == 1 and "\n" not in str(said[0].message)


@pytest.mark.parametrize("text", ["", RAIL.text, RAIL.text.replace("94.9267984", "94.9267983")])
def test_a_recording_that_carries_no_machine_or_a_controller_is_not_warned_of(text):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mismatch(RAIL, {"a": of_machine(text)})
