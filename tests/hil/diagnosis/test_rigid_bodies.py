"""Re-tuned machines are made of rigid bodies: their files load, and what was one already stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.diagnosis.answered.machine_file import retuned_text
from hil.diagnosis.tuning.retune import LARGEST_CHANGE, PRIOR, Tuning, bounded_step, sensitivity_trials, tunable
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


def test_a_step_ends_at_the_best_rigid_body_on_its_way():
    """Against a minimisation under the same three conditions by another method (sequential quadratic programming)."""
    count, random = len(INDICES), np.random.default_rng(3)
    places = [list(INDICES).index(NAMES.index(name)) for name in MOMENTS]
    mixed = random.standard_normal((3, 3)) * 40.0
    hessian = np.eye(count)
    hessian[np.ix_(places, places)] += mixed.T @ mixed
    offset, wanted = moved(xx=-0.02, yy=0.04, zz=-0.01), np.zeros(count)
    wanted[places] = [-0.9, 0.8, -0.7]  # no rigid body's
    step = bounded_step(tuning(), hessian, hessian @ wanted, offset)
    nominal, start, small = moments(NOMINAL), offset[places], hessian[np.ix_(places, places)]

    def short(change: np.ndarray) -> float:
        xx, yy, zz = nominal * (1.0 + PRIOR * (start + change))
        return float(xx + zz - yy)

    found = scipy.optimize.minimize(
        lambda change: (change - wanted[places]) @ small @ (change - wanted[places]),
        np.zeros(3),
        jac=lambda change: 2.0 * small @ (change - wanted[places]),
        bounds=[(-LARGEST_CHANGE / PRIOR - at, LARGEST_CHANGE / PRIOR - at) for at in start],
        constraints={"type": "ineq", "fun": short},
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 500},
    )
    assert short(wanted[places]) < -1.0
    assert short(step[places]) > 0.0
    assert step[places] == pytest.approx(found.x, abs=1e-3)
    assert np.delete(step, places) == pytest.approx(0.0, abs=1e-9)


def test_sensitivities_are_not_taken_across_the_end_of_rigid_bodies():
    xx, yy, zz = moments(NOMINAL)
    offset = moved(xx=0.05, yy=(1.05 * xx + zz) / yy - 1.0 - 1e-9)  # towards nominal, xx alone is too small
    trials, differences = sensitivity_trials(tuning(), offset, ())
    alone = [NOMINAL.copy() for _ in trials]
    for k, (values, trial) in enumerate(zip(alone, trials, strict=True)):
        moving = offset.copy()
        moving[k] += differences[k]
        values[INDICES] += moving * tuning().scale
        assert trial.values == pytest.approx(values, rel=1e-12), "another moment was raised with it"


def test_without_numbers_that_show_there_is_no_step():
    none = replace(tuning(), indices=INDICES[:0], scale=np.zeros(0), offset=np.zeros(0))
    assert bounded_step(none, np.zeros((0, 0)), np.zeros(0), none.offset).shape == (0,)
    assert sensitivity_trials(none, none.offset, ())[0] == []


def test_a_body_that_has_the_name_of_a_sensor_is_re_tuned_apart_from_it():
    machine = machine_from_text(CARM.text.replace('"detector"', '"imu"'))
    parameters = plant_parameters(machine.plant)
    assert len({parameter.name for parameter in parameters}) < len(parameters), "no two of one name: the test shows nothing"
    raised = [1.1 if parameter.name in ("imu.mass_kg", "imu.gyro_bandwidth_Hz") else 1.0 for parameter in parameters]
    values = np.array([parameter.value for parameter in parameters]) * raised
    read = machine_from_text(retuned_text(machine, parameters, values))
    assert [parameter.value for parameter in plant_parameters(read.plant)] == pytest.approx(values.tolist(), rel=1e-9)
