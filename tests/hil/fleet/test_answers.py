"""What tasks find keeps its names from night to night, and its covariance."""

from __future__ import annotations

import math

import pytest

from hil.fleet.answers import of_resonances
from hil.identification.modal.resonances import Resonance, Resonances

EXPECTED_Hz = (8.0, 14.0, 22.0)


def resonance(frequency_Hz: float) -> Resonance:
    covariance = ((4e-4, 1e-6), (1e-6, 9e-8))
    return Resonance(frequency_Hz, 0.02, (frequency_Hz - 0.04, frequency_Hz + 0.04), (0.019, 0.021), "position", "current", covariance)


def frequencies(*found_Hz: float) -> dict[str, float]:
    rows = of_resonances(Resonances(tuple(resonance(each) for each in found_Hz), "", 1.0), EXPECTED_Hz, "")
    return {row.quantity: row.value for row in rows if row.unit == "Hz"}


def test_a_mode_keeps_its_name_where_another_one_is_not_found() -> None:
    assert frequencies(8.1, 13.5, 22.5) == {"mode 1 frequency": 8.1, "mode 2 frequency": 13.5, "mode 3 frequency": 22.5}
    assert frequencies(13.5, 22.5) == {"mode 2 frequency": 13.5, "mode 3 frequency": 22.5}


def test_a_resonance_that_no_mode_of_the_file_is_has_a_name_of_its_own() -> None:
    assert frequencies(7.9, 8.3, 14.0, 22.0)["further mode 1 frequency"] == 8.3


def test_frequency_and_damping_of_a_mode_have_their_covariance() -> None:
    frequency, damping = of_resonances(Resonances((resonance(8.1),), "", 1.0), EXPECTED_Hz, "")[1:]
    assert (frequency.group, damping.group) == ("mode 1", "mode 1")
    assert frequency.covariance[damping.place] == damping.covariance[frequency.place] == 1e-6
    assert frequency.standard_deviation == pytest.approx(0.02)
    assert damping.standard_deviation == pytest.approx(3e-4)


def test_no_resonance_is_a_row_that_says_why() -> None:
    [row] = of_resonances(Resonances((), "nothing stands out", math.nan), EXPECTED_Hz, "")
    assert (row.value, row.verdict, row.message) == (0.0, "no resonance", "nothing stands out")
