"""isocenter plot: a page of recordings with their simulation over them and beneath what it leaves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM
from command_line import Isocenter

from hil.recording import Channel, Recording, read_recording, write_recording
from hil.recording.metadata import recording_metadata
from hil.reports.plot import Plotted, charts_of, plot_page
from hil.simulation import simulate

PUSHED_A = 0.25


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the arm whose roll current is off by a quarter of an ampere from what its machine file says."""
    time = np.arange(256) / CARM.sample_rate_Hz
    channels = {"time": Channel("s", time)}
    for axis in CARM.axes:
        channels[f"reference_{axis}"] = Channel("rad", np.zeros(time.size))
        channels[f"excitation_{axis}"] = Channel("A", 0.5 * np.sin(30.0 * time))
    metadata = recording_metadata(CARM, experiment={"start_pose": [0.0, float(np.radians(30.0))]})
    driven = simulate(CARM, Recording(channels, metadata))
    pushed = Channel("A", driven["current_roll"] + PUSHED_A)
    path = tmp_path_factory.mktemp("recorded") / "run.mf4"
    write_recording(Recording({**driven.channels, "current_roll": pushed}, metadata), path)
    return path


def test_the_simulation_is_that_of_isocenter_simulate_and_the_residual_what_it_leaves(
    isocenter: Isocenter, recorded: Path, tmp_path: Path
) -> None:
    assert isocenter("simulate", "carm", recorded, "-o", tmp_path / "sim.mf4").status == 0
    recording = read_recording(recorded)
    own = simulate(CARM, recording)
    assert np.array_equal(own["current_roll"], read_recording(tmp_path / "sim.mf4")["current_roll"])
    ((chart, residual),) = charts_of([Plotted(recorded, recording, own)], ["current_roll"])
    assert [one.label for one in chart.series] == ["recorded", "simulated"]
    assert np.allclose(residual.series[0].y, PUSHED_A, atol=1e-9)
    assert chart.group == residual.group != ""
    assert chart.pose == "propeller 0°, roll 30°"
    assert chart.y.label == "current_roll [A]"


def test_the_page_names_the_channel_that_the_simulation_misses_and_what_to_do_next(
    isocenter: Isocenter, recorded: Path, tmp_path: Path
) -> None:
    done = isocenter("plot", recorded, "--simulate", "-o", tmp_path / "run.html", "--png", tmp_path / "run.png", "--json", "-")
    assert done.status == 0, done.err
    answer = json.loads(done.out)
    page = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert "most in current_roll, by 0.25 A rms" in answer["verdict"]
    assert page.index(answer["verdict"]) < page.index("<h2>")
    assert answer["emulated"] is False
    assert f"isocenter diagnose carm {recorded}" in page
    assert CARM.hash[:12] in page
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")


def test_a_simulation_that_agrees_asks_for_nothing(recorded: Path) -> None:
    recording = read_recording(recorded)
    page = plot_page([Plotted(recorded, recording, recording)], ["current_roll"])
    assert (page.verdict.kind, page.next_command) == ("good", "")


def test_channels_are_chosen_by_name_or_pattern(isocenter: Isocenter, recorded: Path, tmp_path: Path) -> None:
    done = isocenter("plot", recorded, "--channels", "current_*, imu_x", "-o", tmp_path / "run.html", "--json", "-")
    assert json.loads(done.out)["channels"] == ["current_propeller", "current_roll", "imu_x"]
    refused = isocenter("plot", recorded, "--channels", "curent_*", "-o", tmp_path / "no.html")
    assert refused.status == 2
    assert "curent_*" in refused.line
    assert "current_roll" in refused.line
    assert not (tmp_path / "no.html").exists()


def test_recordings_lie_over_each_other_from_their_first_rows(recorded: Path) -> None:
    first = read_recording(recorded)
    later = Recording({**first.channels, "time": Channel("s", first.time + 1.7e9)}, first.metadata)
    ((chart,),) = charts_of([Plotted(Path("a.mf4"), first), Plotted(Path("b.mf4"), later)], ["current_roll"])
    assert [one.label for one in chart.series] == ["recorded, a", "recorded, b"]
    assert np.allclose(chart.series[0].x, chart.series[1].x, atol=1e-6)
    assert "since the first row" in chart.x.label


def test_what_does_not_change_is_a_number_and_what_is_empty_is_named(recorded: Path) -> None:
    recording = read_recording(recorded)
    more = {"temperature_roll": Channel("degC", np.full(recording.rows, 24.5)), "gyro_x": Channel("rad/s", np.full(recording.rows, np.nan))}
    whole = Recording({**recording.channels, **more}, recording.metadata)
    page = plot_page([Plotted(recorded, whole)], ["current_roll", "temperature_roll", "gyro_x"])
    texts = {section.title: section for section in page.sections}
    assert texts["Channels that do not change"].blocks[0].rows == [("temperature_roll", "24.5 degC")]  # type: ignore[union-attr]
    assert texts["Empty channels"].blocks[0].text == "gyro_x"  # type: ignore[union-attr]


@pytest.mark.parametrize("emulated", [True, False])
def test_what_was_emulated_says_so(recorded: Path, emulated: bool) -> None:
    recording = read_recording(recorded).with_metadata(emulated=emulated)
    assert plot_page([Plotted(recorded, recording)], ["current_roll"]).is_emulated is emulated


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nothere.mf4", "-o", "a.html"), "nothere.mf4"),
        (("RECORDED", "-o", "a.pdf"), ".html"),
        (("RECORDED", "-o", "a.html", "--png", "a.jpeg"), ".png"),
        (("RECORDED", "-o", "a.html", "--effects", "e.toml"), "--simulate"),
    ],
)
def test_what_cannot_be_plotted_is_refused_in_a_line(
    isocenter: Isocenter, recorded: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    refused = isocenter("plot", *(recorded if word == "RECORDED" else word for word in arguments))
    assert refused.status == 2
    assert said in refused.line
    assert list(tmp_path.iterdir()) == []


def test_a_recording_without_its_machine_is_not_simulated(isocenter: Isocenter, recorded: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.csv"
    write_recording(Recording(read_recording(recorded).channels, {}), bare)
    bare.with_suffix(".toml").unlink(missing_ok=True)
    refused = isocenter("plot", bare, "--simulate", "-o", tmp_path / "run.html")
    assert refused.status == 2
    assert "--machine" in refused.line
