"""Two encoders of one axis: play is told from a shaft that winds up, from a scale and from a delay."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Isocenter

from hil.diagnosis.audit.sensors import SensorAudit, audit_sensors
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata, write_recording

MACHINE = load_machine("turntable")
TIME_s = np.arange(2000) / 200.0
POSITION_rad = 0.2 * np.sin(2.0 * np.pi * 0.3 * TIME_s) + 0.03 * np.sin(2.0 * np.pi * 1.1 * TIME_s)
GAP_rad = 2e-3


def recording(link: np.ndarray, effort: np.ndarray) -> Recording:
    channels = {
        "time": Channel("s", TIME_s),
        "current_turn": Channel("A", effort),
        "position_turn": Channel("rad", POSITION_rad),
        "link_position_turn": Channel("rad", link),
    }
    return Recording(channels, recording_metadata(MACHINE))


def audited(link: np.ndarray, effort: np.ndarray) -> SensorAudit:
    (found,) = audit_sensors(MACHINE, [recording(link, effort)])
    return found


def played(gap: float) -> np.ndarray:
    """The load that two teeth push, one at a time: a play operator by its own recursion."""
    link = np.zeros(len(POSITION_rad))
    for k in range(1, len(link)):
        link[k] = min(max(link[k - 1], POSITION_rad[k] - 0.5 * gap), POSITION_rad[k] + 0.5 * gap)
    return link


def friction() -> np.ndarray:
    return 0.5 * np.sign(np.gradient(POSITION_rad)) + 2.0 * np.gradient(np.gradient(POSITION_rad))


@pytest.mark.parametrize("gap", [GAP_rad, 5.0 * GAP_rad])
def test_play_is_found_with_its_size(gap: float) -> None:
    found = audited(played(gap), friction())
    assert found.status == "differs"
    assert found.gap == pytest.approx(gap, rel=0.03)
    assert "play" in found.said


def test_a_shaft_that_friction_winds_up_has_no_play() -> None:
    """The difference has two sides as play has, but it is in proportion to the effort."""
    found = audited(POSITION_rad - 1e-3 * friction(), friction())
    assert found.gap == 0.0


def test_a_scale_and_a_delay_are_measured() -> None:
    late = np.interp(TIME_s - 0.02, TIME_s, POSITION_rad)
    found = audited(1.01 * late, friction())
    assert found.status == "differs"
    assert found.gap == 0.0
    assert found.gain == pytest.approx(1.01, abs=2e-3)
    assert found.delay_s == pytest.approx(0.02, rel=0.1)


def test_encoders_that_agree_are_as_filed() -> None:
    step = 1e-6
    found = audited(step * np.round(POSITION_rad / step), friction())
    assert found.status == "as_filed"


@pytest.mark.parametrize(
    ("factor", "said"), [(180.0 / np.pi, "link_position_turn is in degrees"), (-1.0, "link_position_turn is of the opposite sign")]
)
def test_another_unit_and_the_other_way_round_are_misconfigured(
    tmp_path: Path, isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch, factor: float, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_recording(recording(factor * POSITION_rad, friction()), tmp_path / "swing.csv")
    done = isocenter("diagnose", "turntable", "swing.csv", "-o", "found", "--stop-after", "audit")
    assert done.status == 1
    assert said in done.out


def test_missing_samples_are_no_difference() -> None:
    link = POSITION_rad.copy()
    holed = recording(link, friction())
    values = POSITION_rad.copy()
    values[700] = np.nan
    channels = {**holed.channels, "position_turn": Channel("rad", values)}
    (found,) = audit_sensors(MACHINE, [Recording(channels, holed.metadata)])
    assert found.status == "as_filed"


def test_the_command_reads_play_off(tmp_path: Path, isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_recording(recording(played(GAP_rad), friction()), tmp_path / "swing.csv")
    done = isocenter("diagnose", "turntable", "swing.csv", "-o", "found")
    assert done.status == 0, done.err
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    assert found["verdict"] == "explained"
    (finding,) = found["findings"]
    assert (finding["effect"], finding["at"]) == ("backlash", "turn")
    low, high = finding["parameters"]["b"]["ci95"]
    assert low - 1e-9 <= 0.5 * GAP_rad <= high + 1e-9
