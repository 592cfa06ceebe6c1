"""A fleet's changes: found where there are, not where there are none, and said in a sentence."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from hil.fleet.change import FleetChange, Parameter, Tracks, fleet_change, fleet_sentence, read_tracks, sentence, trend_of
from hil.fleet.change.sentences import common_sentences
from hil.fleet.change.threshold import crossing_rates, step_rate
from hil.fleet.pages import write_fleet_pages

MACHINES, NIGHTS = 24, 60
FIRST = np.datetime64("2026-01-01")
FRICTION = Parameter("friction", "jog", "roll coulomb_friction level", "Nm")
VISCOUS = Parameter("friction", "jog", "roll viscous_friction level", "Nm s/rad")
SCATTER_Nm = 0.1
COVARIANCE = SCATTER_Nm**2 * np.array([[1.0, -0.9], [-0.9, 1.0]])
"""What a jog leaves of dry and viscous friction: at one speed only their sum is known."""


def fleet(seed: int = 1, nights: int = NIGHTS, machines: int = MACHINES, season_Nm: float = 0.6) -> Tracks:
    """Sound machines: levels of their own, correlated noise, a season that each follows in its own measure."""
    random = np.random.default_rng(seed)
    noise = random.standard_normal((machines, nights, 2)) @ np.linalg.cholesky(COVARIANCE).T
    season = season_Nm * np.sin(2.0 * np.pi * np.arange(nights) / 365.0)
    values = 6.0 + 0.5 * random.standard_normal((machines, 1, 2)) + noise
    values += season[None, :, None] * (1.0 + 0.3 * random.standard_normal((machines, 1, 2)))
    covariances = np.broadcast_to(COVARIANCE, (machines, nights, 2, 2)).copy()
    names = [f"room_{number}" for number in range(machines)]
    return Tracks(names, FIRST + np.arange(nights), [FRICTION, VISCOUS], values, covariances, np.zeros((machines, nights, 2), dtype=int))


def changed() -> Tracks:
    """Room 3's dry friction grows by 2.3 Nm from night 20 on; room 7's viscous friction steps on night 30."""
    tracks = fleet()
    tracks.values[3, :, 0] += 0.0575 * np.maximum(np.arange(NIGHTS) - 20, 0)
    tracks.values[7, 30:, 1] -= 0.5
    return tracks


@pytest.fixture(scope="module")
def found() -> FleetChange:
    return fleet_change(changed())


def test_a_growth_and_a_step_are_named_with_their_machine_parameter_and_beginning(found: FleetChange) -> None:
    by_machine = {change.machine: change for change in found.changes}
    assert sorted(by_machine) == ["room_3", "room_7"]
    grows, steps = by_machine["room_3"], by_machine["room_7"]
    assert (grows.parameter, grows.kind, steps.parameter, steps.kind) == (FRICTION, "growth", VISCOUS, "step")
    assert steps.since == FIRST + 30
    assert abs((grows.since - (FIRST + 21)).astype(int)) <= 3
    assert steps.now - steps.before == pytest.approx(-0.5, abs=4.0 * steps.deviation)
    assert FIRST + 30 < steps.alarm <= FIRST + 40


def test_it_is_said_in_a_sentence(found: FleetChange) -> None:
    (step,) = [change for change in found.changes if change.kind == "step"]
    said = sentence(step, MACHINES - 1)
    assert said.startswith("room_7: roll viscous_friction level dropped from ")
    assert " Nm s/rad on 2026-01-31, " in said
    assert said.endswith(" sigma; the other 23 machines did not")
    assert fleet_sentence(found) == "2 of 24 machines need a visit: room_3, room_7"


def test_a_night_is_judged_by_what_was_known_then(found: FleetChange) -> None:
    last = max(change.alarm for change in found.changes)
    night = int((last - FIRST).astype(int))
    tracks = changed()
    assert {change.machine for change in fleet_change(tracks.until(night + 1)).changes} == {"room_3", "room_7"}
    assert last not in {change.alarm for change in fleet_change(tracks.until(night)).changes}


def test_a_sound_fleet_with_a_season_and_bad_nights_needs_no_visit() -> None:
    tracks = fleet(2, 150)
    tracks.values[5, [40, 41, 80]] += 30.0
    tracks.values[6, 60] = np.nan
    answer = fleet_change(tracks)
    assert answer.changes == ()
    assert any("roll coulomb_friction level" in line for line in common_sentences(answer))


def test_what_shifts_everyone_is_no_machines_own() -> None:
    tracks = fleet(3)
    tracks.values[:, 35:] -= 1.0
    tracks.builds[:, 35:, 0] = 1
    assert fleet_change(tracks).changes == ()


def test_another_build_of_one_machine_is_not_its_change() -> None:
    tracks = fleet(4)
    tracks.values[2, 35:] -= 1.0
    assert [change.machine for change in fleet_change(tracks).changes] == ["room_2"]
    tracks.builds[2, 35:, 1] = 1
    assert fleet_change(tracks).changes == ()


def test_the_covariance_shows_what_scatter_would_hide() -> None:
    tracks = fleet(5, season_Nm=0.0)
    tracks.values[4, 30:, 0] += 0.13
    assert [change.machine for change in fleet_change(tracks).changes] == ["room_4"]
    random = np.random.default_rng(6)
    for machine in range(MACHINES):  # the same scatter without the correlation
        tracks.values[machine, :, 1] = tracks.values[machine, random.permutation(NIGHTS), 1]
    assert fleet_change(tracks).changes == ()


def test_few_machines_and_few_nights_are_said() -> None:
    few = fleet_change(fleet(7, 20, 3))
    assert "fewer than 8" in few.notes[0]
    early = fleet_change(fleet(8, 10))
    assert early.changes == ()
    assert fleet_sentence(early) == "too few nights to say: 10"


def test_evidence_of_sound_tracks_goes_as_far_as_theory_says() -> None:
    """Siegmund and Venkatraman's rate is for steps from a known level; levels here are learned, and growth is tried too."""
    levels = np.array([3.5, 4.0])
    drawn = crossing_rates(levels, 0.0, 1000, 5)
    theory = np.array([365.0 * step_rate(h, max(1.0, (h / 2.5) ** 2), 365.0) for h in levels])
    assert np.all(drawn < 1.5 * theory)
    assert np.all(drawn > theory / 3.0)


