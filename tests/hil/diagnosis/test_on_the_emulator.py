"""On the emulated turntable: a friction hidden in an emulated turntable is named, and where nothing is hidden nothing is."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.cli.app import main
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.result import Diagnosis
from hil.machine import Machine, load_machine
from hil.recording import Recording, read_recording

TABLE = "turntable"
FRICTION = '[[effect]]\nname = "coulomb_friction"\nat = "turn"\nFc_Nm = 0.3\n'


def recorded(path: Path, machine: Machine, *experiment: object) -> Recording:
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in ("run", *experiment, "-m", TABLE, "-b", "lockstep:", "-o", path)])
    assert left.value.code == 0
    return read_recording(path, machine)


def answer(folder: Path, hidden: tuple[object, ...]) -> Diagnosis:
    """Three jogs and a held-out one, as the documentation's commands record them, diagnosed."""
    machine = load_machine(TABLE)
    recordings = {}
    for seed, amplitude, period in ((1, 3.4, 10), (2, 3.4, 10), (3, 3.4, 10), (11, 2.6, 8)):
        jog = ("jog", "--amplitude", amplitude, "--period", period, "--periods", 1, "--seed", seed)
        recordings[str(seed)] = recorded(folder / f"{seed}.mf4", machine, *jog, *hidden)
    held_out = {"11": recordings.pop("11")}
    return diagnose(machine, recordings, held_out).diagnosis


@pytest.mark.nightly
def test_a_hidden_friction_comes_first_with_its_strength(tmp_path: Path) -> None:
    hidden = tmp_path / "hidden.toml"
    hidden.write_text(FRICTION)
    found = answer(tmp_path, ("--effects", hidden))
    assert found.verdict in ("explained", "ambiguous")
    first = found.findings[0]
    assert [(one.effect.effect, one.effect.at) for one in found.findings] == [("coulomb_friction", "turn")]
    low, high = first.parameters["Fc"].ci95
    assert low < 0.3 < high < 0.4
    assert 0.5 < found.fit.held_out.extended < 1.3 < found.fit.held_out.nominal


@pytest.mark.nightly
def test_nothing_is_found_where_nothing_is_hidden(tmp_path: Path) -> None:
    found = answer(tmp_path, ())
    assert found.verdict in ("consistent", "retuned")
    assert 0.5 < found.fit.held_out.nominal < 1.3


@pytest.mark.slow
def test_a_table_that_stands_is_no_spring(tmp_path: Path) -> None:
    """Its encoder's reading never changes, and what the loop does within that count is seen on the link."""
    machine = load_machine(TABLE)
    still = {str(seed): recorded(tmp_path / f"{seed}.mf4", machine, "static", "--seconds", 4, "--seed", seed) for seed in (1, 2)}
    found = diagnose(machine, still).diagnosis
    assert found.verdict == "inconclusive"
    assert "turn does not move" in found.reason
