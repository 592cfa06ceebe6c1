"""With repeats, too, a number of the file that is wrong by far is found, and no effect stands for it."""

from __future__ import annotations

import pytest
from carriage import MACHINE, MASS_kg, repeats

from hil.diagnosis.diagnose import diagnose


@pytest.mark.parametrize(
    ("truth", "number", "value"),
    [
        ({"mass": 0.4 * MASS_kg}, "carriage.mass", 0.4 * MASS_kg),
        pytest.param({"mass": 2.5 * MASS_kg}, "carriage.mass", 2.5 * MASS_kg, marks=pytest.mark.nightly),
    ],
)
def test_a_number_wrong_by_far_is_a_finding_with_its_value(truth: dict[str, float], number: str, value: float) -> None:
    found = diagnose(MACHINE, repeats(3, seed=21, **truth), repeats(1, seed=22, experiment=1, **truth)).diagnosis
    assert [(finding.kind, finding.name) for finding in found.findings] == [("number", number)]
    assert found.verdict == "explained"
    assert found.findings[0].parameters["value"].value == pytest.approx(value, rel=0.01)
    assert found.fit.held_out is not None
    assert found.fit.held_out.extended == pytest.approx(1.0, abs=0.25)
