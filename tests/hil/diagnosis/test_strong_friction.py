"""A friction that is several times the file's damping has its true value, and no wider law makes it unsure."""

from __future__ import annotations

import pytest
from carriage import DAMPING, MACHINE, repeats

from hil.diagnosis.diagnose import diagnose


@pytest.mark.parametrize("times", [4.0, pytest.param(2.0, marks=pytest.mark.nightly)])
def test_a_strong_viscous_friction_is_named_alone_with_its_value(times: float) -> None:
    truth = {"damping": (1.0 + times) * DAMPING}
    found = diagnose(MACHINE, repeats(3, seed=41, **truth), repeats(1, seed=42, experiment=1, **truth)).diagnosis
    assert [str(finding.effect) for finding in found.findings] == ["viscous_friction at carriage"]
    assert found.verdict == "explained", found.reason
    assert found.findings[0].parameters["Fv"].value == pytest.approx(times * DAMPING, rel=2e-3)
