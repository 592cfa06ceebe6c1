"""What `isocenter diagnose` refuses before it computes anything."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Never

import pytest
from carriage import repeats

from hil.cli.app import main
from hil.recording import write_recording


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same names on two days."""
    monkeypatch.chdir(tmp_path)
    for seed, day in enumerate(("monday", "tuesday")):
        (tmp_path / day).mkdir()
        for name, recording in repeats(2, duration_s=0.1, seed=seed).items():
            write_recording(recording, tmp_path / day / f"{name}.csv")
    shutil.copytree("monday", "copies")
    (tmp_path / "file").touch()
    return tmp_path


REPEATS = ("monday/run_0_0.csv", "monday/run_0_1.csv")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("monday", "-o", "answer"), "monday: is a folder; give the recordings in it"),
        ((*REPEATS, "-o", "file"), "file: is a file; give a folder"),
        ((*REPEATS, "--held-out", "-o", "answer"), "--held-out: give a recording or more after it"),
        ((*REPEATS, "-o", "answer", "--held-out"), "--held-out: give a recording or more after it"),
        ((*REPEATS, "-o", "file/answer"), "file: is a file; give a folder"),
        ((*REPEATS, "-o", "answer", "--json", "nowhere/a.json"), "--json nowhere/a.json: there is no folder nowhere"),
        ((*REPEATS, "-o", "answer", "--json", "monday"), "--json monday: is a folder; give a file in it"),
        ((*REPEATS, "-o", "answer", "--json", "file/a.json"), "--json file/a.json: there is no folder file"),
        ((*REPEATS, "--held-out", "monday/../monday/run_0_1.csv", "-o", "answer"), "is given to fit to and as --held-out"),
        ((*REPEATS, "tuesday/../monday/run_0_0.csv", "-o", "answer"), "monday/run_0_0.csv: is given twice"),
        ((*REPEATS, "--held-out", "copies/run_0_1.csv", "-o", "answer"), "copies/run_0_1.csv: holds the same rows as run_0_1"),
        ((*REPEATS, "copies/run_0_1.csv", "-o", "answer"), "copies/run_0_1.csv: holds the same rows as run_0_1; give each"),
        ((*REPEATS, "--held-out=tuesday/run_0_0.csv", "copies/run_0_1.csv", "-o", "answer"), "run_0_1, which is fitted to; hold out"),
        ((*REPEATS, "--held-out", "tuesday/run_0_0.csv", "--held-out", "tuesday/run_0_0.csv", "-o", "answer"), "is given twice"),
    ],
)
def test_recordings_given_twice_and_places_that_cannot_be_written_to_are_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str
) -> None:
    monkeypatch.setattr("hil.diagnosis.diagnose.residuals_of", lambda *_, **__: pytest.fail("it computed"))
    with pytest.raises(SystemExit) as left:
        main(["diagnose", "emps", *words])
    assert left.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert said in line


@pytest.mark.parametrize("words", [("-o", "answer"), ("-o", "new/folder/answer"), ("-o", "monday", "--json", "a.json")])
def test_a_place_where_nothing_may_be_written_is_refused_before_the_computation(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    def refuse(dir: Path) -> Never:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)  # who runs the tests may be allowed everything
    monkeypatch.setattr("hil.diagnosis.diagnose.residuals_of", lambda *_, **__: pytest.fail("it computed"))
    with pytest.raises(SystemExit) as left:
        main(["diagnose", "emps", *REPEATS, *words])
    assert left.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert words[-1] in line
    assert "Permission denied" in line
    assert not (folder / "new").exists()
    assert not (folder / "a.json").exists()


def test_a_recording_of_another_machine_is_refused_by_its_machine_and_axes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["diagnose", "carm", *REPEATS, "-o", "answer"])
    assert left.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "monday/run_0_0.csv: recorded of emps with axes carriage; carm has propeller, roll" in line


@pytest.mark.nightly
def test_another_day_s_recording_of_the_same_name_may_be_held_out(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as left:
        main(["diagnose", "emps", *REPEATS, "--held-out", "tuesday/run_0_0.csv", "-o", "answer"])
    assert left.value.code == 0
    assert (tmp_path / "answer" / "diagnosis.json").exists()


def test_the_experiment_of_an_earlier_answer_in_the_same_folder_is_removed(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "answer").mkdir()
    (tmp_path / "answer" / "next_experiment.toml").write_text("of an ambiguous verdict")
    with pytest.raises(SystemExit) as left:
        main(["diagnose", "emps", *REPEATS, "-o", "answer"])
    assert left.value.code == 0
    names = {path.name for path in (tmp_path / "answer").iterdir()}
    assert names >= {"diagnosis.json", "effects.toml", "machine.toml"}
    assert "next_experiment.toml" not in names
