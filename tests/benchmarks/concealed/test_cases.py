"""Cases are fixed by their seed; the sealed set has the numbers that were asked for; a case shows the tool nothing but recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytestmark = pytest.mark.nightly

if TYPE_CHECKING:
    from concealed.truth.plant import Machine


def test_the_sealed_set_has_its_strata_and_other_seeds_than_development() -> None:
    from concealed.making import seeds, stratum_of

    seed, cases = seeds("sealed")
    counts = {name: sum(stratum_of(number) == name for number in range(cases)) for name in ("null", "single", "pair", "off")}
    assert counts == {"null": 300, "single": 250, "pair": 100, "off": 100}
    assert seed != seeds("development")[0]


@pytest.mark.slow
def test_any_fifteen_cases_hold_every_stratum_and_singles_go_round_the_whole_catalogue(machines: dict[str, Machine]) -> None:
    from concealed.making import stratum_of
    from concealed.truth.catalogue import INSIDE
    from concealed.truth.draw import draw

    singles = [draw(number, 99, machines) for number in range(400) if stratum_of(number) == "single"]
    assert {case.hidden[0].kind.name for case in singles} == set(INSIDE)
    again = draw(31, 99, machines)
    assert again == draw(31, 99, machines) != draw(31, 98, machines)
    assert max(abs(factor - 1.0) for case in singles for factor in case.factors.values()) <= 0.1


@pytest.mark.slow
def test_a_case_shows_recordings_and_the_nominal_machine_only(machines: dict[str, Machine], tmp_path: Path) -> None:
    from concealed.truth.build import make_case
    from concealed.truth.draw import draw

    case = next(
        case
        for number in range(1000)
        if (case := draw(number, 5, machines)).stratum == "single"
        and case.hidden[0].kind.name == "coulomb_friction"
        and (case.machine, case.training.kind) == ("slider", "mixed")
    )
    make_case(case, machines[case.machine], tmp_path / "case", tmp_path / "truth.json")
    names = {path.name for path in (tmp_path / "case").iterdir()}
    runs = {f"run_{i + 1}{ending}" for i in range(case.repeats) for ending in (".csv", ".toml")}
    assert names == runs | {"held_out.csv", "held_out.toml", "machine.toml"}
    assert (tmp_path / "case" / "machine.toml").read_text() == machines[case.machine].text
    assert not any("coulomb" in path.read_text() for path in (tmp_path / "case").iterdir())
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["effects"][0]["accepted"] == ["coulomb_friction"]
    assert truth["detectability"] == pytest.approx(truth["effects"][0]["times_limit"] * 5.0, rel=0.5)
    assert sum(truth["location"]["channels"].values()) == pytest.approx(1.0)
