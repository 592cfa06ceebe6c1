"""Whatever ran on the emulator says so: on the terminal, in the recording, and in what is made of the recording."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Isocenter

from hil.identification import read_frf
from hil.recording import read_recording

STILL = ("static", "-m", "carm", "--seconds", "0.5")


def test_run_has_no_bus_but_the_one_it_is_given(isocenter: Isocenter, tmp_path: Path) -> None:
    for words in (("run", *STILL, "-o", tmp_path / "x.mf4"), ("home", "-m", "carm"), ("move", "-m", "carm", "--to", "roll=1")):
        refused = isocenter(*words)
        assert refused.status == 2
        assert "--bus lockstep:" in refused.line
        assert "--bus socketcan:can0" in refused.line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["mf4", "csv"])
def test_what_ran_on_the_emulator_says_so(isocenter: Isocenter, tmp_path: Path, suffix: str) -> None:
    path, simulated = tmp_path / f"run.{suffix}", tmp_path / f"sim.{suffix}"
    ran = isocenter("run", *STILL, "-b", "lockstep:", "-o", path, "--json", tmp_path / "run.json")
    assert ran.status == 0, ran.err
    assert "EMULATED: carm on lockstep:" in ran.out
    assert json.loads((tmp_path / "run.json").read_text())["emulated"] is True
    recording = read_recording(path)
    assert recording.metadata["emulated"] is True
    assert recording.emulated
    made = isocenter("simulate", "carm", path, "-o", simulated)
    assert f"EMULATED: run.{suffix} was made on the emulator" in made.out
    assert not read_recording(simulated).emulated  # it is a simulation, of which nobody thinks otherwise
    compared = isocenter("compare", path, simulated)
    assert compared.out.startswith("The simulation agrees with the recording")
    assert f"EMULATED: run.{suffix} was made on the emulator" in compared.out


@pytest.mark.slow
def test_a_response_of_the_emulator_says_so_wherever_it_goes(isocenter: Isocenter, tmp_path: Path) -> None:
    experiment = ("--jog", "0", "--axes", "roll", "--period", "2", "--periods", "2", "--band", "1:40", "--every-line")
    run = isocenter("run", "multisine", "-m", "carm", "-b", "lockstep:", *experiment, "-o", tmp_path / "ms.mf4")
    assert run.status == 0, run.err
    identified = isocenter("identify", tmp_path / "ms.mf4", "-o", tmp_path / "roll.frf.npz", "--json", tmp_path / "answer.json")
    assert identified.status == 0, identified.err
    assert "EMULATED: ms.mf4 was made on the emulator" in identified.out
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert answer["emulated"] is True
    assert read_frf(tmp_path / "roll.frf.npz").emulated
    assert answer["modes"] or answer["no_modes"]
