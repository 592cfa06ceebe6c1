"""What is said, and what is done, where recordings of another recorder hold what a simulation or a noise model cannot begin with."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from carriage import MACHINE, reference, run

from hil.diagnosis.residuals.mismatch import mismatch
from hil.errors import RecordingError
from hil.machine import load_machine
from hil.machine.load import machine_from_text
from hil.recording import Channel, Recording, RecordingWarning, recording_metadata
from hil.simulation import simulate

WANTED = reference(0.6)
ROWS = len(WANTED)
TIME = np.arange(ROWS) / MACHINE.sample_rate_Hz
TWO_AXES = load_machine("carm")


def recorded(noise_seed: int = 0, machine=MACHINE, experiment: dict | None = None, initial: dict | None = None, **columns) -> Recording:
    position, command = run(WANTED, noise_seed=noise_seed)
    found = {"time": ("s", TIME), "reference_carriage": ("m", WANTED), "excitation_carriage": ("V", np.zeros(ROWS))}
    found |= {"command_carriage": ("V", command), "position_carriage": ("m", position)} | columns
    channels = {name: Channel(unit, values) for name, (unit, values) in found.items()}
    return Recording(channels, recording_metadata(machine, experiment, initial))


def said_of(**recordings: Recording) -> tuple[tuple[str, ...], list[str]]:
    """Channels, and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RecordingWarning)
        found = mismatch(MACHINE, recordings)
    return found.channels, [str(one.message) for one in caught]


def test_of_repeats_as_they_should_be_nothing_is_said():
    channels, said = said_of(a=recorded(0), b=recorded(1))
    assert channels == ("command_carriage", "position_carriage") and said == []


def test_a_channel_that_repeats_do_not_differ_in_is_left_out():
    """A stuck command has no noise, and all that a simulation misses of it would be certain."""
    stuck = ("V", recorded(0)["command_carriage"])
    channels, said = said_of(a=recorded(0, command_carriage=stuck), b=recorded(1, command_carriage=stuck))
    assert channels == ("position_carriage",)
    assert [words.split(":")[0] for words in said] == ["command_carriage"] and "the same in all repeats" in said[0]


def test_last_digits_are_no_noise():
    command = recorded(0)["command_carriage"]
    channels, _ = said_of(a=recorded(0, command_carriage=("V", command)), b=recorded(1, command_carriage=("V", command * (1 + 1e-15))))
    assert channels == ("position_carriage",)


def test_a_controller_of_another_rate_is_not_run_at_this_one():
    other = machine_from_text(MACHINE.text.replace("sample_rate_Hz = 1000.0", "sample_rate_Hz = 500.0"))
    assert other.sample_rate_Hz == 500.0
    _, said = said_of(a=recorded(0, other), b=recorded(1, other))
    assert said == [
        "a, b: simulated under the controller of emps; its own machine file emps runs at 500 Hz, and its controller at no other rate"
    ]


@pytest.mark.parametrize(("initial", "experiment"), [(None, None), ({"speeds": [0.1]}, None), (None, {"settle_rows": 100})])
def test_a_run_that_began_in_motion_is_said_to_have_none_of_its_speed(initial, experiment):
    cut = 400  # in the middle of the first way

    def late(seed: int) -> Recording:
        whole = recorded(seed, initial=initial, experiment=experiment)
        return replace(whole.part(slice(cut, None)), metadata=whole.metadata)

    _, said = said_of(a=late(0), b=late(1))
    begun = [words for words in said if "a, b: carriage began in motion" in words]
    assert bool(begun) is (initial is None and experiment is None)


def test_a_column_of_another_unit_s_name_is_said_to_be_left_out():
    current = ("A", np.ones(ROWS))
    channels, said = said_of(a=recorded(0, current_carriage=current), b=recorded(1, current_carriage=current))
    assert channels == ("command_carriage", "position_carriage")  # what stands for the effort that is not there
    assert said == ["a, b: current_carriage is not compared: the drive of emps is in V, and its measured effort is effort_carriage [V]"]


