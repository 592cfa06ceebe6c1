"""The largest speed of a reference: none is known from recordings that never came to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.diagnosis.unknowns.unknowns import Kind, Unknown, numbers_of
from hil.simulation import Simulator
from tests.hil.diagnosis.pushed_mass import RAIL

FASTEST_m_s = 0.5


@pytest.mark.parametrize(("deviations", "limit_m_s"), [(-1.0, None), (0.0, None), (1.0, FASTEST_m_s * np.exp(-0.15))])
def test_a_limit_acts_where_it_cuts_off_what_was_recorded(deviations: float, limit_m_s: float | None) -> None:
    limit = Unknown("rail.speed_limit", Kind.SPEED_LIMIT, 0, FASTEST_m_s, -0.15, is_log=True)
    unknowns = replace(numbers_of(Simulator(RAIL).plant), each=(limit,))
    machine = unknowns.machine(replace(unknowns.start(), numbers=np.array([deviations])))
    assert machine.speed_limit == (() if limit_m_s is None else ((0, pytest.approx(limit_m_s)),))
