"""Experiment files read back what was written, carry units, and say in one line what is wrong."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT
from refusals import answer_or_refusal

from controllers.excitation_lines import Band
from hil.errors import ExperimentError
from hil.experiments import Experiment, Jog, JogOnly, Move, Multisine, Scan, Static, experiment_from_text, read_experiment, write_experiment
from hil.experiments.file_text import experiment_text
from hil.machine import load_machine

CARM, EMPS = load_machine("carm"), load_machine("emps")

numbers = st.floats(-10.0, 10.0, allow_nan=False)
positive = st.floats(1e-6, 100.0)
counts = st.integers(1, 20)
poses = st.dictionaries(st.sampled_from(CARM.axes), numbers)
axes = st.sampled_from([(), ("roll",), ("propeller", "roll")])
jogs = st.builds(
    Jog,
    amplitude_rad=positive,
    line=st.none() | counts,
    frequency_Hz=st.none() | positive,
    turn_share=st.floats(0.01, 1.0),
    axes=axes,
)
bands = st.builds(
    Band,
    positive,
    positive,
    st.integers(0, 50),
    st.lists(st.tuples(positive, positive), max_size=3).map(tuple),
    st.booleans(),
    st.integers(0, 4),
)
multisines = st.builds(
    Multisine,
    pose=poses,
    axes=axes,
    experiments=st.sampled_from(["orthogonal", "single"]),
    lines=bands | st.lists(counts, min_size=1, max_size=5).map(tuple),
    weights=st.none() | st.lists(positive, min_size=1, max_size=5).map(tuple),
    amplitude_A=positive | st.fixed_dictionaries({"propeller": positive, "roll": positive}),
    period_s=positive,
    periods=counts,
    settle_periods=st.integers(0, 5),
    realisations=counts,
    phases=st.sampled_from(["random", "optimised"]),
    jog=st.none() | jogs,
    seed=st.integers(0, 2**31),
)
experiments = st.one_of(
    multisines,
    st.builds(JogOnly, pose=poses, axes=axes, jog=jogs, period_s=positive, periods=counts, settle_periods=counts),
    st.builds(Scan, st.sampled_from(CARM.axes), numbers, numbers, positive, poses, positive, counts, st.none() | positive),
    st.builds(Static, positive, poses),
    st.builds(Move, poses, poses),
)


@pytest.mark.slow
@given(experiments)
@settings(max_examples=examples(150), deadline=None)
def test_any_experiment_reads_back_equal(experiment: Experiment) -> None:
    assert experiment_from_text(experiment_text(experiment, CARM), CARM) == experiment


@given(st.text(max_size=200))
@settings(max_examples=examples(150), deadline=None)
def test_any_text_is_an_experiment_or_one_line(text: str) -> None:
    for prefix in ("", 'format = 1\nkind = "multisine"\n', 'format = 1\nkind = "scan"\n'):
        _, refusal = answer_or_refusal(ExperimentError, experiment_from_text, prefix + text, CARM, "e.toml")
        assert refusal is None or (refusal.startswith("e.toml: ") and "\n" not in refusal)


def test_files_are_written_and_read_in_place(tmp_path: Path) -> None:
    experiment = Scan("roll", np.radians(-60.0), np.radians(60.0), np.radians(55.0))
    write_experiment(experiment, CARM, tmp_path / "scan.toml")
    text = (tmp_path / "scan.toml").read_text()
    assert "start_deg = -60.0" in text
    assert "speed_deg_s = 55.0" in text
    assert read_experiment(tmp_path / "scan.toml", CARM) == experiment


def test_units_of_the_file_become_si() -> None:
    text = """
        format = 1
        kind = "multisine"
        axes = ["roll"]
        amplitude_mA = 500
        period_s = 20
        pose = { roll_deg = 30, propeller_mrad = 100 }
        band = { low_Hz = 0.2, high_kHz = 0.03, dense_Hz = [[7, 9]], per_decade = 10 }
        jog = { amplitude_deg = 2, frequency_Hz = 0.05 }
    """
    assert experiment_from_text(text, CARM) == Multisine(
        pose={"roll": 30 * np.pi / 180, "propeller": 0.1},
        axes=("roll",),
        amplitude_A=0.5,
        lines=Band(0.2, 30.0, per_decade=10, dense_Hz=((7.0, 9.0),)),
        jog=Jog(amplitude_rad=2 * np.pi / 180, frequency_Hz=0.05),
    )


def test_a_prismatic_axis_in_volts_has_metres_and_volts() -> None:
    text = 'format = 1\nkind = "multisine"\namplitude_V = 0.5\npose = { carriage_mm = 100 }\njog = { amplitude_mm = 5, line = 1 }\n'
    experiment = experiment_from_text(text, EMPS)
    assert experiment.pose == {"carriage": 0.1}
    assert experiment.amplitude_A == 0.5
    assert experiment.jog.amplitude_rad == 0.005
    assert experiment_from_text(experiment_text(experiment, EMPS), EMPS) == experiment


def test_without_a_jog_table_a_file_has_no_jog() -> None:
    assert experiment_from_text('format = 1\nkind = "multisine"', CARM).jog is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("format = 1", "kind.*is missing; write one of multisine"),
        ('kind = "sweep"\nformat = 1', 'kind = "sweep": no such kind'),
        ('kind = "static"', "format.*is missing"),
        ('kind = "static"\nformat = 2', "format = 2"),
        ('format = 1\nkind = "static"\nduration = 3', "duration.*duration_s"),
        ('format = 1\nkind = "static"\nseconds = 3', "unknown key"),
        ('format = 1\nkind = "static"\nduration_s = -3', "duration_s = -3.*positive"),
        ('format = 1\nkind = "static"\npose = { roll_mm = 3 }', "roll_mm"),
        ('format = 1\nkind = "static"\npose = { tilt_deg = 3 }', "tilt_deg"),
        ('format = 1\nkind = "multisine"\namplitude_V = 3', "amplitude_V = 3: propeller takes A here"),
        ('format = 1\nkind = "multisine"\naxes = ["tilt"]\namplitude_A = 3', "no axis tilt"),
        ('format = 1\nkind = "multisine"\namplitude_A = 3\namplitudes = { roll_A = 1 }', "amplitudes.*keep one"),
        ('format = 1\nkind = "multisine"\nlines = [3]\nband = { low_Hz = 1 }', "band.*keep one"),
        ('format = 1\nkind = "multisine"\nphases = "none"', "phases"),
        ('format = 1\nkind = "multisine"\nlines = [3.5]', r"lines.*whole number"),
        ('format = 1\nkind = "scan"\naxis = "roll"\nstart_deg = 0', "stop.*is missing"),
        ('format = 1\nkind = "scan"\naxis = "roll"\nstart_mm = 0\nstop_deg = 3', "start_mm = 0: roll takes rad here"),
        ('format = 1\nkind = "scan"\naxis = "roll"\nstart_deg = 0\nstop_deg = 3\nspeed_m_s = 3', "speed_m_s = 3: roll takes rad/s here"),
        ('format = 1\nkind = "scan"\naxis = "roll"\nstart_deg = 0\nstop_deg = 3\nacceleration_mm_s2 = 3', "roll takes rad/s2 here"),
        ('format = 1\nkind = "scan"\naxis = "tilt"\nstart_deg = 0\nstop_deg = 3', "no axis tilt"),
        ('format = 1\nkind = "jog"\njog = { amplitude_mm = 2 }', "jog.amplitude_mm = 2: propeller takes rad here"),
        ("format = ", "no valid TOML"),
    ],
)
def test_a_file_that_is_wrong_says_where_and_what_would_be_right(text: str, says: str) -> None:
    with pytest.raises(ExperimentError, match="^e.toml: .*" + says):
        experiment_from_text(text, CARM, "e.toml")


def test_the_examples_of_the_documentation_are_experiments() -> None:
    text = (ROOT / "docs" / "generated" / "file-formats.md").read_text(encoding="utf-8")
    examples = [each for each in re.findall(r"```toml\n(.*?)```", text, re.DOTALL) if "\nkind = " in each]
    assert [type(experiment_from_text(example, CARM)) for example in examples] == [Multisine]


def test_a_file_that_cannot_be_read_says_so(tmp_path: Path) -> None:
    with pytest.raises(ExperimentError, match="No such file"):
        read_experiment(tmp_path / "none.toml", CARM)
    (tmp_path / "bytes.toml").write_bytes(b"\xff")
    with pytest.raises(ExperimentError, match="UTF-8"):
        read_experiment(tmp_path / "bytes.toml", CARM)
