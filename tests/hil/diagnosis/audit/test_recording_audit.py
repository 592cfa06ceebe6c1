"""Recordings that are not what they say are told so, with the channel and what is wrong; sound ones are not accused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Isocenter

from hil.diagnosis.audit.readings import Fault
from hil.diagnosis.audit.recordings import faults
from hil.errors import RecordingError
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata, write_recording
from hil.simulation import simulate

TURNTABLE, MOTOR, CARM = (load_machine(name) for name in ("turntable", "laas_anti_cogging", "carm"))
ROWS = 2000
TIME_s = np.arange(ROWS) / 200.0
Change = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def turned() -> Recording:
    """A table in its loop, as the simulator has it, with a current sensor's noise."""
    rng = np.random.default_rng(7)
    slow = 0.2 * np.sin(2.0 * np.pi * 0.3 * TIME_s) ** 2 + 0.03 * np.sin(2.0 * np.pi * 1.1 * TIME_s) * np.clip(TIME_s, 0.0, 1.0)
    channels = {
        "time": Channel("s", TIME_s),
        "reference_turn": Channel("rad", slow),
        "excitation_turn": Channel("A", 0.3 * rng.normal(size=ROWS)),
    }
    made = simulate(TURNTABLE, Recording(channels, recording_metadata(TURNTABLE)))
    return changed(made, "current_turn", lambda v: 0.005 * np.round((v + 0.05 * rng.normal(size=ROWS)) / 0.005))


@pytest.fixture(scope="module")
def driven() -> Recording:
    """A rotor with its damper under a current: from its two equations alone, on its encoder's lattice."""
    time = np.arange(6000) / 1000.0
    speed = 8.0 * np.sin(2.0 * np.pi * 0.5 * time) + 8.0 * np.sin(2.0 * np.pi * 8.0 * time)
    change = 8.0 * np.pi * np.cos(2.0 * np.pi * 0.5 * time) + 128.0 * np.pi * np.cos(2.0 * np.pi * 8.0 * time)
    step = MOTOR.plant.encoders[0].resolution
    position = step * np.round((np.cumsum(speed) - 0.5 * (speed + speed[0])) / 1000.0 / step)
    channels = {
        "time": Channel("s", time),
        "command_rotor": Channel("A", 2.49e-4 * change + 0.0185 * speed),
        "position_rotor": Channel("rad", position),
        "speed_rotor": Channel("rad/s", speed + 0.02 * np.random.default_rng(3).normal(size=len(time))),
    }
    return Recording(channels, recording_metadata(MOTOR))


def changed(recording: Recording, name: str, by: Change) -> Recording:
    """Change the values of one channel."""
    channel = recording.channel(name)
    return Recording({**recording.channels, name: Channel(channel.unit, by(channel.values.copy()))}, recording.metadata)


def during(first: int, last: int, of: Change) -> Change:
    def by(values: np.ndarray) -> np.ndarray:
        values[first:last] = of(values[first:last])
        return values

    return by


def late(rows: int) -> Change:
    return lambda v: np.concatenate([np.full(rows, v[0]), v[:-rows]])


def smoothed(values: np.ndarray) -> np.ndarray:
    """Take a weighted mean over 41 rows."""
    return np.convolve(np.pad(values, 20, "edge"), np.hanning(41) / 20.0, "valid")


def only(found: list[Fault]) -> Fault:
    assert found, "nothing is said"
    return found[0]


def test_sound_recordings_are_not_accused(turned: Recording, driven: Recording) -> None:
    assert faults(TURNTABLE, {"a": turned}) == []
    assert faults(MOTOR, {"a": driven}) == []


@pytest.mark.parametrize(
    ("name", "by", "said"),
    [
        ("position_turn", np.degrees, "position_turn is in degrees: 57.3 times"),
        ("position_turn", lambda v: -v, "position_turn is of the opposite sign"),
        ("position_turn", late(4), "position_turn is 4 rows late"),
        ("command_turn", late(3), "command_turn is 3 rows late"),
        ("command_turn", lambda v: 1e3 * v, "command_turn is in mA: 1000 times"),
        ("command_turn", lambda v: -v, "command_turn is of the opposite sign"),
        ("current_turn", lambda v: -v, "current_turn is of the opposite sign"),
        ("current_turn", lambda v: 1e3 * v, "current_turn is in mA"),
        ("current_turn", late(26), "rows) late beside command_turn"),
        ("current_turn", lambda v: np.random.default_rng(1).permutation(v), "current_turn does not follow command_turn"),
        ("link_position_turn", np.degrees, "link_position_turn is in degrees"),
        ("time", lambda v: 1e3 * v, "time is in ms"),
        ("time", lambda v: 2.0 * v, "not 10 ms as time says"),
        ("time", lambda v: v + np.random.default_rng(1).uniform(0.0, 0.0045, ROWS), "time stamps jitter"),
        ("position_turn", during(800, 900, lambda v: v[0]), "stuck"),
        ("position_turn", during(800, 900, lambda v: np.nan), "position_turn is missing from 4 to 4.495 s"),
        ("position_turn", during(900, ROWS, lambda v: v + 2.0 * np.pi), "by 1 turn"),
        ("position_turn", during(900, 901, lambda v: v + 1.0), "readings that no motion reaches"),
        ("position_turn", lambda v: np.clip(v, 0.05, 0.15), "position_turn is clipped at 0.15 rad"),
        ("position_turn", lambda v: np.interp(TIME_s, TIME_s[::5], v[::5]), "between every 5 rows"),
        ("position_turn", smoothed, "position_turn is smoother than readings"),
        ("position_turn", lambda v: 0.0 * v, "position_turn stays at 0 in every row"),
        ("current_turn", lambda v: np.clip(v, -0.1, 0.1), "current_turn is clipped at 0.1 A"),
    ],
)  # fmt: skip
def test_a_fault_is_told_with_its_channel(turned: Recording, name: str, by: Change, said: str) -> None:
    found = only(faults(TURNTABLE, {"a": changed(turned, name, by)}))
    assert found.channel == name
    assert said in found.said