def test_an_empty_column_of_measured_effort_leaves_the_command():
    empty = ("V", np.full(ROWS, np.nan))
    channels, _ = said_of(a=recorded(0, effort_carriage=empty), b=recorded(1, effort_carriage=empty))
    assert channels == ("command_carriage", "position_carriage")


def test_the_command_stands_for_an_effort_that_one_of_the_recordings_lacks():
    effort = ("V", recorded(0)["command_carriage"])
    channels, _ = said_of(a=recorded(0, effort_carriage=effort), b=recorded(1))
    assert channels == ("command_carriage", "position_carriage")


@pytest.mark.parametrize(("name", "unit", "right"), [("command_carriage", "A", "V"), ("position_carriage", "rad", "m")])
def test_readings_in_another_unit_than_the_machine_s_are_refused(name, unit, right):
    wrong = recorded(0, **{name: (unit, recorded(0)[name])})
    with pytest.raises(RecordingError, match=rf"^a: {name} is in \[{unit}\]; emps reads it in \[{right}\]$"):
        said_of(a=wrong, b=recorded(1))


def test_copies_that_differ_by_rounding_are_refused():
    one = recorded(0)
    columns = {name: (one.channel(name).unit, one[name] * (1.0 + 1e-15)) for name in ("command_carriage", "position_carriage")}
    with pytest.raises(RecordingError, match="a, b: the same but for rounding; repeats differ by noise"):
        said_of(a=one, b=recorded(0, **columns))


@pytest.mark.parametrize(("slow", "said"), [(1.0, True), (0.0, False)])
def test_a_simulation_that_accelerates_otherwise_did_not_begin_in_motion(slow, said):
    """Of the first ten rows the recording makes more of the same acceleration, or as much of a speed of its own."""
    from_rest = 3e-4 * np.minimum(np.arange(ROWS), 40.0) ** (2.0 - slow)
    _, warned = said_of(
        **{name: recorded(k, position_carriage=("m", recorded(k)["position_carriage"] + from_rest)) for k, name in enumerate("ab")}
    )
    assert any("began in motion" in words for words in warned) is said


def test_a_column_that_is_mostly_empty_everywhere_is_said_to_be_left_out():
    few = recorded(0)["command_carriage"].copy()
    few[: int(0.6 * ROWS)] = np.nan
    channels, said = said_of(a=recorded(0, command_carriage=("V", few)), b=recorded(1, command_carriage=("V", few * 1.01)))
    assert channels == ("position_carriage",) and any(
        "a, b: no command_carriage, or most of its samples missing" in words for words in said
    )


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"experiment": {"start_pose": "here"}}, r"metadata experiment.start_pose is 'here'; a list of 1 numbers"),
        ({"experiment": {"start_pose": 0.2}}, r"metadata experiment.start_pose is 0.2; a list of 1 numbers"),
        ({"experiment": {"settle_rows": "few"}}, r"metadata experiment.settle_rows is 'few'; a whole number of rows from 0 to"),
        ({"experiment": {"settle_rows": 10**7}}, r"metadata experiment.settle_rows is 10000000; a whole number of rows from 0 to"),
        ({"initial": {"speeds": ["fast"]}}, r"metadata initial.speeds is \['fast'\]; a list of 1 numbers"),
        ({"initial": {"standing": 0.1}}, r"metadata initial.standing is 0.1; a table with `deviation`"),
        ({"experiment": {"start_pose": [True]}}, r"metadata experiment.start_pose is \[True\]; a list of 1 numbers"),
        ({"initial": {"speeds": [float("inf")]}}, r"metadata initial.speeds is \[inf\]; a list of 1 numbers"),
        ({"initial": {"controller_states": "none"}}, r"metadata initial.controller_states is 'none' of carriage; a table of numbers"),
        ({"initial": {"controller_states": {"carriage": {"position": "none"}}}}, r"initial.controller_states is .* of carriage; a table"),
        ({"initial": {"standing": {"deviation": [float("inf")]}}}, r"metadata initial.standing.deviation is \[inf\]; a list of 1 numbers"),
        ({"experiment": {"period_samples": 200.0}}, r"a: metadata experiment.period_samples is 200.0; a whole number"),
        ({"experiment": {"period_samples": 200, "settle_periods": "1"}}, r"a: metadata experiment.settle_periods is '1'; a whole number"),
    ],
)
def test_metadata_of_another_kind_are_refused_with_what_would_be_right(tables, said):
    with pytest.raises(RecordingError, match=said):
        mismatch(MACHINE, {"a": recorded(0, **tables), "b": recorded(1, **tables)})


