"""Re-tuned machines are made of rigid bodies: their files load, and what was one already stays as it is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.diagnosis.machine_file import retuned_text
from hil.diagnosis.retune import PRIOR, Tuning, tunable
from hil.machine import load_machine, machine_from_text
from virtual_bus.plant.parameters import plant_parameters

CARM = load_machine("carm")
PARAMETERS = plant_parameters(CARM.plant)
NAMES = [f"{parameter.owner}.{parameter.quantity}" for parameter in PARAMETERS]
NOMINAL = np.array([parameter.value for parameter in PARAMETERS])
INDICES = tunable(PARAMETERS)
MOMENTS = [f"c_arc.inertia_{entry}" for entry in ("xx", "yy", "zz")]


def tuning() -> Tuning:
    count = len(INDICES)
    return Tuning(
        PARAMETERS, INDICES, np.abs(NOMINAL[INDICES]) * PRIOR, np.zeros(count), NOMINAL, np.zeros(0), np.zeros((0, count)), np.eye(count)
    )


def moved(**changes: float) -> np.ndarray:
    """Offsets in which c_arc's moments are this share of nominal away, and nothing else."""
    offset = np.zeros(len(INDICES))
    for entry, change in changes.items():
        offset[list(INDICES).index(NAMES.index(f"c_arc.inertia_{entry}"))] = change / PRIOR
    return offset


def moments(values: np.ndarray) -> np.ndarray:
    return np.array([values[NAMES.index(name)] for name in MOMENTS])


def test_a_machine_tuned_to_moments_that_no_body_has_is_written_as_one_that_loads():
    offset = moved(xx=-0.15, yy=0.15, zz=-0.15)
    wanted = NOMINAL.copy()
    wanted[INDICES] += offset * tuning().scale
    xx, yy, zz = moments(wanted)
    assert xx + zz < yy, "these are a rigid body's: the test shows nothing"
    values = tuning().at(offset)
    read = machine_from_text(retuned_text(CARM, PARAMETERS, values), CARM.path)
    xx, yy, zz = moments(np.array([parameter.value for parameter in plant_parameters(read.plant)]))
    assert xx + zz == pytest.approx(yy, rel=1e-9), "raised by more than a rigid body needs"
    others = [k for k, name in enumerate(NAMES) if name not in MOMENTS]
    assert np.array_equal(values[others], NOMINAL[others])


@settings(max_examples=100, derandomize=True, deadline=None)
@given(st.lists(st.floats(-0.15, 0.15), min_size=3, max_size=3))
def test_moments_of_a_rigid_body_are_left_as_they_are_and_others_are_raised_alike(changes):
    wanted = moments(NOMINAL) * (1.0 + np.array(changes))
    found = moments(tuning().at(moved(**dict(zip(("xx", "yy", "zz"), changes, strict=True)))))
    low, middle, high = np.sort(found)
    assert low + middle >= high * (1.0 - 1e-9)
    short = 2.0 * wanted.max() - wanted.sum()
    assert found - wanted == pytest.approx(np.full(3, max(short, 0.0)), abs=1e-9 * wanted.max())
