"""One diagnosis of a hidden friction, which several files read."""

from __future__ import annotations

import pytest
from carriage import MACHINE, MASS_kg, repeats

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.verdict.values import Outcome
from hil.recording import Recording

COULOMB_N = 20.0
DURATION_s = 2.0


@pytest.fixture(scope="session")
def with_friction() -> tuple[dict[str, Recording], dict[str, Recording]]:
    """Repeats and a held-out recording of a carriage that is 5 % heavier than its machine file says and has friction besides."""
    truth = {"mass": 1.05 * MASS_kg, "coulomb_N": COULOMB_N, "duration_s": DURATION_s}
    return repeats(**truth), repeats(1, experiment=1, **truth)


@pytest.fixture(scope="session")
def friction(with_friction: tuple[dict[str, Recording], dict[str, Recording]]) -> Outcome:
    return diagnose(MACHINE, *with_friction)