def test_an_input_in_another_unit_than_the_drive_s_is_refused():
    with pytest.raises(RecordingError, match=r"excitation_carriage is in \[A\]; emps takes it in \[V\]"):
        mismatch(MACHINE, {"a": recorded(0, excitation_carriage=("A", np.zeros(ROWS)))})


def test_an_excitation_of_one_axis_leaves_the_others_unshaken():
    rows = 400
    columns = {"time": Channel("s", np.arange(rows) / TWO_AXES.sample_rate_Hz)}
    columns |= {f"reference_{axis}": Channel("rad", np.zeros(rows)) for axis in TWO_AXES.axes}
    axis, other = TWO_AXES.axes
    lines = np.sin(0.3 * np.arange(rows))
    one = Recording(columns | {f"excitation_{axis}": Channel("A", lines)}, recording_metadata(TWO_AXES))
    both = Recording({**one.channels, f"excitation_{other}": Channel("A", np.zeros(rows))}, one.metadata)
    answers = [simulate(TWO_AXES, each) for each in (one, both)]
    for name in (f"position_{axis}", f"position_{other}"):
        np.testing.assert_array_equal(answers[0][name], answers[1][name])


def test_a_recorded_feedforward_of_a_loop_that_computes_none_is_said_not_to_be_simulated():
    """A simulation reads reference and excitation; an empty column, or zeros, were no effort."""
    pushed = ("V", 3.0 * np.sin(20.0 * TIME))
    without, given = (simulate(MACHINE, each)["position_carriage"] for each in (recorded(0), recorded(0, feedforward_carriage=pushed)))
    np.testing.assert_array_equal(given, without)
    _, said = said_of(a=recorded(0, feedforward_carriage=pushed), b=recorded(1, feedforward_carriage=pushed))
    assert said == ["a, b: feedforward_carriage is recorded and not simulated: the controller of carriage has no `gravity_feedforward`"]
    for none in (np.zeros(ROWS), np.full(ROWS, np.nan)):
        assert said_of(a=recorded(0, feedforward_carriage=("V", none)), b=recorded(1))[1] == []


@pytest.mark.parametrize(("settle", "said"), [(0, True), (1, False)])
def test_a_first_period_that_holds_the_start_is_said_to_count_as_noise(settle, said):
    period = 200
    push = np.tile(np.sin(2.0 * np.pi * np.arange(period) / period), ROWS // period)
    pushed = recorded(0, experiment={"period_samples": period, "settle_periods": settle, "periods": ROWS // period - settle})
    moved = 1e-3 * push * (1.0 - 0.9 * np.exp(-TIME / 0.05)) + 1e-6 * np.random.default_rng(2).standard_normal(ROWS)
    channels = {**pushed.channels, "excitation_carriage": Channel("V", push), "position_carriage": Channel("m", moved)}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RecordingWarning)
        found = mismatch(MACHINE, {"a": Recording(channels, pushed.metadata)}, channels=["position_carriage"])
    assert found.noise.kind == "periods"
    assert any("a: its first period differs" in str(one.message) for one in caught) is said
