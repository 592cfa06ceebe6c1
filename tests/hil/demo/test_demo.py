"""The demo: what a seed hides, what an answer to it is worth, and the whole story."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
import scipy.stats
from command_line import Isocenter

from drivers.errors import DriverError
from hil.demo.hidden import LIMITS, TIMES, Envelope, drawn, stronger
from hil.demo.judged import judged
from hil.demo.recorded import TOLERANCE, answered_by, demo_machine, recorded
from hil.diagnosis.result import Diagnosis, EffectAt, Finding, Verdict
from hil.diagnosis.retuning.numbers import TUNED
from hil.machine import Machine
from hil.machine.effects_file import read_effects_file
from hil.terminal.progress import progress
from virtual_bus.effects.registry import effects
from virtual_bus.plant.parameters import plant_parameters
from virtual_bus.settings import EffectSetting

DRAWS = 1500


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return demo_machine(tmp_path_factory.mktemp("demo"))


def hidden(*names: tuple[str, str]) -> tuple[EffectSetting, ...]:
    return tuple(EffectSetting(name, at, {}) for name, at in names)


def answer(verdict: Verdict, *names: tuple[str, str], instead: tuple[tuple[str, str], ...] = ()) -> Diagnosis:
    others = (tuple(EffectAt(*one) for one in instead),) if instead else ()
    findings = tuple(Finding(EffectAt(*one), 0.5, {}, ambiguous_sets=others) for one in names)
    return Diagnosis(verdict=verdict, reason="", findings=findings, noise="repeats", seconds=0.0)


def test_every_number_that_a_diagnosis_retunes_is_known_to_one_percent(machine: Machine) -> None:
    known = {one.name: one for one in plant_parameters(machine.plant) if one.value != 0.0 and one.quantity.startswith(TUNED)}
    assert len(known) > 60
    for one in known.values():
        assert one.tolerance == pytest.approx(TOLERANCE * abs(one.value), rel=1e-5), one.name


def test_a_seed_draws_evenly_and_within_the_strengths_that_it_says(machine: Machine) -> None:
    limits = {(one.name, one.at): one for one in read_effects_file(LIMITS, machine)}
    seen: Counter[tuple[str, str]] = Counter()
    counts: Counter[int] = Counter()
    for seed in range(DRAWS):
        envelope = drawn(machine, seed)
        counts[len(envelope.effects)] += 1
        for one, times in zip(envelope.effects, envelope.times, strict=True):
            seen[one.name, one.at] += 1
            assert TIMES[0] <= times <= TIMES[1]
            for parameter in effects()[one.name].parameters:
                value, least = one.parameters[parameter.name], limits[one.name, one.at].parameters[parameter.name]
                if parameter.is_strength:
                    assert value - parameter.neutral == pytest.approx(times * (least - parameter.neutral), rel=1e-9, abs=1e-30)
                else:
                    assert value == least
    assert set(counts) == {1, 2}
    assert abs(counts[1] - counts[2]) < 5.0 * DRAWS**0.5
    even = [key for key, one in limits.items() if stronger(one, TIMES[1]) is not None]
    assert len(even) > 0.9 * len(limits)
    expected = sum(seen[key] for key in even) / len(even)
    squares = sum((seen[key] - expected) ** 2 for key in even) / expected
    assert scipy.stats.chi2.cdf(squares, len(even) - 1) < 0.999, "as even as counts are"


def test_the_seal_is_of_what_the_envelope_holds(machine: Machine) -> None:
    envelope = drawn(machine, 7)
    assert hashlib.sha256(envelope.text.encode()).hexdigest() == envelope.seal == drawn(machine, 7).seal
    assert envelope.seal not in {drawn(machine, 8).seal, replace(envelope, times=tuple(2.0 * each for each in envelope.times)).seal}
    assert json.loads(envelope.text)["hidden"][0]["effect"] == envelope.effects[0].name


def test_what_an_answer_is_worth() -> None:
    rubs, other_law = ("coulomb_friction", "roll"), ("stribeck_friction", "roll")
    elsewhere, bends = ("coulomb_friction", "propeller"), ("joint_compliance", "detector")
    both = hidden(rubs, bends)
    assert judged(answer("explained", rubs), hidden(rubs)).worth == "right"
    assert judged(answer("explained", rubs), hidden(other_law)).worth == "right", "laws of a family at one place"
    assert judged(answer("ambiguous", rubs, instead=(bends,)), hidden(rubs)).worth == "right"
    assert judged(answer("ambiguous", rubs, instead=(bends,)), hidden(bends)).worth == "listed"
    assert judged(answer("explained", rubs, instead=(bends,)), hidden(bends)).worth == "wrong", "it was not called ambiguous"
    assert judged(answer("explained", elsewhere), hidden(rubs)).worth == "wrong"
    assert judged(answer("explained", rubs, bends), hidden(rubs)).worth == "wrong", "one effect too many"
    assert judged(answer("explained", rubs, bends), both).worth == "right"
    assert judged(answer("explained", rubs), both).worth == "in part"
    assert judged(answer("consistent"), both).worth == "silent"
    assert judged(answer("unknown_physics", rubs), hidden(rubs)).worth == "wrong", "it says that nothing known explains the recordings"


def test_an_answer_is_told_in_a_sentence() -> None:
    rubs, bends = ("coulomb_friction", "roll"), ("joint_compliance", "detector")
    assert judged(answer("explained", rubs), hidden(rubs, bends)).sentence == (
        "Half of it: the tool named coulomb friction at roll; coulomb friction at roll and joint compliance at detector were hidden"
    )
    assert judged(answer("ambiguous", rubs), hidden(("stribeck_friction", "roll"))).sentence == (
        "Right: from the machine file and the recordings, the tool named coulomb friction at roll, and called it ambiguous;"
        " stribeck friction at roll was hidden, of the same family"
    )


def test_a_folder_in_use_is_left_as_it_is_and_a_new_one_is_taken(
    isocenter: Isocenter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise DriverError("roll: moved the wrong way")

    monkeypatch.setattr("hil.demo.story.recorded", refused)
    out = tmp_path / "demo"
    out.mkdir()
    (out / "envelope.sha256").write_text("of an earlier one")
    for name in ("envelope.json", "index.html", "mine.mf4"):
        (out / name).write_text("old")
    told = isocenter("demo", "--seed", "3", "-o", out)
    assert told.status == 1
    assert "seed 3: the bench does not record what it hides; another --seed hides something else: roll: moved the wrong way" in told.err
    assert f"{out} holds files already, which stay as they are: all of this goes to {out}-2" in told.out
    assert {path.name: path.read_text() for path in out.iterdir()} == {
        "envelope.sha256": "of an earlier one",
        **dict.fromkeys(("envelope.json", "index.html", "mine.mf4"), "old"),
    }
    assert sorted(path.name for path in (tmp_path / "demo-2").iterdir()) == ["envelope.sha256", "machine.toml"]
    assert (tmp_path / "demo-2" / "envelope.sha256").read_text() != "of an earlier one"


@pytest.mark.nightly
def test_a_rival_that_laws_wrong_by_one_percent_do_not_tell_apart_is_said(machine: Machine, tmp_path: Path) -> None:
    slow = EffectSetting("imu_bandwidth", "imu", {"fc": 37.25568, "shape": 0.0})
    print("seed 1")
    with progress() as bars:
        paths, _ = recorded(machine, Envelope(1, (slow,), (4.85,)), tmp_path, bars)
        diagnosis = answered_by(machine, paths, bars).diagnosis
    assert diagnosis.verdict == "ambiguous", "a delay of the IMU fits as well but for a ten thousandth"
    assert judged(diagnosis, (slow,)).worth in {"right", "listed"}


@pytest.mark.nightly
def test_the_demo_names_what_it_has_hidden_and_opens_the_envelope(isocenter: Isocenter, tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    told = isocenter("demo", "--seed", "2", "--out", folder, "--json", "-")
    assert told.status == 0, told.err
    document = json.loads(told.out)
    assert document["worth"] == "right"
    assert hashlib.sha256((folder / "envelope.json").read_bytes()).hexdigest() == document["seal"]
    said = told.err
    assert said.index(document["seal"]) < said.index("recorded") < said.index("blind") < said.index("the envelope is open"), said
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert "EMULATED" in page
    assert page.count("<figure") == 2
    assert page.index("Right: ") < page.index("What was in the envelope") < page.index(document["seal"])
    held = document["held_out"]
    assert held["extended"] == pytest.approx(1.0, abs=0.25), "noise alone, encoders' steps among it"
    assert len(document["recordings"]) == 4
    assert (folder / "diagnosis" / "report.html").exists()