def test_a_trend_has_the_covariance_of_a_straight_line() -> None:
    answer = fleet_change(fleet(9, season_Nm=0.0))
    assert answer.model is not None
    nothing = np.zeros(2)
    exact = dataclasses.replace(answer, model=dataclasses.replace(answer.model, white=nothing, carried=nothing))
    trend = trend_of(exact, "room_1")
    days = np.arange(NIGHTS) - np.arange(NIGHTS).mean()
    expected = np.kron(np.diag([1.0 / NIGHTS, 1.0 / (days @ days)]), COVARIANCE)
    np.testing.assert_allclose(trend.covariance, expected, rtol=0.02, atol=1e-8)
    assert np.all(np.abs(trend.shrunk_slope) <= np.abs(trend.slope))


def write_store(store: Path, tracks: Tracks) -> None:
    """Write tracks as `isocenter fleet` lays results out."""
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    for m, machine in enumerate(tracks.machines):
        for t, night in enumerate(tracks.nights):
            folder = store / "results" / f"machine={machine}" / f"date={night}"
            folder.mkdir(parents=True)
            rows = [
                {
                    "machine": machine,
                    "night": night.astype("datetime64[us]").item(),
                    "task": parameter.task,
                    "experiment": parameter.experiment,
                    "quantity": parameter.quantity,
                    "value": float(tracks.values[m, t, j]),
                    "standard_deviation": float(np.sqrt(tracks.covariances[m, t, j, j])),
                    "unit": parameter.unit,
                    "covariance_group": "jog",
                    "covariance": tracks.covariances[m, t, j].tolist(),
                    "covariance_index": j,
                    "software_version": "1",
                    "machine_file_hash": "a",
                }
                for j, parameter in enumerate(tracks.parameters)
            ]
            parquet.write_table(pyarrow.Table.from_pylist(rows), folder / "friction-1.parquet")


def small() -> Tracks:
    tracks = fleet(10, 40, 8)
    tracks.values[3, 20:, 0] += 1.0
    return tracks


def test_a_store_is_read_as_it_was_written(tmp_path: Path) -> None:
    pytest.importorskip("duckdb")
    tracks = small()
    write_store(tmp_path, tracks)
    read = read_tracks(tmp_path)
    assert (list(read.machines), list(read.parameters)) == (list(tracks.machines), list(tracks.parameters))
    np.testing.assert_array_equal(read.values, tracks.values)
    np.testing.assert_allclose(read.covariances, tracks.covariances)
    np.testing.assert_array_equal(read.nights, tracks.nights)


def test_the_command_says_who_needs_a_visit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("duckdb")
    from hil.cli import main

    write_store(tmp_path, small())
    with pytest.raises(SystemExit) as left:
        main(["fleet", "change", str(tmp_path), "--json", str(tmp_path / "change.json")])
    assert left.value.code == 1
    assert "1 of 8 machines needs a visit: room_3" in capsys.readouterr().out
    (change,) = json.loads((tmp_path / "change.json").read_text())["changes"]
    assert (change["machine"], change["quantity"], change["kind"]) == ("room_3", FRICTION.quantity, "step")


def test_no_results_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("duckdb")
    from hil.cli import main

    with pytest.raises(SystemExit) as left:
        main(["fleet", "change", str(tmp_path)])
    assert left.value.code == 2
    assert "isocenter fleet run makes them" in capsys.readouterr().err


def test_pages_name_the_machine_on_top(tmp_path: Path) -> None:
    answer = fleet_change(small())
    page = write_fleet_pages(answer, "store", tmp_path)
    assert "1 of 8 machines needs a visit: room_3" in page.read_text()
    machine = (tmp_path / "machine-room_3.html").read_text()
    assert "room_3 needs a visit: roll coulomb_friction level jumped up" in machine
    assert "room_4 did not change." in (tmp_path / "machine-room_4.html").read_text()
    parameter = (tmp_path / "parameter-friction-jog-roll-coulomb_friction-level.html").read_text()
    assert "changed on 1 of 8 machines" in parameter
