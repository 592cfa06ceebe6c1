"""Effects files: physics by name, checked against the catalogue and the machine."""

from __future__ import annotations

from pathlib import Path

import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import answer_or_refusal

from hil.errors import MachineFileError
from hil.machine import load_machine
from hil.machine.effects_file import effects_from_text, effects_text, read_effects_file, write_effects_file
from virtual_bus.settings import EffectSetting

CARM = load_machine("carm")
EMPS = load_machine("emps")
FRICTION = '[[effect]]\nname = "coulomb_friction"\nat = "roll"\nFc_Nm = 12.0\n'


def test_an_effect_is_bound_to_its_axis_with_its_parameters_in_si() -> None:
    assert effects_from_text(FRICTION, CARM, "f.toml") == (EffectSetting("coulomb_friction", "roll", {"Fc": 12.0}),)


def test_a_prismatic_axis_takes_forces() -> None:
    text = FRICTION.replace("roll", "carriage").replace("Fc_Nm", "Fc_N")
    assert effects_from_text(text, EMPS, "f.toml")[0].parameters == {"Fc": 12.0}


@given(st.floats(0.0, 1000.0), st.sampled_from(["propeller", "roll"]))
@settings(deadline=None, max_examples=examples(30), derandomize=True)
def test_what_is_written_reads_back(level: float, at: str) -> None:
    effects = (EffectSetting("coulomb_friction", at, {"Fc": level}),)
    assert effects_from_text(effects_text(effects, CARM), CARM, "f.toml") == effects


def test_files_round_trip(tmp_path: Path) -> None:
    effects = effects_from_text(FRICTION, CARM, "f.toml")
    write_effects_file(effects, CARM, tmp_path / "f.toml")
    assert read_effects_file(tmp_path / "f.toml", CARM) == effects


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FRICTION.replace("coulomb", "colomb"), ["colomb_friction", "coulomb_friction"]),
        (FRICTION.replace('"roll"', '"yaw"'), ["yaw", "roll"]),
        (FRICTION.replace("Fc_Nm", "Fc_N"), ["Fc_N", "Fc_Nm"]),
        (FRICTION.replace("12.0", "-1.0"), ["Fc_Nm"]),
        (FRICTION.replace("12.0", "1" + 400 * "0"), ["Fc_Nm"]),
        (FRICTION.replace("12.0", '"much"'), ["Fc_Nm"]),
        (FRICTION + FRICTION, ["given twice"]),
        (FRICTION.replace("[[effect]]", "[[efect]]"), ["efect", "[[effect]]"]),
        ("effect = 3", ["effect", "tables"]),
        ("format = 7\n" + FRICTION, ["format = 7"]),
        (FRICTION.replace("= 12.0", ""), ["no valid TOML", "line 4"]),
    ],
)
def test_a_wrong_effects_file_gets_one_line(text: str, words: list[str]) -> None:
    with pytest.raises(MachineFileError) as caught:
        effects_from_text(text, CARM, "f.toml")
    line = str(caught.value)
    assert line.startswith("f.toml")
    assert "\n" not in line
    for word in words:
        assert word in line


@given(st.text(max_size=60))
@settings(deadline=None, max_examples=examples(100), derandomize=True)
def test_any_text_gives_effects_or_one_line(text: str) -> None:
    effects, refusal = answer_or_refusal(MachineFileError, effects_from_text, text, CARM, "f.toml")
    assert isinstance(effects, tuple) if refusal is None else "\n" not in refusal
