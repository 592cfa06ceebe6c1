"""How strong the noise is that repeats show: an independent recursion's disturbances are found again, however weak they are."""

from __future__ import annotations

import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.named.naming import name
from hil.diagnosis.seen.see import see

LOAD_N = 0.4
"""An eighth of what one recording's disturbance of 3 N, which passes 4 Hz, leaves unsure of a mean force would be seen."""


@pytest.mark.parametrize("rms_N", [1.0, 3.0, 20.0])
def test_a_disturbance_of_4_hz_is_as_strong_and_as_fast_as_it_is(rms_N: float) -> None:
    seen = see(MACHINE, repeats(4, disturbance_N=rms_N))
    levels = seen.levels.single
    assert levels is not None
    assert levels.corner_Hz == 5.0  # the nearest one that is tried
    assert levels.disturbance[0] == pytest.approx(rms_N, rel=0.25)


def test_a_load_that_weak_noise_does_not_hide_is_named() -> None:
    best = name(see(MACHINE, repeats(4, duration_s=6.0, disturbance_N=0.3, load_N=LOAD_N))).best
    assert [(setting.name, setting.at) for setting in best.settings] == [("constant_load", "carriage")]
    assert best.settings[0].parameters["tau0"] == pytest.approx(LOAD_N, rel=0.1)
