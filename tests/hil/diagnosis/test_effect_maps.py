"""An effect's own map, against forces that were put on a mass by steps of its own equation."""

from __future__ import annotations

import numpy as np
import pytest
from pushed_mass import RAIL, recorded

from hil.diagnosis.report.effect_map import EffectMap, effect_map
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from virtual_bus.plant.parameters import plant_parameters

TIME = np.arange(2000) / RAIL.sample_rate_Hz
REFERENCE = 0.1 - 0.1 * np.cos(2.0 * np.pi * 0.4 * TIME)
SHAKEN_Hz = 2.37  # no whole number of periods in the record


def map_of(push, effect: str, period_s: float | None = None) -> EffectMap:
    """What was recorded, beside a fit that does nothing."""
    found = mismatch(RAIL, {f"repeat {k}": recorded(REFERENCE, push, k, noise=0.1) for k in range(3)})
    rows = [group.simulated for group in found.groups]
    values = np.array([parameter.value for parameter in plant_parameters(RAIL.plant)])
    drawn = effect_map(found, rows, rows, EffectAt(effect, "carriage"), values, period_s)
    assert drawn is not None and np.nanmax(np.abs(drawn.fitted)) < 1e-9
    return drawn


def test_what_shakes_the_base_is_drawn_over_the_time_in_its_period():
    drawn = map_of(lambda time, position, speed: 6.0 * np.sin(2.0 * np.pi * SHAKEN_Hz * time), "base_motion", 1.0 / SHAKEN_Hz)
    assert drawn.x_label == "time in the period [s]"
    assert drawn.recorded == pytest.approx(6.0 * np.sin(2.0 * np.pi * SHAKEN_Hz * drawn.x), abs=0.6)


def test_a_friction_over_position_is_drawn_against_the_motion():
    def level(position):
        return 4.0 + 2.0 * np.cos(40.0 * position)

    drawn = map_of(lambda time, position, speed: -level(position) * np.tanh(speed / 1e-3), "position_dependent_friction")
    assert drawn.x_label == "position of carriage [m]" and "against the motion" in drawn.y_label
    inner = (drawn.x > 0.02) & (drawn.x < 0.18)
    assert drawn.recorded[inner] == pytest.approx(level(drawn.x[inner]), abs=0.8)


def test_a_force_over_speed_is_drawn_over_speed():
    drawn = map_of(lambda time, position, speed: -80.0 * speed * abs(speed), "quadratic_friction")
    assert drawn.x_label == "speed of carriage [m/s]"
    seen = np.isfinite(drawn.x)
    assert drawn.recorded[seen] == pytest.approx(-80.0 * drawn.x[seen] * np.abs(drawn.x[seen]), abs=0.6)
