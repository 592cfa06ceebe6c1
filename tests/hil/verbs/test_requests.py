"""What does not go together is told in the words of whoever asks; an answer's JSON has the keys that its page lists."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from command_line import runner

import hil
from docs.generate.answer_types import entries
from hil.errors import RequestError
from hil.machine import Finding
from hil.terminal.output import plain
from hil.verbs import observe
from hil.verbs.check import CheckAnswer
from hil.verbs.verb import KEPT
from virtual_bus.linear.left_out import LeftOut


def test_python_calls_parts_by_their_names_and_a_command_by_its_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    carm = hil.open_machine("carm")
    nothing = hil.Recording({"time": hil.Channel("s", np.arange(3.0))}, {})
    with pytest.raises(RequestError, match=r"^design: a design is ready; responses, multisines, standing, sweeps and tuned_on make"):
        observe.answer(observe.ObserveRequest(carm, nothing, design=tmp_path / "a.npz", tuned_on=[nothing]))
    told = runner(capsys)("observe", "carm", "b.mf4", "-o", tmp_path / "x.npz", "--design", "a.npz", "--tune", "c.mf4")
    assert told.status == 2
    assert "--design: a design is ready; --frf, --multisine, --standing, --sweep and --tune make a new one (see " in told.line


def test_what_is_exposed_is_refused_in_both_faces_by_the_same_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    carm = hil.open_machine("carm")
    with pytest.raises(RequestError, match=r"^rate_Hz 0: must be a positive number$"):
        hil.expose(carm, hil.Recording({"time": hil.Channel("s", np.arange(3.0))}, {}), tmp_path / "t.csv", tmp_path, rate_Hz=0.0)
    told = runner(capsys)("expose", "carm", "b.mf4", "--truth", "t.csv", "-o", tmp_path / "x", "--width=-2")
    assert (told.status, told.line) == (2, "isocenter: --width -2: must be a positive number")


def test_an_axis_that_is_not_there_is_told_by_its_part() -> None:
    with pytest.raises(RequestError, match=r"^schedule yaw: carm has propeller, roll$"):
        hil.shape(hil.open_machine("carm"), "roll", schedule="yaw")


def test_an_answer_s_json_has_the_keys_that_are_listed_and_nothing_that_is_kept() -> None:
    finding = Finding("mode", True, "4 Hz", {"frequency_Hz": np.array([4.0, np.nan])})
    document = plain(CheckAnswer("carm", True, (finding,), (LeftOut("backlash", "roll", "it jumps"),)))
    assert isinstance(document, dict)
    listed = [each.name for each in entries(CheckAnswer)]
    assert list(document) == [name for name in listed if "." not in name]
    assert [f"findings[].{name}" for name in document["findings"][0]] == [name for name in listed if name.startswith("findings[].")]
    assert document["findings"][0]["values"] == {"frequency_Hz": [4.0, None]}

    @dataclasses.dataclass(frozen=True)
    class Told:
        rows: int
        values: np.ndarray = dataclasses.field(metadata=KEPT)

    assert plain(Told(3, np.zeros(3))) == {"rows": 3}
