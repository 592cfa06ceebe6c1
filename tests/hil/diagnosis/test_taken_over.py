"""Numbers of the machine file that do nothing beside an effect."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.ranking.taken_over import acting, without_those_taken_over
from hil.diagnosis.tuning.retune import Tuning, tunable, units
from hil.machine import load_machine
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import EffectSetting

CARM = load_machine("carm")
LOW_PASS = EffectSetting("imu_bandwidth", "imu", {"fc": 80.0, "shape": 0.25})
CONSTANT = EffectSetting("torque_constant", "roll", {"eps": 0.2})


def of_the_carm() -> Tuning:
    parameters = compile_plant(CARM.plant).parameters
    values, indices = np.array([parameter.value for parameter in parameters]), tunable(parameters)
    count = len(indices)
    return Tuning(parameters, indices, units(parameters, indices), np.zeros(count), values, np.zeros(1), np.ones((1, count)), np.eye(count))


@pytest.mark.parametrize(
    ("chosen", "idle"), [((), []), ((LOW_PASS,), ["imu.accelerometer_bandwidth", "imu.gyro_bandwidth"]), ((CONSTANT,), [])]
)
def test_another_low_pass_leaves_the_files_own_nothing_to_do(chosen, idle):
    tuning = of_the_carm()
    acts = acting(tuning, chosen, CARM.plant)
    assert [name for name, one in zip(tuning.names, acts, strict=True) if not one] == idle
    assert (without_those_taken_over(tuning, chosen, CARM.plant).jacobian == acts.astype(float)).all()
