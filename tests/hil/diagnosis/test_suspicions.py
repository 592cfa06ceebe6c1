"""Wrong signs, units and delays are pointed out, and whether the answer comes in time."""

from __future__ import annotations

import numpy as np
import pytest
from carriage import MACHINE, MASS_kg, repeats

from hil.diagnosis.answering.suspicions import suspicions
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.residuals.mismatch import mismatch
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import simulate

MOTOR = load_machine("laas_anti_cogging")
TIME = np.arange(2000) / MOTOR.sample_rate_Hz
RANDOM = np.random.default_rng(4)
COMMAND = sum(0.1 * np.sin(2.0 * np.pi * f * TIME + RANDOM.uniform(0.0, 6.0)) for f in (1.5, 2.5, 3.5, 5.5, 8.5))


def recording(time, **columns) -> Recording:
    units = {"command_rotor": "A", "position_rotor": "rad", "speed_rotor": "rad/s"}
    channels = {"time": Channel("s", time)} | {name: Channel(units[name], values) for name, values in columns.items()}
    return Recording(channels, recording_metadata(MOTOR))


def late(values, rows):
    return np.concatenate([np.full(rows, values[0]), values[:-rows]])


@pytest.fixture(scope="module")
def clean():
    return simulate(MOTOR, recording(TIME, command_rotor=COMMAND))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda x: -x, "runs against its simulation"),
        (np.degrees, "degrees for radians"),
        (lambda x: late(x, 12), " 12 ms later"),
        (lambda x: np.concatenate([x[12:], np.zeros(12)]), " 12 ms earlier"),
    ],
)
def test_wrong_signs_units_and_delays_are_pointed_out(clean, change, said):
    wrong = recording(TIME, command_rotor=COMMAND, position_rotor=change(clean["position_rotor"]), speed_rotor=clean["speed_rotor"])
    found = suspicions(mismatch(MOTOR, {"rec": wrong}))
    assert any(said in sentence and sentence.startswith("position_rotor") for sentence in found)
    assert not any(sentence.startswith("speed_rotor") for sentence in found)


def test_a_sign_that_is_wrong_is_no_delay():
    """Turned, a slow motion comes nearest to itself half a period away, which is farther than is looked for."""
    command = 0.3 * np.sin(2.0 * np.pi * 3.0 * TIME)
    clean = simulate(MOTOR, recording(TIME, command_rotor=command))
    turned = recording(TIME, command_rotor=command, position_rotor=clean["position_rotor"], speed_rotor=-clean["speed_rotor"])
    assert [sentence.split(" (")[0] for sentence in suspicions(mismatch(MOTOR, {"rec": turned}))] == [
        "speed_rotor runs against its simulation"
    ]


@pytest.fixture
def both_late(clean):
    """Position 12 rows late, speed 9 and turned."""
    position, speed = late(clean["position_rotor"], 12), -late(clean["speed_rotor"], 9)
    return mismatch(MOTOR, {"rec": recording(TIME, command_rotor=COMMAND, position_rotor=position, speed_rotor=speed)})


def beside(found, **rows):
    """The same recordings beside a simulation with these rows."""
    simulated = found.groups[0].simulated.copy()
    for name, values in rows.items():
        simulated[:, found.channels.index(name)] = values
    return found.with_simulated([simulated])


def delays(found, answered):
    return [sentence for sentence in suspicions(found, answered) if "ms later" in sentence or "ms earlier" in sentence]


@pytest.mark.parametrize(
    ("rows", "scale", "in_time"),
    [(12, 1.0, True), (12, 0.9, True), (11, 1.0, True), (7, 1.0, False), (17, 1.0, False), (0, 1.0, False)],
)
def test_where_the_answers_simulation_comes_in_time_that_is_said_with_the_delay(both_late, clean, rows, scale, in_time):
    simulated = scale * late(clean["position_rotor"], rows) if rows else clean["position_rotor"]
    said = delays(both_late, beside(both_late, position_rotor=simulated))
    assert said[0] == "position_rotor comes 12 ms later than its simulation" + (", and in time beside the answer's" if in_time else "")
    assert not any("in time" in sentence for sentence in said[1:])  # the speed, which this answer does not mend


def test_a_wrong_sign_stays_one_whatever_the_answer_makes_of_it(both_late):
    mended = beside(both_late, speed_rotor=both_late.groups[0].mean[:, both_late.channels.index("speed_rotor")])
    assert any(sentence.startswith("speed_rotor runs against its simulation") for sentence in suspicions(both_late, mended))


def test_an_answer_that_cannot_be_simulated_comes_in_no_time(both_late):
    nothing = both_late.with_simulated([np.full_like(both_late.groups[0].simulated, np.nan)])
    assert delays(both_late, nothing) == delays(both_late, None)


@pytest.mark.slow
@pytest.mark.parametrize(("duration_s", "verdict"), [(0.6, "inconclusive"), (3.0, "retuned")])
def test_only_an_answer_that_says_what_the_machine_is_is_asked(monkeypatch, duration_s, verdict):
    asked = []
    monkeypatch.setattr("hil.diagnosis.diagnose.suspicions", lambda *both: asked.append(both) or ("said",))
    outcome = diagnose(MACHINE, repeats(3, mass=1.09 * MASS_kg, duration_s=duration_s, seed=7), look_further=False)
    (found, answered), said = asked[0], outcome.diagnosis.suspicions
    assert outcome.diagnosis.verdict == verdict and said == ("said",)
    assert found is outcome.train
    if verdict == "retuned":
        assert all(group.simulated is rows for group, rows in zip(answered.groups, outcome.stages["train"]["extended"], strict=True))
    else:
        assert answered is None
