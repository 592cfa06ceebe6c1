"""The demo's story, told with a shorter experiment."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Isocenter

from hil.experiments import Jog, Multisine


@pytest.mark.slow
def test_the_demo_leaves_a_page_and_finds_the_friction_it_has_hidden(
    isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    experiment = Multisine(
        pose={"roll": 0.5}, lines=(3, 5, 7, 9), amplitude_A=0.4, period_s=4.0, periods=2, realisations=2,
        jog=Jog(np.radians(0.5), line=1), seed=20,
    )  # fmt: skip
    monkeypatch.setattr("hil.demo.story.EXPERIMENT", experiment)
    told = isocenter("demo", "--out", tmp_path / "demo", "--json", "-")
    assert told.status == 0, told.err
    document = json.loads(told.out)
    page = (tmp_path / "demo" / "index.html").read_text(encoding="utf-8")
    assert page.count("<figure") == 4 + 2 * 10 + 4 + 3  # motors' own elements, all of them, two axes, and the friction
    assert "EMULATED" in page
    assert page.index("Fc = 12 Nm") < page.index("isocenter diagnose carm") < page.index("<figure")
    before, after = (document[key]["channels"]["current_roll"]["nrmse"] for key in ("nominal", "with_friction"))
    assert after < 0.3 * before
    assert document["lines"] == 4
    assert len(document["recordings"]) == 4
    with np.load(tmp_path / "demo" / "carm.frf.npz") as frf:
        assert frf["G"].shape == (4, 5, 2)
