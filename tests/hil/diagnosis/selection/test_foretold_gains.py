"""What a law is foretold to gain, beside least squares of all folds by NumPy: where errors are linear both are the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hil.diagnosis.likelihood.judge import CELLS, FOLDS, PARTS
from hil.diagnosis.selection.candidates import EquationErrors, gain_left_out
from hil.diagnosis.unknowns.unknowns import Point

READINGS = 30  # of a cell
SPREAD = 5.0  # between the errors of the quietest cell and of the loudest


@dataclass(frozen=True)
class Nothing:
    """A fit of a machine that has no unknowns."""

    point: Any


def test_gains_are_those_of_the_logarithm_of_squares_that_are_left_out() -> None:
    random = np.random.default_rng(3)
    cell = np.repeat(np.arange(CELLS), READINGS)
    columns = random.standard_normal((len(cell), 2))
    errors = -columns @ [0.8, 0.3] + random.standard_normal(len(cell)) * np.linspace(1.0, SPREAD, CELLS)[cell]
    inside = [cell == one for one in range(CELLS)]
    out = np.array([np.isin(cell, np.flatnonzero(fold)) for fold in FOLDS])
    mean = float(np.mean(errors**2))
    gains = []
    for left_out in out:
        fitted = np.linalg.lstsq(columns[~left_out], -errors[~left_out], rcond=None)[0]
        before, after = (float(np.mean(own[left_out] ** 2)) for own in (errors, errors + columns @ fitted))
        gains.append(-0.5 * left_out.sum() * np.log(after / before))
    of = EquationErrors(
        fit=Nothing(Point(np.zeros(0), (), None)),  # type: ignore[arg-type]
        laws=(),
        parts=(),
        sizes=np.zeros(0),
        squares=np.array([columns[one].T @ columns[one] / mean for one in inside]),
        slopes=np.array([-columns[one].T @ errors[one] / mean for one in inside]),
        readings=out.sum(axis=1).astype(float),
        left=np.array([np.sum(errors[one] ** 2) / mean for one in out]),
    )
    far = np.full(2, np.inf)
    found = gain_left_out(of, np.arange(2), np.zeros(2), (-far, far))
    assert found == pytest.approx(min(sum(gains[:PARTS]), sum(gains[PARTS:])), rel=1e-4)