@pytest.mark.parametrize(
    ("name", "by", "said"),
    [
        ("speed_rotor", lambda v: v * 30.0 / np.pi, "speed_rotor is in rpm"),
        ("speed_rotor", lambda v: -v, "speed_rotor is of the opposite sign"),
        ("command_rotor", lambda v: -v, "command_rotor is of the opposite sign"),
        ("command_rotor", lambda v: 1e3 * v, "command_rotor is in mA"),
        ("position_rotor", np.degrees, "position_rotor is in degrees"),
    ],
)  # fmt: skip
def test_without_a_controller_motion_and_effort_are_held_against_each_other(driven: Recording, name: str, by: Change, said: str) -> None:
    assert said in only(faults(MOTOR, {"a": changed(driven, name, by)})).said


@pytest.mark.parametrize(("eps", "share"), [(-0.4, 0.6), (0.8, 1.8)])
def test_what_the_catalogue_names_is_no_fault_of_recordings(driven: Recording, eps: float, share: float) -> None:
    """A torque constant that is off, a late sensor: physics that a diagnosis may name."""
    assert faults(MOTOR, {"a": changed(driven, "command_rotor", lambda v: share * v)}) == [], eps
    assert faults(MOTOR, {"a": changed(driven, "position_rotor", late(30))}) == []


def test_what_is_asked_for_is_no_measurement(turned: Recording) -> None:
    found = only(faults(TURNTABLE, {"a": changed(turned, "current_turn", lambda v: turned["command_turn"].copy())}))
    assert found.channel == "current_turn"
    assert "it is a copy of what was asked for (command_turn)" in found.said


def test_a_copy_a_row_late_is_one_with_a_missing_row_too(turned: Recording) -> None:
    asked = during(500, 501, lambda v: np.nan)(late(1)(turned["command_turn"]))
    found = only(faults(TURNTABLE, {"a": changed(turned, "current_turn", lambda v: asked)}))
    assert "it is a copy of what was asked for (command_turn)" in found.said


def test_another_axis_encoder_is_a_copy_though_both_lie_on_a_lattice() -> None:
    step = next(each.resolution for each in CARM.plant.encoders if each.channel == "position_roll")
    turning = step * np.round(0.2 * np.sin(2.0 * np.pi * 0.3 * TIME_s) / step)
    channels = {"time": Channel("s", TIME_s), **{f"position_{axis}": Channel("rad", turning) for axis in CARM.axes}}
    found = only(faults(CARM, {"a": Recording(channels, recording_metadata(CARM))}))
    assert found.said.startswith("a: position_roll has the numbers of position_propeller")


def test_every_n_th_row_of_a_lively_command_is_too_slow(turned: Recording) -> None:
    shaken = changed(turned, "command_turn", lambda v: v + 3.0 * v.std() * np.random.default_rng(5).normal(size=ROWS))
    found = only(faults(TURNTABLE, {"a": shaken.part(slice(None, None, 10))}))
    assert found.is_lack
    assert "one row in 10 of turntable's" in found.said


def test_a_recording_of_another_machine_is_refused(driven: Recording) -> None:
    with pytest.raises(RecordingError, match=r"a: no measured channel of turntable; position_turn, .*another machine's file"):
        faults(TURNTABLE, {"a": driven})


def test_the_command_says_it_before_anything_else(turned: Recording, tmp_path: Path, isocenter: Isocenter) -> None:
    write_recording(changed(turned, "position_turn", np.degrees), tmp_path / "a.csv")
    write_recording(changed(turned, "position_turn", during(0, 1000, lambda v: np.nan)), tmp_path / "b.csv")
    for name, verdict, said in (
        ("a", "misconfigured", "a: position_turn is in degrees"),
        ("b", "inconclusive", "b: position_turn is missing"),
    ):
        done = isocenter("diagnose", "turntable", tmp_path / f"{name}.csv", "-o", tmp_path / name)
        assert done.status == 1
        document = json.loads((tmp_path / name / "diagnosis.json").read_text())
        assert document["verdict"] == verdict
        assert said in document["reason"]
        assert document["findings"] == []
        assert [each["channel"] for each in document["audit"]["recordings"]] == ["position_turn"]
        assert (tmp_path / name / "report.html").exists()
        assert isocenter("diagnose", "turntable", tmp_path / f"{name}.csv", "-o", tmp_path / name, "--stop-after", "seen").status == 1
