"""Recordings that lack rows, or a reference in one of them, are read as whole ones are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.diagnosis.likelihood.judge import Judge
from hil.diagnosis.observed.rows import observed
from hil.diagnosis.selection.select import runs_of
from hil.diagnosis.unknowns.unknowns import numbers_of
from hil.recording import Channel, Recording
from tests.hil.diagnosis.pushed_mass import RAIL, recorded

ROWS, SEED = 400, 21
LOST = (150, 151)


def nothing(_time: float, _position: float, _speed: float) -> float:
    return 0.0


def swung() -> Recording:
    return recorded(0.05 * np.sin(np.arange(ROWS) / 20.0) ** 3, nothing, SEED)


def test_a_command_acts_a_tick_later_where_rows_are_lost_too() -> None:
    whole = swung()
    kept = np.setdiff1d(np.arange(ROWS), LOST)
    channels = {name: replace(channel, values=channel.values[kept]) for name, channel in whole.channels.items()}
    thinned = observed(RAIL, "thinned", replace(whole, channels=channels))
    targets = observed(RAIL, "whole", whole).targets
    far = np.ones(ROWS, dtype=bool)
    far[LOST[0] - 1 : LOST[1] + 3] = False
    far[0] = False
    assert thinned.rows == ROWS
    np.testing.assert_allclose(thinned.targets[far], targets[far], atol=1e-9)


def test_a_reference_that_is_missing_in_a_row_does_not_end_the_simulation() -> None:
    whole = swung()
    reference = whole["reference_carriage"].copy()
    reference[LOST[0]] = np.nan
    holed = replace(whole, channels={**whole.channels, "reference_carriage": Channel("m", reference)})
    _, runs = runs_of(RAIL, {"holed": holed}, closed=True)
    unknowns = numbers_of(runs[0].simulator.plant)  # type: ignore[attr-defined]
    (left,) = Judge(runs, (None,), 1).left([unknowns.machine(unknowns.start())])
    assert left is not None
    assert all(np.isfinite(errors).all() for errors in left.errors)
